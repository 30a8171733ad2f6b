"""Motion primitives: what a machine can do, and the steering that comes of it."""

import math
from dataclasses import replace
from types import SimpleNamespace

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agent.envs.drive import set_points
from cosim.base.errors import UserError
from cosim.calibration import primitives
from cosim.calibration.measuring import calibrated, points, shares_of
from cosim.calibration.primitives import (
    DIRECTIONS,
    Primitive,
    able,
    find_primitives,
    primitive_rows,
    steered,
)
from cosim.calibration.trial import Trial, mean_motion
from cosim.coupling.master import FallError
from cosim.fmi.motor import MotorFmu
from cosim.model.preset import find_preset
from cosim.onboard.steering import (
    BACKWARDS,
    COMMAND_SIZE,
    DIRECTION,
    DRIVE,
    FORWARDS,
    GOAL_X,
    GOAL_Y,
    LEFTWARDS,
    MODE,
    RIGHTWARDS,
    SENSE,
    SPEED,
    START,
    YAW_RATE,
    steer,
)
from docs.examples.draw_machine import machine

REACH_M = 0.025


@pytest.fixture(scope="module")
def config(tmp_path_factory):
    file = tmp_path_factory.mktemp("machine") / "drawn.toml"
    file.write_text(machine(1), "utf-8")
    return find_preset(file).config()


def primitive(ahead: float, left: float, turn: float) -> Primitive:
    speeds, mean = (700.0, -700.0, 0.0, 650.0), (ahead, left, turn)
    return Primitive(speeds, mean, (1e-5, 1e-5, 1e-3), 0.0, (0.5, 1.0, 0.0, 0.2), 4e-4)


def found(**others: Primitive) -> dict[str, Primitive]:
    units = (2e-3, 2e-3, 0.15)
    usual = {
        name: primitive(*(u * d for u, d in zip(units, direction, strict=True)))
        for name, direction in DIRECTIONS.items()
    }
    return usual | others


def test_a_primitive_has_to_go_mainly_its_way():
    assert able(primitive(2e-3, 5e-4, 0.01), "forwards", REACH_M)
    assert not able(primitive(2e-3, 1.5e-3, 0.0), "forwards", REACH_M)
    assert not able(primitive(2e-3, 0.0, 0.06), "forwards", REACH_M)  # it drives in a circle
    assert not able(primitive(4e-5, 0.0, 0.0), "forwards", REACH_M)
    assert not able(primitive(-2e-3, 0.0, 0.0), "forwards", REACH_M)


def test_motors_get_their_shares_of_the_largest_speed(config):
    steering = steered(config, found()).steering
    assert [share.forwards for share in steering.shares] == [1.0, -1.0, 0.0, 650.0 / 700.0]
    assert (steering.forward_speed_rad_s, steering.side_speed_rad_s) == (700.0, 700.0)
    assert steering.drive_speed_m_s == pytest.approx(2e-3)
    assert steering.turn_rate_rad_s == pytest.approx(0.15)
    assert steering.yaw_gain * steering.heading_gain_1_s == pytest.approx(2.0)


def test_a_learner_commands_its_velocity_or_each_motor(config):
    own = steered(config, found())
    actions = np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0]])
    dither = np.tile((0.0, 1.0), (3, 1))
    speeds = set_points(actions, own, dither, velocity=True)
    assert speeds.tolist() == pytest.approx(np.array([[700.0, -700.0, 0.0, 650.0]] * 3))
    each = np.array([[0.5, -0.5, 0.0, 1.0]])
    largest = own.steering.max_speed_rad_s
    assert set_points(each, own, dither[:1], velocity=False).tolist() == (largest * each).tolist()


@pytest.mark.long
@settings(max_examples=15, deadline=None)
@given(
    st.lists(st.floats(0.25, 4.0), min_size=4, max_size=4),
    st.lists(st.tuples(*[st.floats(-1.0, 1.0)] * 4).filter(any), min_size=4, max_size=4),
    st.sampled_from([-1.2, -0.1, 0.1, 1.2]),
)
def test_each_drive_steers_by_its_own_measurements(config, gains, differences, course):
    """Speed, difference and gain are those of the drive, whichever the robot chooses."""
    own = {
        name: msgspec.structs.replace(
            primitive,
            yaw_gain=4e-4 * gain,
            difference=row,
            mean=tuple(np.divide(primitive.mean, gain)),
        )
        for (name, primitive), gain, row in zip(found().items(), gains, differences, strict=False)
    }
    measured = found() | own
    steering = steered(config, measured).steering
    for sense, (name, direction) in enumerate(list(DIRECTIONS.items())[:4]):
        row, set_points = np.zeros(COMMAND_SIZE), np.empty(4)
        heading = math.atan2(direction[1], direction[0])
        row[[GOAL_X, GOAL_Y]], row[DIRECTION] = np.array(direction[:2]), heading
        row[[MODE, SENSE]] = DRIVE, (FORWARDS, BACKWARDS, LEFTWARDS, RIGHTWARDS)[sense]
        error = 0.02 * course
        steer(row, 0.0, 0.0, -error, 1e-3, steering, set_points)
        straight = np.array(measured[name].set_points_rad_s)
        wanted = 2.0 * error / measured[name].yaw_gain
        added = np.clip(wanted, *np.array([-1.0, 1.0]) * steering.max_difference_rad_s)
        slower = min(1.0, (steering.max_speed_rad_s - abs(added)) / np.abs(straight).max())
        expected = slower * straight + added * np.array(measured[name].difference)
        assert set_points == pytest.approx(expected)
        assert abs(row[SPEED]) == pytest.approx(abs(np.dot(measured[name].mean, direction)))
        assert row[YAW_RATE] == pytest.approx(added * measured[name].yaw_gain)


@pytest.mark.parametrize(
    ("lacking", "facings", "drives"),
    [
        ((), 2, 4),
        (("leftwards",), 4, 2),
        (("backwards",), 8, 1),  # its heading would not follow from a move to a side
        (("backwards", "leftwards", "rightwards"), 8, 1),
    ],
)
def test_headings_count_by_what_a_machine_can_do(config, lacking, facings, drives):
    still = dict.fromkeys(lacking, primitive(0.0, 0.0, 0.0))
    steering = steered(config, found(**still)).steering
    assert steering.facings == facings
    speeds = steering.forward_speed_rad_s, steering.backward_speed_rad_s
    assert np.count_nonzero([*speeds, *[steering.side_speed_rad_s] * 2]) == drives


def test_a_robot_that_can_drives_sideways_instead_of_turning(config):
    for sideways in (True, False):
        still = {} if sideways else {"leftwards": primitive(0.0, 0.0, 0.0)}
        steering = steered(config, found(**still)).steering
        row = np.zeros(COMMAND_SIZE)
        row[[GOAL_Y, DIRECTION, MODE]] = 1.0, math.pi / 2.0, START
        steer(row, 0.0, 0.0, 0.0, 1e-3, steering, np.empty(4))
        assert abs(row[SENSE]) == (LEFTWARDS if sideways else FORWARDS)


def test_a_machine_that_cannot_steer_is_refused_with_its_best_motion(config):
    circling = found(left_turn=primitive(0.0, 0.0, 0.0), right_turn=primitive(4e-3, 0.0, -0.1))
    words = r"^machine drawn cannot steer: .* mainly does left turn, right turn; .*4\.00 mm/s"
    with pytest.raises(UserError, match=words):
        steered(config, circling)
    one_way = steered(config, found(backwards=primitive(0.0, 0.0, 0.0))).steering
    assert one_way.backward_speed_rad_s == 0.0


class Linear:
    """A trial of robots whose speeds are linear in set points, and that tip over at some."""

    most = math.inf  # set point of the second motor

    def falls(self, set_points):
        return set_points[:, 1] > self.most

    def __init__(self, fmu, config, headings, seed) -> None:
        self.poses = np.tile(np.eye(7)[3], (len(headings), 1))

    def __enter__(self):
        return self

    def __exit__(self, *_) -> None:
        pass

    def set_motors(self, set_points) -> None:
        self._set_points = set_points

    def advance(self, periods):
        if (fallen := np.flatnonzero(self.falls(self._set_points))).size:
            raise FallError("robot 3 tips over", int(fallen[-1]))
        forms = np.array([[1.0, 1.0, -1.0, 0.2], [1.0, -0.5, 1.0, 0.0], [50.0, 0.0, 30.0, 90.0]])
        ahead, left, half = 1e-9 * forms @ self._set_points.T
        flat = np.zeros_like(half)
        position = np.column_stack([ahead, left, flat])[None]
        quaternion = np.column_stack([np.cos(half), flat, flat, np.sin(half)])[None]
        airborne = np.zeros((1, len(half)))
        return SimpleNamespace(position=position, quaternion=quaternion, airborne_share=airborne)


def test_set_points_that_tip_a_machine_over_are_left_out(config, motor_fmu, monkeypatch):
    monkeypatch.setattr(primitives, "Trial", Linear)
    for most, fastest in ((math.inf, 600.0), (300.0, -math.inf)):
        monkeypatch.setattr(Linear, "most", most)
        measured = primitives.search(config, motor_fmu)
        assert all(able(p, name, REACH_M) for name, p in measured.items())
        assert fastest < max(p.set_points_rad_s[1] for p in measured.values()) <= most
    monkeypatch.setattr(Linear, "falls", staticmethod(lambda set_points: set_points.any(axis=1)))
    with pytest.raises(UserError, match=r"drawn cannot drive at any of .* robot 3 tips over"):
        primitives.search(config, motor_fmu)


@pytest.mark.slow
def test_primitives_of_a_drawn_machine_are_found(config, motor_fmu):
    """All six, straight within what repeats itself; the same as those of another search."""
    measured = find_primitives(replace(config), motor_fmu)
    assert all(able(p, name, REACH_M) for name, p in measured.items())
    assert abs(measured["forwards"].mean[2]) < math.radians(0.5)
    assert find_primitives(config, motor_fmu, again=True) == measured


@pytest.mark.slow
def test_a_machine_whose_primitives_are_found_drives_at_the_speed_that_is_asked(motor_fmu):
    base = find_preset("kilobot").config()
    usual = calibrated(base, motor_fmu)
    half_m_s = 0.5 * usual.steering.drive_speed_m_s
    slow = calibrated(base.having("given", drive_speed_m_s=half_m_s), motor_fmu)
    assert slow.steering.drive_speed_m_s == half_m_s
    assert slow.steering.shares == usual.steering.shares
    set_points = slow.steering.forward_speed_rad_s * np.array(shares_of(slow, "forwards"))
    with Trial(MotorFmu(motor_fmu), slow, np.zeros(16), np.random.SeedSequence(7)) as trial:
        trial.set_motors(set_points)
        trial.advance(500)
        motion = mean_motion(trial.poses, [trial.advance(5000)], 1e-3)
    assert motion[:, 0].mean() == pytest.approx(half_m_s, rel=0.15)


def test_the_table_says_how_well_a_primitive_repeats_itself(config):
    """Its mean's 95 % interval by Student: 2.201 is the quantile for twelve drives."""
    still = {"airborne_share": 0.25, "difference": (), "yaw_gain": 1.0}
    straight = Primitive((900.0, -800.0), (4e-3, 0.0, 0.0), (1e-3, 2e-3, 0.0), **still)
    curve = Primitive((700.0, 0.0), (8e-3, 6e-3, 0.5), (0.0, 0.0, math.radians(1.0)), **still)
    ahead, turn = primitive_rows({"forwards": straight, "left_turn": curve}, config)
    half = 2.201 / math.sqrt(12.0)
    assert ahead[:3] == (
        "forwards",
        f"4.00 ± {half:.2f} (σ 1.00)",
        f"0.00 ± {2.0 * half:.2f} (σ 2.00)",
    )
    assert ahead[4:] == ("25.0%", "900 -800")
    assert turn[0] == "left turn in a circle of 20 mm"
    assert turn[3] == f"{math.degrees(0.5):.2f} ± {half:.2f} (σ 1.00)"


def test_of_two_circles_the_wider_one_counts(config):
    curves = {"left_turn": (2e-3, 0.1, 0.02), "right_turn": (4e-3, -0.05, 0.08)}
    for order in (1, -1):
        pair = dict(zip(curves, [*curves.values()][::order], strict=True))
        sides = {
            name: primitive(ahead, 0.0, abs(rate) * DIRECTIONS[name][2])
            for name, (ahead, rate, _) in pair.items()
        }
        steering = steered(config, found(**sides)).steering
        lengths_m = steering.turn_radius_m, steering.lookahead_m, steering.least_lookahead_m
        assert lengths_m == pytest.approx((0.08, 0.16, 0.08))


def test_no_trial_asks_more_of_a_motor_than_it_has(config):
    motors = tuple(
        mount._replace(own=(("V_s_max", 0.6 + 0.05 * k),))
        for k, mount in enumerate(config.robot.motors)
    )
    uneven = steered(replace(config, robot=config.robot._replace(motors=motors)), found())
    largest = np.array(uneven.top_speeds_rad_s)
    assert largest.min() < 0.9 * largest.max()
    asked = [np.abs(p.set_speed * np.array(shares_of(uneven, p.primitive))) for p in points(uneven)]
    assert (np.array(asked) <= largest * (1.0 + 1e-9)).all()

"""Motion primitives: what a machine can do, and the steering that comes of it."""

import math
from dataclasses import replace

import numpy as np
import pytest

from agent.envs.drive import set_points
from cosim.base.errors import UserError
from cosim.calibration.primitives import DIRECTIONS, Primitive, able, find_primitives, steered
from cosim.model.preset import find_preset
from cosim.onboard.steering import (
    COMMAND_SIZE,
    DIRECTION,
    FORWARDS,
    GOAL_Y,
    LEFTWARDS,
    MODE,
    SENSE,
    START,
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
    return usual | {name.replace("_", " "): value for name, value in others.items()}


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
    with pytest.raises(UserError, match=r"nothing for left turn, right turn; .*4\.00 mm/s"):
        steered(config, circling)
    one_way = steered(config, found(backwards=primitive(0.0, 0.0, 0.0))).steering
    assert one_way.backward_speed_rad_s == 0.0


@pytest.mark.slow
def test_primitives_of_a_drawn_machine_are_found(config, motor_fmu):
    """All six, straight within what repeats itself; the same as those of another search."""
    primitives = find_primitives(replace(config), motor_fmu)
    assert all(able(p, name, REACH_M) for name, p in primitives.items())
    assert abs(primitives["forwards"].mean[2]) < math.radians(0.5)
    assert find_primitives(config, motor_fmu, again=True) == primitives

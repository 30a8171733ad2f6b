"""The shield: who stops, who retreats, and that nothing within its constants closes a gap."""

import math

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from cosim.coupling.signals import new_state
from cosim.model.params import SHIELD, STEERING, TABLE_I
from cosim.onboard.estimation import COVARIANCE, ESTIMATE_SIZE, POSE
from cosim.onboard.shield import (
    ZONE_M,
    guard,
    plan_margin,
)
from cosim.onboard.state import FAILURES, PARKED, SHIELD_SIZE, STOPS
from cosim.onboard.steering import (
    COMMAND_SIZE,
    COURSE,
    DRIVE,
    GOAL_X,
    HOLD,
    MODE,
    RETREAT,
    SENSE,
    SPEED,
    YAW_RATE,
    steer,
)

BOARD = np.array([0.34, 0.3])
DIAMETER_M = TABLE_I.diameter_m
NOTHING = np.empty((0, 4))
WALL = np.array([[0.20, 0.0, 0.22, 0.3]])
KEPT_M = 2.0 * SHIELD.stopping_m  # of a gap, at room 0


class Robots:
    """The shield's view of some robots that drive."""

    def __init__(self, *poses, obstacles=NOTHING, forbidden=NOTHING, board=BOARD, margin_m=0.0):
        n, self.board, self.margin_m = len(poses), board, margin_m
        self.forbidden = np.array([forbidden] * n)
        self.targets, self.owners = np.full((n, 4), np.inf), np.arange(n)
        self.commands, self.shields = np.zeros((n, COMMAND_SIZE)), np.zeros((n, SHIELD_SIZE))
        self.estimates = np.zeros((n, ESTIMATE_SIZE))
        self.estimates[:, POSE : POSE + 3] = poses
        self.commands[:, MODE] = DRIVE
        self.obstacles = obstacles

    @property
    def modes(self):
        return self.commands[:, MODE].tolist()

    @property
    def positions(self):
        return self.estimates[:, POSE : POSE + 2]

    def guarded(self, steering=STEERING, shield=SHIELD):
        n, state = len(self.commands), new_state(1, len(self.commands), len(self.commands))
        onboard = state.onboard._replace(
            commands=self.commands, estimates=self.estimates, shields=self.shields
        )
        floor = state.floor._replace(
            boards=self.board[None],
            margins_m=np.array([self.margin_m]),
            cells_m=np.array([0.01]),
            obstacles=self.obstacles[None],
            forbidden=self.forbidden,
            targets=self.targets,
            owners=self.owners,
        )
        guard(onboard, floor, 0, n, DIAMETER_M, steering, shield)
        return self


@pytest.mark.long
@given(st.integers(0, 2**32 - 1), st.integers(2, 150), st.sampled_from([0.0, 1e-3]))
def test_of_many_robots_those_without_room_stop(seed, n, deviation_m):
    """Compare with the definition of room over all robots and targets, one after the other."""
    rng = np.random.default_rng(seed)
    size_m = 0.07 * math.sqrt(n) + 0.05
    places = rng.uniform(0.0, size_m, (n, 2))
    robots = Robots(*np.insert(places, 2, 0.0, axis=1), board=np.full(2, size_m))
    variance = deviation_m**2 * rng.random(n)
    robots.estimates[:, COVARIANCE] = robots.estimates[:, COVARIANCE + 4] = variance
    corners = 0.01 * np.floor(rng.uniform(0.0, 100.0 * size_m, (n, 2)))
    robots.targets, robots.owners = np.hstack([corners, corners + 0.01]), rng.permutation(n)
    robots.guarded()
    alone = SHIELD.stopping_m + SHIELD.deviations * np.sqrt(variance)
    least = np.minimum(places, size_m - places).min(axis=1) - alone
    deviation = np.sqrt(variance)
    for i in range(n):
        away = places[i] - places[i].clip(robots.targets[:, :2], robots.targets[:, 2:])
        least[i] = min(least[i], np.hypot(*away.T)[robots.owners != i].min() - alone[i])
        of_both = np.sqrt(variance[i] + variance)
        kept = DIAMETER_M + 2.0 * SHIELD.stopping_m + SHIELD.deviations * of_both
        rooms = np.hypot(*(places - places[i]).T) - kept
        rooms[i] = np.inf
        if rooms.min() < least[i]:
            least[i], deviation[i] = rooms.min(), of_both[rooms.argmin()]
    modes = np.array(robots.modes)
    assert np.array_equal(modes != DRIVE, least < SHIELD.room_m + SHIELD.jitter * deviation)
    zones = [
        tuple((place // (size_m / max(1, int(size_m / ZONE_M)))).astype(int)) for place in places
    ]
    retreating = [zone for zone, mode in zip(zones, modes, strict=True) if mode == RETREAT]
    assert len(set(retreating)) == len(retreating)


def apart(gap_m, *headings):
    """Two robots along x with a gap."""
    other = 0.1 + DIAMETER_M + gap_m
    return Robots((0.1, 0.15, headings[0]), (other, 0.15, headings[1]))


def test_robots_with_room_are_left_alone():
    robots = apart(KEPT_M + SHIELD.room_m + 1e-9, 0.0, math.pi).guarded()
    assert robots.modes == [DRIVE, DRIVE]
    assert not robots.shields.any()


def test_of_two_without_room_both_stop_and_the_last_retreats():
    robots = apart(KEPT_M + 0.5 * SHIELD.room_m, 0.0, math.pi).guarded()
    assert robots.modes == [HOLD, RETREAT]
    assert robots.shields[:, STOPS].tolist() == [1, 1]
    assert robots.commands[1, SENSE] == -1.0  # it faces the other one
    assert robots.commands[1, GOAL_X] == pytest.approx(0.1505 + SHIELD.retreat_m, abs=1e-3)


@pytest.mark.parametrize(
    ("heading", "known", "modes"),
    [
        (math.pi / 2, {}, [RETREAT, HOLD]),  # who faces along the line
        (math.pi, {(1, PARKED): 1.0}, [RETREAT, HOLD]),  # who has arrived stays
        (math.pi, {(0, FAILURES): 1.0}, [HOLD, RETREAT]),  # who has failed less
        (math.pi, {(1, FAILURES): 1.0}, [RETREAT, HOLD]),
    ],
)
def test_who_of_two_retreats(heading, known, modes):
    robots = apart(KEPT_M + 0.5 * SHIELD.room_m, 0.0, heading)
    for place, value in known.items():
        robots.shields[place] = value
    assert robots.guarded().modes == modes


def test_without_any_room_nobody_moves():
    robots = apart(KEPT_M - 1e-6, 0.0, math.pi)
    robots.commands[1, MODE] = RETREAT
    assert robots.guarded().modes == robots.guarded().modes == [HOLD, HOLD]


def test_a_retreat_that_costs_room_is_tried_the_other_way_round():
    robots = apart(KEPT_M + 0.5 * SHIELD.room_m, math.pi / 2, math.pi / 2).guarded()
    first = robots.commands[1, SENSE]
    robots.shields[0, PARKED] = 1.0
    robots.estimates[1, POSE] -= 1.5 * SHIELD.loss_m
    robots.guarded()
    assert robots.modes == [HOLD, RETREAT]
    assert robots.shields[1, FAILURES] == 1.0
    assert robots.commands[1, SENSE] == -first
    robots.estimates[1, POSE] += 2.0 * SHIELD.room_m
    assert robots.guarded().shields[1, FAILURES] == 0.0


def test_one_retreats_at_a_time():
    robots = Robots(*((0.1 + k * (DIAMETER_M + 5e-4), 0.15, 0.0) for k in range(3))).guarded()
    assert sorted(robots.modes) == [HOLD, HOLD, RETREAT]
    chosen = robots.modes.index(RETREAT)
    again = robots.guarded().modes
    assert again.index(RETREAT) == chosen
    assert again.count(RETREAT) == 1


def test_plans_at_the_margin_may_stray_without_being_stopped():
    for strayed, modes in ((0.99, [DRIVE, DRIVE]), (1.01, [HOLD, RETREAT])):
        margin_m = plan_margin(np.zeros((2, ESTIMATE_SIZE)), SHIELD)
        robots = apart(margin_m - strayed * SHIELD.stray_m, 0.0, math.pi)
        assert robots.guarded().modes == modes


@pytest.mark.parametrize("correlation", [-1.0, 1.0])
def test_an_estimate_is_as_unsure_as_in_its_worst_direction(correlation):
    """Errors of x and y that grow together have √2 times their size along the diagonal."""
    size_m = 1e-3
    for share, mode in ((1.3, RETREAT), (1.5, DRIVE)):
        error_m = share * (SHIELD.deviations + SHIELD.jitter) * size_m
        room_m = SHIELD.stopping_m + SHIELD.room_m + error_m
        robots = Robots((room_m, 0.15, 0.0))
        robots.estimates[0, COVARIANCE : COVARIANCE + 5] = size_m**2 * np.array(
            [1.0, correlation, 0.0, correlation, 1.0]
        )
        assert robots.guarded().modes == [mode]


@pytest.mark.parametrize(
    ("pose", "obstacles", "sense"),
    [
        ((5e-4, 0.15, math.pi), NOTHING, -1.0),  # the board's edge, faced
        ((0.15, BOARD[1] - 5e-4, -math.pi / 2), NOTHING, 1.0),
        ((0.2 - DIAMETER_M / 2 - 5e-4, 0.15, 0.0), WALL, -1.0),
    ],
)
def test_edges_and_obstacles_are_kept_clear_of(pose, obstacles, sense):
    robots = Robots(pose, obstacles=obstacles).guarded()
    assert robots.modes == [RETREAT]
    assert robots.commands[0, SENSE] == sense


def test_a_centre_is_kept_out_of_anothers_target():
    for gap_m, mode in ((5e-4, RETREAT), (5e-3, DRIVE)):  # the rim is half over it
        robots = Robots((0.2 - gap_m, 0.15, 0.0), forbidden=WALL).guarded()
        assert robots.modes == [mode]
    within = Robots((0.21, 0.15, 0.0), forbidden=WALL).guarded()
    assert within.modes == [HOLD]


def test_a_retreat_goes_on_though_driving_makes_the_robot_less_sure():
    robots = apart(KEPT_M + 0.9 * SHIELD.room_m, 0.0, math.pi).guarded()
    for variance_m2, mode in ((1e-8, RETREAT), (4e-8, HOLD)):  # 0.5 and 1 mm of error
        robots.estimates[1, COVARIANCE] = variance_m2
        assert robots.guarded().modes == [HOLD, mode]
    assert not robots.shields[:, FAILURES].any()  # no room is left, but none was lost


steps = st.lists(
    st.tuples(*(st.floats(-1.0, 1.0),) * 4, st.integers(0, 15)), min_size=20, max_size=80
)


angle = st.floats(-math.pi, math.pi)
steerings = st.sampled_from([STEERING, STEERING._replace(backward_speed_rad_s=0.0)])


@settings(max_examples=60, deadline=None)
@given(steps, st.floats(1e-6, 2e-3), angle, angle, steerings)
def test_no_motion_within_the_constants_closes_a_gap(motion, room_m, first, second, steering):
    """The proof, tried: robots that are not held move as they like, those that are coast.

    From a look until it rests no robot moves further than `stopping_m`, half of it in a period.
    """
    robots = apart(KEPT_M + room_m, first, second)
    coasting = np.zeros(2)  # what each may still move
    stride_m = 0.5 * SHIELD.stopping_m
    for x, y, other_x, other_y, asked in motion:
        for robot in range(2):
            if asked >> robot & 1 and robots.commands[robot, MODE] == HOLD:
                robots.commands[robot, MODE] = DRIVE  # the policy insists
        robots.guarded(steering)
        for robot, (dx, dy) in enumerate([(x, y), (other_x, other_y)]):
            if robots.commands[robot, MODE] != HOLD:
                coasting[robot] = stride_m
                most = stride_m
            else:
                most = min(stride_m, coasting[robot])
            toward = robots.positions[1 - robot] - robots.positions[robot]
            wish = toward / np.linalg.norm(toward) if asked >> 2 & 1 else np.array([dx, dy])
            step = most * wish / max(1.0, math.hypot(*wish))
            robots.positions[robot] += step
            if robots.commands[robot, MODE] == HOLD:
                coasting[robot] -= np.linalg.norm(step)
        assert math.dist(*robots.positions) > DIAMETER_M - 1e-12


def coast(robots, steering, pivot_m, period_s):
    """Steer robots for a period: they move as commanded if a motor runs, and turn about a point."""
    for command, estimate in zip(robots.commands, robots.estimates, strict=True):
        set_points, pose = np.empty(2), estimate[POSE : POSE + 3]
        steer(command, pose[0], pose[1], pose[2], period_s, steering, set_points)
        if set_points.any():
            yaw, angle = command[YAW_RATE], pose[2] + command[COURSE]
            turned = np.exp(1j * pose[2]) * yaw * complex(pivot_m[1], -pivot_m[0])
            speed = command[SPEED] * np.exp(1j * angle) + turned
            pose += period_s * np.array([speed.real, speed.imag, yaw])


@settings(max_examples=15, deadline=None)
@given(
    st.booleans(), st.tuples(*[st.floats(-2e-3, 2e-3)] * 2), angle, angle, st.floats(0.95, 0.999)
)
@example(False, (0.0, 0.0), 0.0, math.pi, 0.99)
@example(False, (2e-3, -2e-3), 0.0, math.pi, 0.99)
@example(True, (0.0, 0.0), 0.0, math.pi, 0.99)
def test_every_machine_gets_out_of_the_room_of_another_one(reverses, pivot_m, first, second, share):
    """Robots of two kinds, that turn on the spot or about a point near it, whatever they face."""
    speed = STEERING.backward_speed_rad_s if reverses else 0.0
    steering = STEERING._replace(backward_speed_rad_s=speed, dither_rad_s=0.0)
    room_m = SHIELD.room_m + (0.0 if reverses else 2.5 * math.hypot(*pivot_m))
    shield, gap_m = SHIELD._replace(room_m=room_m), share * room_m
    robots, least_m = apart(KEPT_M + gap_m, first, second), gap_m
    for _ in range(1500):
        robots.guarded(steering, shield)
        coast(robots, steering, pivot_m if not reverses else (0.0, 0.0), 0.02)
        gap_m = math.dist(*robots.positions) - DIAMETER_M - KEPT_M
        least_m = min(least_m, gap_m)
        if gap_m > room_m:
            break
    assert gap_m > room_m
    assert least_m >= 0.0

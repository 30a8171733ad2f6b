"""Robots against robots: momentum, friction, rigidity; three robots in one episode."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cosim.base.jit import kernel
from cosim.model.config import CoSimConfig
from cosim.model.params import TABLE_I, TABLE_II, TIMING
from cosim.model.scenario import Scenario
from cosim.physics.body_state import ANGULAR_VELOCITY, V_X, VELOCITY, standing_state
from cosim.physics.collision import (
    PairParams,
    find_near_pairs,
    push_apart,
    push_off,
)
from cosim.physics.forces import motor_mounts
from cosim.physics.neighbours import LISTS
from cosim.physics.properties import body_params, properties_of
from cosim.physics.rotation import rotation_matrix
from tests.alone import Constant, CoSimulation, drive

PAIR = PairParams(TABLE_I.diameter_m, TABLE_I.mu_robots, near=2e-3)
BODY = body_params(TABLE_I, TABLE_II, TIMING.dt_s)
PROPERTIES = properties_of(BODY, motor_mounts(TABLE_I, (TABLE_II, TABLE_II)))
RADIUS = TABLE_I.diameter_m / 2.0
speeds = st.floats(-0.02, 0.02)
spins = st.floats(-1.0, 1.0)


@kernel
def push_columns(bodies: np.ndarray, properties: np.ndarray) -> float:
    return push_apart(bodies, properties, 0, 1, PAIR, BODY.inverse_dt)


def push(a: np.ndarray, b: np.ndarray) -> float:
    bodies = np.stack([a, b], axis=1)
    impulse = push_columns(bodies, np.stack([PROPERTIES] * 2, axis=1))
    a[:], b[:] = bodies.T
    return impulse


@kernel
def near_pairs(
    bodies: np.ndarray, first: int, board: np.ndarray, near: np.ndarray, count: int
) -> int:
    robots, lists = bodies.shape[1] - first, np.zeros((LISTS, bodies.shape[1]), dtype=np.int64)
    return find_near_pairs(bodies, first, robots, board, lists, PAIR, near, count)


def touching_pair(angle, velocity_a, velocity_b, spin_a, spin_b, gap=0.0):
    a = standing_state(TABLE_I, 0.1, 0.1, 0.0)
    distance = TABLE_I.diameter_m + gap
    b = standing_state(TABLE_I, 0.1 + distance * np.cos(angle), 0.1 + distance * np.sin(angle), 0.0)
    a[VELOCITY][:2], b[VELOCITY][:2] = velocity_a, velocity_b
    a[ANGULAR_VELOCITY][2], b[ANGULAR_VELOCITY][2] = spin_a, spin_b
    return a, b


def angular_momentum(*bodies):
    """About the world's origin, z, in N m s."""
    total = 0.0
    for body in bodies:
        orbit = body[0] * body[8] - body[1] * body[7]
        total += TABLE_I.mass_kg * orbit + BODY.inertia[2] * body[12]
    return total


def kinetic_energy(*bodies):
    return sum(
        0.5 * TABLE_I.mass_kg * (b[VELOCITY] ** 2).sum() + 0.5 * BODY.inertia[2] * b[12] ** 2
        for b in bodies
    )


@given(st.floats(0.0, 6.28), st.tuples(speeds, speeds), st.tuples(speeds, speeds), spins, spins)
def test_contact_keeps_momenta_and_never_adds_energy(angle, va, vb, spin_a, spin_b):
    a, b = touching_pair(angle, va, vb, spin_a, spin_b)
    linear = a[VELOCITY] + b[VELOCITY]
    angular, energy = angular_momentum(a, b), kinetic_energy(a, b)
    normal = np.array([np.cos(angle), np.sin(angle)])
    before = b[VELOCITY][:2] - a[VELOCITY][:2]
    impulse = push(a, b)
    assert a[VELOCITY] + b[VELOCITY] == pytest.approx(linear, abs=1e-16)
    assert angular_momentum(a, b) == pytest.approx(angular, abs=1e-16)
    assert kinetic_energy(a, b) <= energy + 1e-18
    change = b[VELOCITY][:2] - a[VELOCITY][:2] - before
    pushed = change @ normal * TABLE_I.mass_kg / 2.0
    rubbed = np.hypot(*change) ** 2 * (TABLE_I.mass_kg / 2.0) ** 2 - pushed**2
    assert pushed == pytest.approx(impulse, abs=1e-15)
    assert rubbed <= (PAIR.mu * impulse) ** 2 * (1.0 + 1e-9) + 1e-24


def test_head_on_contact_is_inelastic_and_robots_apart_are_left_alone():
    a, b = touching_pair(0.0, (0.01, 0.0), (-0.01, 0.0), 0.0, 0.0)
    assert push(a, b) == pytest.approx(0.01 * TABLE_I.mass_kg)
    np.testing.assert_allclose([a[VELOCITY], b[VELOCITY]], 0.0, atol=1e-11)
    a, b = touching_pair(0.0, (0.01, 0.0), (-0.01, 0.0), 0.0, 0.0, gap=1e-4)
    before = a.copy(), b.copy()
    assert push(a, b) == 0.0
    np.testing.assert_array_equal((a, b), before)


@pytest.mark.parametrize(("spin_b", "rubs"), [(0.0, True), (1.0, True), (-1.0, False)])
def test_robots_spin_each_other_like_gears_and_rub_unless_they_roll(spin_b, rubs):
    """A spinning robot turns the other one the opposite way; opposite spins have one velocity."""
    a, b = touching_pair(0.0, (0.01, 0.0), (0.0, 0.0), 1.0, spin_b)
    assert push(a, b) > 0.0
    assert (a[12] < 1.0) == (b[12] < spin_b) == (b[8] > 0.0) == rubs


places = st.tuples(st.floats(-0.011, 0.011), st.floats(-0.011, 0.011))


@given(
    st.floats(0.0, 6.28),
    st.tuples(places, places),
    st.tuples(speeds, speeds, spins),
    st.tuples(speeds, speeds, spins),
    st.floats(0.0, 3.0),
)
def test_contact_of_rims_off_the_centres_of_mass_keeps_momenta_and_adds_no_energy(
    angle, centres, motion_a, motion_b, mu
):
    """Normals end in the speed that the gap allows, within Coulomb's cone unless it jams."""
    a, b = touching_pair(angle, motion_a[:2], motion_b[:2], motion_a[2], motion_b[2])
    a[3], a[6] = np.cos(0.4), np.sin(0.4)
    machines = [TABLE_I._replace(com_x_m=x, com_y_m=y) for x, y in centres]
    columns = np.stack(
        [
            properties_of(
                body_params(robot, TABLE_II, TIMING.dt_s),
                motor_mounts(robot, (TABLE_II, TABLE_II)),
            )
            for robot in machines
        ],
        axis=1,
    )
    normal = np.array([np.cos(angle), np.sin(angle)])

    def balance(bodies: np.ndarray) -> tuple[np.ndarray, float, float, float]:
        """Linear and angular momentum, energy, and the speed at which rims part."""
        linear, angular, energy, parting = np.zeros(2), 0.0, 0.0, 0.0
        for body, centre, sign in zip(bodies.T, centres, (-1.0, 1.0), strict=True):
            turn = np.array(rotation_matrix(tuple(body[3:7])))[:2, :2]
            arm, velocity, spin = turn @ centre, body[7:9], body[12]
            x, y = body[:2] + arm
            linear += TABLE_I.mass_kg * velocity
            angular += TABLE_I.mass_kg * (x * velocity[1] - y * velocity[0])
            angular += BODY.inertia[2] * spin
            energy += 0.5 * TABLE_I.mass_kg * velocity @ velocity
            energy += 0.5 * BODY.inertia[2] * spin**2
            rim = -sign * RADIUS * normal - arm
            parting += sign * (velocity + spin * np.array([-rim[1], rim[0]])) @ normal
        return linear, angular, energy, parting

    bodies = np.stack([a, b], axis=1)
    before = balance(bodies)
    impulse = push_columns_with(bodies, columns, PAIR._replace(mu=mu))
    after = balance(bodies)
    assert after[0] == pytest.approx(before[0], abs=1e-15)
    assert after[1] == pytest.approx(before[1], abs=1e-15)
    assert after[2] <= before[2] + 1e-16
    assert (impulse > 0.0) == (before[3] < -1e-9) or abs(before[3]) < 1e-9
    if impulse > 0.0:
        assert after[3] == pytest.approx(0.0, abs=1e-9)


@kernel
def push_columns_with(bodies: np.ndarray, properties: np.ndarray, pair: PairParams) -> float:
    return push_apart(bodies, properties, 0, 1, pair, BODY.inverse_dt)


@kernel
def push_wall(bodies: np.ndarray, properties: np.ndarray, rectangle: np.ndarray) -> float:
    return push_off(bodies, properties, 0, rectangle, PAIR, BODY.inverse_dt)


def against(rectangle, body):
    bodies = body[:, None].copy()
    impulse = push_wall(bodies, PROPERTIES[:, None].copy(), np.array(rectangle))
    return bodies[:, 0], impulse


# robot at (0.1, 0.1): left of, above and at a corner of an obstacle, with the normal to the robot
WALLS = {
    "edge": ((0.1 + RADIUS, 0.0, 0.3, 0.3), (-1.0, 0.0)),
    "top": ((0.0, 0.0, 0.3, 0.1 - RADIUS), (0.0, 1.0)),
    "corner": ((0.1 + 0.6 * RADIUS, 0.1 + 0.8 * RADIUS, 0.3, 0.3), (-0.6, -0.8)),
}


@pytest.mark.parametrize("wall", WALLS)
@given(velocity=st.tuples(speeds, speeds), spin=spins)
def test_obstacles_push_and_rub_but_add_no_energy(wall, velocity, spin):
    rectangle, normal = WALLS[wall]
    before = standing_state(TABLE_I, 0.1, 0.1, 0.0)
    before[VELOCITY][:2], before[12] = velocity, spin
    after, impulse = against(rectangle, before)
    normal = np.array(normal)
    approach = before[VELOCITY][:2] @ normal
    assert impulse == pytest.approx(TABLE_I.mass_kg * max(0.0, -approach), abs=1e-12)
    change = TABLE_I.mass_kg * (after[VELOCITY] - before[VELOCITY])[:2]
    rubbed = change @ (-normal[1], normal[0])
    assert change @ normal == pytest.approx(impulse, abs=1e-15)
    assert abs(rubbed) <= PAIR.mu * impulse * (1.0 + 1e-9) + 1e-18
    turned = BODY.inertia[2] * (after[12] - before[12])
    assert turned == pytest.approx(-RADIUS * rubbed, abs=1e-17)
    assert kinetic_energy(after) <= kinetic_energy(before) + 1e-15
    slip = after[VELOCITY][:2] @ (-normal[1], normal[0]) - RADIUS * after[12]
    if impulse > 0.0 and abs(rubbed) < 0.999 * PAIR.mu * impulse:
        assert slip == pytest.approx(0.0, abs=1e-12)


def test_an_obstacle_out_of_reach_does_nothing():
    body = standing_state(TABLE_I, 0.1, 0.1, 0.0)
    body[VELOCITY] = 0.02, 0.0, 0.0
    after, impulse = against((0.1 + RADIUS + 1e-5, 0.0, 0.3, 0.3), body)
    assert impulse == 0.0
    assert np.array_equal(after, body)


@given(
    st.integers(0, 2**32 - 1),
    st.integers(1, 200),
    st.sampled_from([(0.3, 0.3), (5.0, 0.1), (0.06, 2.0), (np.inf, np.inf), (1.5, 1.5)]),
)
def test_near_pairs_are_found_in_the_order_of_looking_at_all(seed, robots, board):
    rng, first = np.random.default_rng(seed), 3
    bodies = np.zeros((25, first + robots))
    size = np.minimum(board, 1.0)  # some are off the board
    bodies[:2, first:] = rng.uniform(-0.1, 1.1, (2, robots)) * size[:, None]
    near = np.zeros((1 + robots**2, 2), dtype=np.int64)  # the first pair is of another episode
    found = near[1 : near_pairs(bodies, first, np.array(board), near, 1)]
    reach = TABLE_I.diameter_m + PAIR.near
    expected = [
        [i, j]
        for i in range(first, first + robots)
        for j in range(first, i)
        if ((bodies[:2, i] - bodies[:2, j]) ** 2).sum() < reach**2
    ]
    assert found.tolist() == expected


def test_collision_of_three_is_reported(motor_fmu):
    """Of three robots, of which two head for each other."""
    starts = (((5, 5),), ((11, 5),), ((25, 5),))
    row = Scenario("row", "", ((5, 20), (11, 20), (25, 20)), starts)
    system, steps = drive(row, motor_fmu, Constant(0, 4, 2))
    assert system.episode.outcome == "collision"
    position = steps[-1].samples.position[-1, :, :2]
    assert np.linalg.norm(position[0] - position[1]) == pytest.approx(0.05, abs=5e-6)


def test_small_robots_drive_on_where_large_ones_would_touch(motor_fmu, straight_policy):
    starts = ((8, 5), (12, 5))
    small = Scenario(
        "small", "", ((8, 7), (12, 7)), tuple((cell,) for cell in starts), robot_diameter_m=0.03
    )
    system, _ = drive(small, motor_fmu, straight_policy(small.targets))
    assert system.episode.outcome == "success"
    assert system.config.robot.diameter_m == 0.03
    assert 0.03 < system.episode.measures.min_distance_m < 0.05


def test_robots_touch_within_a_long_control_period(motor_fmu):
    """Two robots that close 1 cm at 0.9 m/s, on ice, in the first of the periods of 20 ms."""
    usual = CoSimConfig().having("given", mu=0.0, relative_amplitude=0.0)
    timing = usual.timing._replace(control_period_s=0.02, rl_step_s=0.04, burst_s=0.02)
    config = replace(
        usual, timing=timing, noise=usual.noise._replace(hold_s=0.02), on_collision="continue"
    )
    starts = ((10, 15), (16, 15))
    scenario = Scenario("ice", "", ((0, 0), (29, 29)), tuple((cell,) for cell in starts))
    system = CoSimulation(scenario, motor_fmu, config)
    system.reset(starts, 0)
    system.state.bodies.motion[V_X, 0] = 0.9
    step = system.step(np.array([0, 0]))
    apart = np.diff(step.raw.position[:, :, 0], axis=1)
    assert apart.min() > config.robot.diameter_m - 1e-6
    assert step.samples.touching_share[0].all()
    system.close()

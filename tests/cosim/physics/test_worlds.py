"""Bodies in worlds that are not ideal: impacts, payloads and patches against closed forms."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cosim.base.jit import kernel
from cosim.model.params import TABLE_I, TABLE_II, TIMING
from cosim.model.world import World
from cosim.physics.body_state import (
    ANGULAR_VELOCITY,
    POSITION,
    QUATERNION,
    VELOCITY,
    standing_state,
)
from cosim.physics.feet import foot_positions
from cosim.physics.forces import motor_mounts
from cosim.physics.inertia import BodyParams, about_centre, at_axis
from cosim.physics.mass import mass_of
from cosim.physics.properties import MU, body_params, feel_patches
from cosim.physics.properties import properties_of as column_of
from cosim.physics.rotation import rotation_matrix
from tests.references.prescribed import NORMAL_IMPULSE, coast, energy, solved_out, step_body

DT, G = TIMING.dt_s, TABLE_II.g
HEAVY = World(payload_g=20.0, payload_offset_mm=(8.0, -5.0))


def standing(height_m: float = 0.0) -> np.ndarray:
    state = standing_state(TABLE_I, 0.1, 0.2, 0.0)
    state[2] += height_m
    return state


@kernel
def highest(state: np.ndarray, params: BodyParams, ticks: int) -> float:
    found = 0.0
    for _ in range(ticks):
        step_body(state, params, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
        found = max(found, state[2])
    return found


@kernel
def fill_energies(state: np.ndarray, params: BodyParams, energies: np.ndarray) -> None:
    for k in range(len(energies)):
        energies[k] = energy(state, params)
        step_body(state, params, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))


def energies_of(state: np.ndarray, params: BodyParams, ticks: int) -> np.ndarray:
    energies = np.empty(ticks)
    fill_energies(state, params, energies)
    return energies


@pytest.mark.parametrize("restitution", [0.0, 0.3, 0.5, 0.9])
def test_a_flat_drop_bounces_to_the_square_of_the_restitution(restitution):
    """To the scheme's accuracy: within a tick of the impact's speed in height."""
    drop_m = 2e-3
    params = body_params(TABLE_I, TABLE_II, DT, world=World(restitution=restitution))
    state, rest = standing(drop_m), TABLE_I.com_height_m
    speed = math.sqrt(2.0 * G * drop_m)
    coast(state, params, math.ceil(speed / G / DT) + 2)
    risen = highest(state, params, 2000) - rest
    assert risen == pytest.approx(restitution**2 * drop_m, abs=2.0 * speed * DT)


@pytest.mark.parametrize("restitution", [0.2, 0.5, 0.8])
def test_dropped_robots_come_to_rest_and_stay(restitution):
    params = body_params(TABLE_I, TABLE_II, DT, world=World(restitution=restitution))
    state = standing()
    coast(state, params, 2000)
    at_rest = state[POSITION].copy()
    np.testing.assert_allclose(at_rest, standing()[POSITION], atol=1e-11)
    coast(state, params, 100_000)
    assert state[POSITION].tolist() == at_rest.tolist()
    state = standing(5e-4)
    coast(state, params, 100_000)
    assert abs(state[2] - TABLE_I.com_height_m) < 1e-11
    assert np.abs(state[VELOCITY]).max() < 1e-12


@settings(max_examples=settings().max_examples // 2)
@given(
    tilt=st.tuples(*[st.floats(-0.1, 0.1)] * 2),
    velocity=st.tuples(*[st.floats(-0.3, 0.3)] * 3),
    omega=st.tuples(*[st.floats(-5.0, 5.0)] * 3),
    restitution=st.floats(0.0, 0.5),
    mu=st.floats(0.0, 0.4),
)
def test_throws_that_bounce_gain_no_energy(tilt, velocity, omega, restitution, mu):
    """Up to e = 0.5; a throw is some 1e-2 J. Bounces below a tick's fall may gain 1e-9 J.

    Beyond, Newton's law with friction can gain energy (Kane and Levinson 1985): at e = 0.9 2 %.
    """
    world = World(restitution=restitution, payload_g=20.0, payload_offset_mm=(8.0, -5.0))
    robot = TABLE_I._replace(mu=mu)
    params = solved_out(body_params(robot, TABLE_II, DT, tolerance=1e-7, world=world))
    state = standing(1e-3 + TABLE_I.foot_radius_m * (abs(tilt[0]) + abs(tilt[1])) * 1.5)
    q = np.array([1.0, tilt[0] / 2.0, tilt[1] / 2.0, 0.0])
    state[QUATERNION] = q / np.linalg.norm(q)
    state[VELOCITY], state[ANGULAR_VELOCITY] = velocity, omega
    energies = energies_of(state, params, 5000)
    assert np.diff(energies).max() < 1e-8


def test_a_free_body_with_a_payload_keeps_momenta_and_energy():
    params = body_params(TABLE_I, TABLE_II, DT, gravity=(0.0, 0.0, 0.0), world=HEAVY)
    tensor = np.diag(params.inertia)
    tensor[0, 1] = tensor[1, 0] = params.product
    np.testing.assert_allclose(np.linalg.inv(tensor), mass_of(TABLE_I, HEAVY).inverse_tensor())
    state = standing(1.0)
    state[VELOCITY], state[ANGULAR_VELOCITY] = (0.1, -0.2, 0.3), (0.5, 0.7, -0.4)

    def momentum():
        return np.array(rotation_matrix(tuple(state[QUATERNION]))) @ (
            tensor @ state[ANGULAR_VELOCITY]
        )

    def centre_of_mass():
        matrix = np.array(rotation_matrix(tuple(state[QUATERNION])))
        return state[POSITION] + matrix @ (*params.centre, 0.0)

    before, start = momentum(), centre_of_mass()
    energies = energies_of(state, params, 50_000)
    moved = centre_of_mass() - start  # on a straight line, while the axis turns about it
    np.testing.assert_allclose(moved, 50_000 * DT * state[VELOCITY], rtol=1e-11)
    assert state[VELOCITY].tolist() == [0.1, -0.2, 0.3]
    assert np.linalg.norm(momentum() - before) < 3e-12 * np.linalg.norm(before)
    np.testing.assert_allclose(energies, energies[0], rtol=3e-12)


def test_mass_properties_are_those_of_two_bodies():
    """Against the sum over the robot's and the payload's own tensors about the common centre."""
    mass, payload = mass_of(TABLE_I, HEAVY), 0.02
    alone = mass_of(TABLE_I)
    offset = np.array([8e-3, -5e-3, 0.0])
    centre = payload * offset / (TABLE_I.mass_kg + payload)
    expected = np.diag(alone.inertia)
    for m, r in ((TABLE_I.mass_kg, -centre), (payload, offset - centre)):
        expected += m * (r @ r * np.eye(3) - np.outer(r, r))
    found = np.diag(mass.inertia)
    found[0, 1] = found[1, 0] = mass.product
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-20)
    np.testing.assert_allclose((*mass.centre, 0.0), centre)


def test_moments_and_velocities_refer_to_the_centre_of_mass():
    """A force at the axis has the moment −s × f about a centre s; the axis moves by v − ω × s."""
    params = body_params(TABLE_I, TABLE_II, DT, world=HEAVY)
    centre = np.array([*mass_of(TABLE_I, HEAVY).centre, 0.0])
    first, second = (0.3, -0.2, 0.5), (1.0, 0.7, -0.4)
    expected = first - np.cross(centre, second)
    np.testing.assert_allclose(about_centre(first, second, params), expected, rtol=1e-12)
    expected = first - np.cross(second, centre)
    np.testing.assert_allclose(at_axis(first, second, params), expected, rtol=1e-12)


def test_feet_carry_an_offset_payload_as_a_tripod_does():
    """Normal forces balance the weight at the common centre of mass; nothing moves."""
    params = solved_out(body_params(TABLE_I, TABLE_II, DT, tolerance=1e-9, world=HEAVY))
    state, mass = standing(), mass_of(TABLE_I, HEAVY)
    coast(state, params, 20_000)
    forces = state[NORMAL_IMPULSE] / DT
    feet = foot_positions(TABLE_I)[:, :2] - mass.centre
    equations = np.vstack([np.ones(3), feet.T])
    expected = np.linalg.solve(equations, [mass.total * G, 0.0, 0.0])
    np.testing.assert_allclose(forces, expected, rtol=1e-5)
    assert forces.max() > 1.2 * forces.min()
    np.testing.assert_allclose(state[POSITION], standing()[POSITION], atol=1e-10)


@kernel
def feel(properties: np.ndarray, bodies: np.ndarray, patches: np.ndarray, common: BodyParams):
    feel_patches(properties, bodies, 0, patches, common)


@pytest.mark.parametrize("heading", [0.0, 1.0, math.pi])
def test_every_foot_feels_the_last_patch_that_it_stands_on(heading):
    params = body_params(TABLE_I, TABLE_II, DT, world=HEAVY)
    column = column_of(params, motor_mounts(TABLE_I, (TABLE_II, TABLE_II)))[:, None].copy()
    body = standing_state(TABLE_I, 0.1, 0.2, heading)[:, None]
    patches = np.array(
        [[0.0, 0.0, 0.1, 1.0, 0.3], [0.0, 0.0, 1.0, 0.2, 0.5], [math.inf] * 4 + [math.inf]]
    )
    feel(column, body, patches, params)
    turn = np.array(
        [[math.cos(heading), -math.sin(heading)], [math.sin(heading), math.cos(heading)]]
    )
    expected = []
    for foot in foot_positions(TABLE_I):
        x, y = turn @ foot[:2] + (0.1, 0.2)
        expected.append(0.5 if y < 0.2 else 0.3 if x < 0.1 else TABLE_I.mu)
    assert column[MU : MU + 3, 0].tolist() == expected
    assert column[MU + 3, 0] == TABLE_I.mu
    assert len(set(expected)) > 1

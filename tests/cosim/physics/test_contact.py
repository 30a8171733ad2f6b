"""The contact solver: constants, one gradient step, and the laws its solutions obey."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cosim.model.params import TABLE_I, TABLE_II, TIMING
from cosim.physics import body_state, feet, properties
from cosim.physics.contact import rigid as contact
from tests.references.prescribed import FRICTION_IMPULSE, NORMAL_IMPULSE, coast, solved_out

PARAMS, MU = contact.rigid_contact(TABLE_I, 0.0), TABLE_I.mu
# Contacts iterated until nothing changes: their laws then hold to rounding.
CONVERGED = solved_out(properties.body_params(TABLE_I, TABLE_II, TIMING.dt_s, tolerance=1e-10))

velocity = st.floats(-0.2, 0.2)
velocities = st.tuples(velocity, velocity, velocity)
impulses = st.floats(-1e-5, 1e-5)


def test_feet_are_an_equilateral_triangle_symmetric_in_every_bit():
    a, b, c = feet.foot_positions(TABLE_I)
    sides = [math.dist(a, b), math.dist(b, c), math.dist(c, a)]
    assert sides == pytest.approx([math.sqrt(3.0) * TABLE_I.foot_radius_m] * 3)
    assert (a[0], a[1], a[2]) == (c[0], -c[1], c[2])
    assert b[1] == 0.0
    assert a[0] > 0.0 > b[0]


def test_delassus_maps_impulses_to_foot_velocities():
    """Column by column against the impulse equations of the body."""
    operator = feet.delassus(TABLE_I)
    np.testing.assert_allclose(operator, operator.T, atol=1e-9)
    assert np.linalg.matrix_rank(operator) == 6  # so that friction of sticking feet is not unique
    places = feet.foot_positions(TABLE_I)
    inertia = np.array(CONVERGED.inertia)
    for column, impulse in enumerate(np.eye(9)):
        p = impulse.reshape(3, 3)
        v = p.sum(axis=0) / TABLE_I.mass_kg
        omega = np.cross(places, p).sum(axis=0) / inertia
        np.testing.assert_allclose(operator[:, column], (v + np.cross(omega, places)).ravel())


@pytest.mark.parametrize("radius_m", [0.005, 0.023, 0.1])
@pytest.mark.parametrize("height_m", [0.003, 0.015, 0.05])
def test_step_sizes_make_sweeps_contractions(radius_m, height_m):
    robot = TABLE_I.spread(radius_m / 0.023)._replace(com_height_m=height_m)
    params = contact.rigid_contact(robot, 0.0)
    tangential, normal = params.step_tangential, params.step_normal
    steps = np.array([tangential, tangential, normal] * 3)
    root = np.sqrt(steps)
    spectrum = np.linalg.eigvalsh(np.outer(root, root) * feet.delassus(robot))
    assert spectrum[0] > -1e-12
    assert spectrum[-1] == pytest.approx(1.0)


@given(st.floats(1e-9, 1e-3))
def test_a_foot_may_close_its_gap_but_not_pass_it(gap):
    dt = TIMING.dt_s
    assert contact.allowed_approach(gap, 1.0 / dt) * dt == pytest.approx(-gap)
    outward = contact.allowed_approach(-gap, 1.0 / dt) * dt
    assert outward == pytest.approx(contact.GAP_CORRECTION * gap)


@given(
    st.floats(0.0, 1e-5),
    st.tuples(impulses, impulses),
    velocities,
    st.tuples(st.floats(-0.3, 0.3), st.floats(-0.3, 0.3)),
)
def test_every_gradient_step_ends_inside_the_cone(pressed, friction, speed, tilt):
    length = math.hypot(*tilt, 1.0)
    normal = (tilt[0] / length, tilt[1] / length, 1.0 / length)
    start = (pressed, (*friction, 0.0))
    after, q = contact.gradient_step(start, speed, normal, 0.0, MU, PARAMS)
    assert after >= 0.0
    # Squares of impulses below 1e-154 underflow.
    assert math.hypot(*q) <= MU * after * (1.0 + 1e-15) + 1e-150


def test_a_foot_that_leaves_carries_nothing():
    start = (1e-7, (1e-8, 0.0, 0.0))
    after = contact.gradient_step(start, (0.1, 0.0, 1.0), (0.0, 0.0, 1.0), 0.0, MU, PARAMS)
    assert after == (0.0, (0.0, 0.0, 0.0))


@given(velocities, st.tuples(*[st.floats(-3.0, 3.0)] * 3), st.floats(0.0, 0.5))
def test_solutions_obey_signorini_and_coulomb(v, omega, mu):
    """After an impact: no foot enters the floor, none that leaves is pressed, friction opposes.

    Signorini: λ ≥ 0, u_N ≥ 0, λ u_N = 0. Coulomb: |q| ≤ μ λ, and sliding feet have q = −μ λ t.
    """
    params = CONVERGED._replace(feet=CONVERGED.feet._replace(mu=(mu, mu, mu)))
    state = body_state.standing_state(TABLE_I, 0.0, 0.0, 0.0)
    state[body_state.VELOCITY], state[body_state.ANGULAR_VELOCITY] = v, omega
    before = state.copy()
    coast(state, params, 1)

    # The body stood upright: body and world frames agree in this one step.
    pressed = state[NORMAL_IMPULSE]
    friction = state[FRICTION_IMPULSE].reshape(3, 3)
    places = feet.foot_positions(TABLE_I)
    moved = state[body_state.VELOCITY] + np.cross(state[body_state.ANGULAR_VELOCITY], places)
    size = np.abs(np.concatenate([v, omega])).max() + 1e-3
    assert np.all(pressed >= 0.0)
    assert np.all(moved[:, 2] >= -1e-7 * size)
    np.testing.assert_allclose(pressed * moved[:, 2], 0.0, atol=1e-9 * size)
    limit = mu * pressed
    assert np.all(np.linalg.norm(friction, axis=1) <= limit * (1.0 + 1e-12) + 1e-20)
    np.testing.assert_allclose(friction[:, 2], 0.0, atol=1e-18)
    slide = np.linalg.norm(moved[:, :2], axis=1, keepdims=True)
    sliding = slide[:, 0] > 1e-4 * size
    expected = -limit[:, None] * moved[:, :2] / slide.clip(1e-30)
    np.testing.assert_allclose(
        friction[sliding, :2], expected[sliding], atol=1e-3 * limit.max() + 1e-15
    )
    # Impulse and momentum balance.
    total = friction.sum(axis=0)
    total[2] += pressed.sum()
    change = (state - before)[body_state.VELOCITY] - np.array(params.gravity) * params.dt
    np.testing.assert_allclose(total, TABLE_I.mass_kg * change, atol=1e-15)

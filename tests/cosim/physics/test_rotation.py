"""Rotations against numpy's linear algebra and the axis-angle formula."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cosim.physics import rotation

component = st.floats(-10.0, 10.0).map(lambda x: x if abs(x) > 1e-6 else 0.0)
vector = st.tuples(component, component, component)
quaternion = (
    st.tuples(component, component, component, component)
    .filter(lambda q: math.hypot(*q) > 1e-3)
    .map(lambda q: tuple(c / math.hypot(*q) for c in q))
)


@given(vector, vector)
def test_products_are_those_of_numpy(a, b):
    assert rotation.dot(a, b) == pytest.approx(np.dot(a, b), abs=1e-12)
    np.testing.assert_allclose(rotation.cross(a, b), np.cross(a, b), atol=1e-12)
    np.testing.assert_allclose(rotation.plus(a, 2.5, b), np.array(a) + 2.5 * np.array(b))


@given(quaternion)
def test_matrix_is_a_rotation(q):
    matrix = np.array(rotation.rotation_matrix(q))
    np.testing.assert_allclose(matrix @ matrix.T, np.eye(3), atol=1e-14)
    assert np.linalg.det(matrix) == pytest.approx(1.0, abs=1e-14)


@given(quaternion, vector)
def test_frames_and_back(q, v):
    matrix = rotation.rotation_matrix(q)
    world = rotation.to_world(matrix, v)
    np.testing.assert_allclose(world, np.array(matrix) @ v, atol=1e-13)
    np.testing.assert_allclose(rotation.to_body(matrix, world), v, atol=1e-13)


@given(quaternion, vector)
def test_rotated_is_the_cayley_map(q, v):
    """(1 − r̂/2)⁻¹ (1 + r̂/2): the rotation about r by 2 atan(|r|/2), in the body frame."""
    r = tuple(0.001 * c for c in v)  # up to 1700 rad/s times dt, 1000 times what a robot reaches
    hat = np.array([[0.0, -r[2], r[1]], [r[2], 0.0, -r[0]], [-r[1], r[0], 0.0]])
    cayley = np.linalg.solve(np.eye(3) - hat / 2.0, np.eye(3) + hat / 2.0)
    expected = np.array(rotation.rotation_matrix(q)) @ cayley
    after = rotation.rotated(q, r)
    error = 1e-14 + math.hypot(*r) ** 4  # what the docstring promises
    np.testing.assert_allclose(rotation.rotation_matrix(after), expected, atol=error)


def test_rotated_quaternions_stay_unit_vectors():
    q = (1.0, 0.0, 0.0, 0.0)
    for _ in range(10_000):
        q = rotation.rotated(q, (1e-4, -2e-4, 3e-4))
    assert math.hypot(*q) == pytest.approx(1.0, abs=1e-14)


@given(st.floats(-3.1, 3.1))
def test_heading_of_a_turn_about_the_vertical(angle):
    q = (math.cos(angle / 2.0), 0.0, 0.0, math.sin(angle / 2.0))
    assert rotation.heading(q) == pytest.approx(angle, abs=1e-14)


@given(st.floats(-100.0, 100.0))
def test_wrapped_is_the_same_direction(angle):
    wrapped = rotation.wrapped(angle)
    assert -math.pi <= wrapped < math.pi
    assert math.sin(wrapped - angle) == pytest.approx(0.0, abs=1e-12)
    assert math.cos(wrapped - angle) == pytest.approx(1.0, abs=1e-12)


def test_compiled_and_plain_python_agree_in_every_bit():
    q, v = (0.5, -0.1, 0.7, 0.5), (0.3, -2.0, 1.1)
    q = tuple(c / math.hypot(*q) for c in q)
    assert rotation.rotation_matrix(q) == rotation.rotation_matrix.py_func(q)  # pyright: ignore
    assert rotation.cross(q[:3], v) == rotation.cross.py_func(q[:3], v)  # pyright: ignore

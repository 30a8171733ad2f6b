"""Forces of eccentric masses against the mechanics of the point mass itself."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cosim.model.params import TABLE_I, TABLE_II
from cosim.physics.forces import motor_force, motor_mounts, motor_wrench, platform_force

D, E = motor_mounts(TABLE_I, (TABLE_II, TABLE_II))
angles = st.floats(-10.0, 10.0)
speeds = st.floats(-1500.0, 1500.0)
accelerations = st.floats(-1e5, 1e5)


def newton(mount, theta, omega, omega_dot):
    """Force on the body: weight of the point mass minus m times its acceleration.

    It hangs at (0, 0, −r) for θ = 0 and turns about the axis sin φ·y. With d²/dt² of its position
    by the chain rule, derivatives with respect to θ by differences.
    """

    def position(angle):
        return np.array([-mount.r * math.sin(angle) * mount.axis[1], -mount.r * math.cos(angle)])

    h = 1e-3
    first = (position(theta + h) - position(theta - h)) / (2.0 * h)
    second = (position(theta + h) - 2.0 * position(theta) + position(theta - h)) / h**2
    acceleration = first * omega_dot + second * omega**2
    return np.array([0.0, -mount.m * mount.g]) - mount.m * acceleration


@pytest.mark.parametrize("mount", [D, E], ids="DE")
@given(theta=angles, omega=speeds, omega_dot=accelerations)
def test_eq_3_is_newtons_law_for_the_eccentric_mass(mount, theta, omega, omega_dot):
    f_x, f_z, _ = motor_force(mount, theta, omega, omega_dot)
    size = mount.m * (mount.g + mount.r * (omega**2 + abs(omega_dot)))
    np.testing.assert_allclose((f_x, f_z), newton(mount, theta, omega, omega_dot), atol=1e-6 * size)


@given(theta=angles, omega=speeds)
def test_eq_1_is_eq_3_at_constant_speed(theta, omega):
    """Y of Fig. 2 is −X of motor D: there the mass turns the other way about the axis."""
    f_x, f_z, _ = motor_force(D, theta, omega, 0.0)
    f_oy, f_oz = platform_force(D.m, D.r, D.g, theta, omega)
    assert f_oy == pytest.approx(-f_x, rel=1e-12, abs=1e-15)
    assert f_oz == pytest.approx(f_z, rel=1e-12)


@pytest.mark.parametrize("mount", [D, E], ids="DE")
def test_stator_feels_the_reaction_of_the_rotor(mount):
    """Held horizontally the mass pulls with m g r; speeding up takes J ω̇; the stator has −both."""
    _, _, held = motor_force(mount, math.pi / 2.0, 0.0, 0.0)
    assert held * mount.axis[1] == pytest.approx(-mount.m * mount.g * mount.r)
    _, _, speeding = motor_force(mount, 0.0, 0.0, 1e4)
    assert speeding * mount.axis[1] == pytest.approx(-mount.J * 1e4)


@pytest.mark.parametrize("mount", [D, E], ids="DE")
@given(theta=angles, omega=speeds, omega_dot=accelerations)
def test_wrench_is_force_at_the_mount_plus_moment(mount, theta, omega, omega_dot):
    f_x, f_z, n_y = motor_force(mount, theta, omega, omega_dot)
    moment = np.cross([0.0, mount.y, mount.z], [f_x, 0.0, f_z])
    moment[1] += n_y
    force, found = motor_wrench(mount, theta, omega, omega_dot)
    np.testing.assert_allclose(force, [f_x, 0.0, f_z], rtol=1e-12, atol=1e-18)
    np.testing.assert_allclose(found, moment, rtol=1e-12, atol=1e-18)


@given(theta=angles, omega=speeds, omega_dot=accelerations)
def test_mirror_image_in_every_bit(theta, omega, omega_dot):
    """E turning backwards is the mirror image (y → −y) of D: X, Z and Y moments equal."""
    force, (t_x, t_y, t_z) = motor_wrench(D, theta, omega, omega_dot)
    mirrored = motor_wrench(E, -theta, -omega, -omega_dot)
    assert mirrored == (force, (-t_x, t_y, -t_z))


def test_mounts_stand_where_fig_4_puts_them():
    assert (D.y, D.axis[1]) == (0.0225, 1.0)
    assert (E.y, E.axis[1]) == (-0.0225, -1.0)
    assert D.z == E.z == 0.003 - TABLE_I.com_height_m


@given(theta=angles, omega=speeds, omega_dot=accelerations)
def test_shafts_across_the_body_are_those_of_any_direction(theta, omega, omega_dot):
    for mount in (D, E):
        usual = motor_wrench(mount, theta, omega, omega_dot)
        found = motor_wrench(mount._replace(across=False), theta, omega, omega_dot)
        np.testing.assert_allclose(found, usual, rtol=1e-12, atol=1e-15)

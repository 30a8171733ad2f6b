"""Forces of eccentric masses: Eq. (1) for the 1-DOF platform, Eq. (3) for the robot's motors.

Angles θ grow from the hanging position. Kernels are stateless and take scalars.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from cosim.base.jit import inlined, unrolled
from cosim.model.params import MotorParams, RobotParams, level_share
from cosim.physics.rotation import Vector, cross, dot, plus
from cosim.physics.trig import sine_cosine

_VERTICAL = 1e-9  # sine of the angle from a shaft to the vertical, below which nothing hangs


class MotorMount(NamedTuple):
    """Eccentric mass and mounting of one motor in the body frame."""

    m: float  # eccentric mass in kg
    r: float  # eccentricity in m
    J: float  # rotor inertia in kg m²
    g: float  # gravitational acceleration in m/s²
    weight: float  # of the eccentric mass in N; 0 where that of the body includes it
    # x, y, z: mount position from the robot's axis and the height of the centre of mass, m
    x: float
    y: float
    z: float
    axis: Vector  # of the shaft, unit vector
    hanging: Vector  # unit vector from the shaft to the eccentric mass at θ = 0
    ahead: Vector  # the same at θ = π/2
    # Whether the shaft is along the body's y axis and x = 0, as in Fig. 4b: the paper's robot then
    # does not compute with zeros, which would take a tenth of a tick
    across: bool


def motor_mounts(robot: RobotParams, motors: Sequence[MotorParams]) -> tuple[MotorMount, ...]:
    """Mounts of a robot's motors with the parameters of each, in their order."""
    found = []
    for mount, own in zip(robot.motors, motors, strict=True):
        x, y, height = mount.place_m
        weight = 0.0 if robot.masses_included else own.m * own.g
        place = x, y, height - robot.com_height_m
        shaft = mount.axis, *directions(mount.axis), x == 0.0 == 1.0 - abs(mount.axis[1])
        found.append(MotorMount(own.m, own.r, own.J, own.g, weight, *place, *shaft))
    return tuple(found)


def directions(axis: Vector) -> tuple[Vector, Vector]:
    """Directions of a mass that hangs from a shaft, and a quarter of a turn later."""
    level = level_share(axis)
    hanging = (1.0, 0.0, 0.0)  # assumed of a vertical shaft: nothing hangs
    if level > _VERTICAL:  # straight down, less what is along the shaft
        hanging = axis[0] * axis[2] / level, axis[1] * axis[2] / level, -level
    x, y, z = np.cross(axis, hanging).tolist()
    return hanging, (x, y, z)


@inlined
def platform_force(m: float, r: float, g: float, theta: float, omega: float) -> tuple[float, float]:
    """Eq. (1): forces (f_OY, f_OZ) in N of one eccentric mass at constant speed."""
    s, c = sine_cosine(theta)
    # Eq. (1)
    f_oy = m * r * omega * omega * s
    f_oz = -m * g - m * r * omega * omega * c
    return f_oy, f_oz


@inlined
def motor_force(
    mount: MotorMount, theta: float, omega: float, omega_dot: float
) -> tuple[float, float, float]:
    """Eq. (3): force (f_X, f_Z) in N on the body at the motor, and reaction moment n_Y in N m.

    The moment is what the stator feels of the rotor's torque balance, Eq. (13) times J:
    J ω̇ = (torque of the stator on the rotor) − m g r sin θ, about the axis sin φ·y.

    Args:
        mount: with the shaft across the body; sin φ is 1 or −1.
    """
    s, c = sine_cosine(theta)
    mr = mount.m * mount.r
    # Eq. (3)
    f_x = (mr * omega_dot * c - mr * omega * omega * s) * mount.axis[1]
    f_z = -mount.weight - mr * omega_dot * s - mr * omega * omega * c
    n_y = -(mount.J * omega_dot + mr * mount.g * s) * mount.axis[1]
    return f_x, f_z, n_y


@inlined
def motor_wrench(
    mount: MotorMount, theta: float, omega: float, omega_dot: float
) -> tuple[Vector, Vector]:
    """Force in N, and moment about the axis at the height of the centre of mass in N m, of a motor.

    The terms f_j, and r_j × f_j + n_j, of Eq. (2), body frame.
    """
    if mount.across:
        f_x, f_z, n_y = motor_force(mount, theta, omega, omega_dot)
        zero = 0.0 * f_x
        # Eq. (2), j = D, E, with r_j = (0, y, z) and f_Y = 0
        return (f_x, zero, f_z), (mount.y * f_z, mount.z * f_x + n_y, -mount.y * f_x)
    s, c = sine_cosine(theta)
    mr = mount.m * mount.r
    # Eq. (3) in the directions of the mass, and its weight
    down = mr * omega_dot * s + mr * omega * omega * c
    ahead = mr * omega * omega * s - mr * omega_dot * c
    force = plus((0.0, 0.0, -mount.weight), down, mount.hanging)
    force = plus(force, ahead, mount.ahead)
    reaction = mount.J * omega_dot - mr * mount.g * mount.hanging[2] * s
    moment = cross((mount.x, mount.y, mount.z), force)
    # Eq. (2)
    return force, plus(moment, -reaction, mount.axis)


@inlined
def reaction_torque(
    mount: MotorMount, theta: float, along: Vector, spin: Vector, rate: float
) -> float:
    """Torque in N m on an eccentric mass by the acceleration of its mount.

    Args:
        along: acceleration of the robot's axis, body frame, m/s².
        spin: change of the angular velocity in 1/rate, body frame, rad/s.
    """
    s, c = sine_cosine(theta)
    if mount.across:
        mount_x = along[0] + rate * (spin[1] * mount.z - spin[2] * mount.y)
        mount_z = along[2] + rate * spin[0] * mount.y
        return mount.m * mount.r * (mount.axis[1] * c * mount_x - s * mount_z)
    at_mount = plus(along, rate, cross(spin, (mount.x, mount.y, mount.z)))
    return mount.m * mount.r * (s * dot(at_mount, mount.hanging) - c * dot(at_mount, mount.ahead))


@unrolled
def motor_wrenches(
    pairs: tuple[int, ...], mounts: tuple[MotorMount, ...], outputs: tuple[Vector, ...]
) -> tuple[Vector, Vector]:
    """Sum of what motors do to the body, in pairs of mirror images and then one by one.

    Args:
        mounts: of the motors, in the order of their pairing.
        outputs: (θ, ω, ω̇) of each.
    """
    force, moment = motor_wrench(mounts[0], *outputs[0])
    if len(pairs) > 0:
        f, m = motor_wrench(mounts[1], *outputs[1])
        force, moment = plus(force, 1.0, f), plus(moment, 1.0, m)
        if len(mounts) == 2:
            return force, moment
        f, m = motor_wrenches(pairs[1:], mounts[2:], outputs[2:])
    else:
        if len(mounts) == 1:
            return force, moment
        f, m = motor_wrenches(pairs, mounts[1:], outputs[1:])
    return plus(force, 1.0, f), plus(moment, 1.0, m)

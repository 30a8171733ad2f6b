"""Forces of eccentric masses: Eq. (1) for the 1-DOF platform, Eq. (3) for the robot's motors.

Angles θ grow from the hanging position. Kernels are stateless and take scalars.
"""

from typing import NamedTuple

from cosim.base.jit import inlined
from cosim.model.params import MotorParams, RobotParams
from cosim.physics.trig import sine_cosine


class MotorMount(NamedTuple):
    """Eccentric mass and mounting of one motor in the body frame (origin: centre of mass)."""

    m: float  # eccentric mass in kg
    r: float  # eccentricity in m
    J: float  # rotor inertia in kg m²
    g: float  # gravitational acceleration in m/s²
    y: float  # mount position on the body's y axis in m
    z: float  # height of the motor axis over the centre of mass in m
    sin_phi: float  # sine of φ, the angle from the body's x axis to the motor axis (Fig. 4b)


def motor_mounts(robot: RobotParams, motor: MotorParams) -> tuple[MotorMount, MotorMount]:
    """Mounts of motors D (φ = 90°, on +y) and E (φ = −90°, on −y), Fig. 4b."""
    z = robot.motor_axis_height_m - robot.com_height_m
    mounts = [
        MotorMount(motor.m, motor.r, motor.J, motor.g, side * robot.motor_radius_m, z, side)
        for side in (1.0, -1.0)
    ]
    return mounts[0], mounts[1]


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
    """
    s, c = sine_cosine(theta)
    mr = mount.m * mount.r
    # Eq. (3)
    f_x = (mr * omega_dot * c - mr * omega * omega * s) * mount.sin_phi
    f_z = -mount.m * mount.g - mr * omega_dot * s - mr * omega * omega * c
    n_y = -(mount.J * omega_dot + mr * mount.g * s) * mount.sin_phi
    return f_x, f_z, n_y


@inlined
def motor_wrench(
    mount: MotorMount, theta: float, omega: float, omega_dot: float
) -> tuple[float, float, float, float, float]:
    """Wrench (f_X, f_Z, τ_X, τ_Y, τ_Z) of one motor about the centre of mass, body frame, N, N m.

    The terms r_j × f_j and n_j of Eq. (2) with r_j = (0, y, z) and f_Y = 0.
    """
    f_x, f_z, n_y = motor_force(mount, theta, omega, omega_dot)
    # Eq. (2), j = D, E
    return f_x, f_z, mount.y * f_z, mount.z * f_x + n_y, -mount.y * f_x

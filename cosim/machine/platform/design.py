"""Design for a given speed of a robot: motor speed, eccentric masses or feet, in closed form.

The robot is the 1-DOF platform (`cosim.machine.platform.motion`) on three feet, both motors in
phase. While all feet are down, friction follows from the platform's strokes, and what each foot
carries from the moments about the axis across the robot. The dynamics agree within 1 % of the motor
speed (`tests/cosim/physics/test_prescribed.py`). Where phases differ, robots are somewhat faster
and feet lift somewhat earlier (docs/physics.md).
"""

import math
from collections.abc import Callable

import msgspec
import numpy as np
from scipy.optimize import root_scalar

from cosim.base.errors import UserError
from cosim.machine.platform.motion import (
    drift_speed,
    lift_off_speed,
    net_speed,
    robot_platform,
    sensitivities,
    slip_speed,
    strokes,
)
from cosim.model.params import MotorParams, RobotParams

_UNDER = 1.0 - 1e-6  # just below a bound
# Where answers are looked for: m r as a multiple, and lengths in m.
_FACTORS, _LENGTHS_M = (1e-2, 1e2), (1e-3, 0.2)
_ANGLES = 4_000
_SETTLED_TURNS = 10  # after which the motion repeats itself
_SPEED_TOLERANCE = 1e-3  # rad/s


class Design(msgspec.Struct, frozen=True, kw_only=True):
    """The content of `--json`; None for impossible values."""

    schema_version: int = 1
    speed_m_s: float
    # lift_off_rad_s, foot_lift_rad_s: motor speeds at which the whole robot leaves the floor, and
    # above which a foot lifts
    lift_off_rad_s: float
    foot_lift_rad_s: float
    feet_down_m_s: float  # largest speed at which no foot lifts
    motor_speed_rad_s: float | None  # for the wanted speed
    feet_stay_down: bool
    unbalance_kg_m: float  # m r of one motor as it is
    # m r of one motor from which on no foot lifts at the wanted speed
    least_unbalance_kg_m: float | None
    unbalance_motor_speed_rad_s: float | None  # for the wanted speed, with that
    # Circle of the feet from which on no foot lifts at the wanted speed
    foot_radius_m: float | None
    com_height_m: float | None  # height of the centre of mass up to which no foot does
    percent_per_percent: dict[str, float]  # change of the speed for 1 % more of a parameter


def design(robot: RobotParams, motor: MotorParams, speed_m_s: float) -> Design:
    """What a positive speed takes of a machine."""
    platform = robot_platform(robot, motor)
    foot_lift = foot_lift_speed(robot, motor)
    omega = motor_speed(robot, motor, speed_m_s)

    def feet_down_m_s(motor: MotorParams) -> float:
        return net_speed(robot_platform(robot, motor), foot_lift_speed(robot, motor))

    def length(changed: Callable[[float], RobotParams]) -> float | None:
        """A length of the robot at which a foot begins to lift at the motor speed."""

        def spare(length_m: float) -> float:
            return foot_lift_speed(changed(length_m), motor) - (omega or math.nan)

        return omega and _root(spare, *_LENGTHS_M)

    # Speed at the bound grows with the root of m r: the same force, in fewer and longer steps.
    factor = _root(
        lambda factor: feet_down_m_s(motor._replace(r=factor * motor.r)) - speed_m_s, *_FACTORS
    )
    stronger = None if factor is None else motor._replace(r=factor * motor.r)
    return Design(
        speed_m_s=speed_m_s,
        lift_off_rad_s=lift_off_speed(platform),
        foot_lift_rad_s=foot_lift,
        feet_down_m_s=feet_down_m_s(motor),
        motor_speed_rad_s=omega,
        feet_stay_down=omega is not None and omega <= foot_lift,
        unbalance_kg_m=motor.m * motor.r,
        least_unbalance_kg_m=stronger and stronger.m * stronger.r,
        unbalance_motor_speed_rad_s=stronger and motor_speed(robot, stronger, speed_m_s),
        foot_radius_m=length(lambda radius_m: robot.spread(radius_m / robot.foot_radius_m)),
        com_height_m=length(lambda height_m: robot._replace(com_height_m=height_m)),
        percent_per_percent=sensitivities(platform, omega or _UNDER * lift_off_speed(platform)),
    )


def motor_speed(robot: RobotParams, motor: MotorParams, speed_m_s: float) -> float | None:
    """Motor speed in rad/s for a speed, None if the robot would leave the floor."""
    platform = robot_platform(robot, motor)
    bounds = drift_speed(platform), _UNDER * lift_off_speed(platform)
    return _root(lambda omega: net_speed(platform, omega) - speed_m_s, *bounds)


def _root(function: Callable[[float], float], low: float, high: float) -> float | None:
    if function(low) * function(high) > 0.0:
        return None
    return root_scalar(function, bracket=(low, high), method="brentq", rtol=1e-7).root


def least_foot_force(robot: RobotParams, motor: MotorParams, omega_rad_s: float) -> float:
    """Smallest normal force of a foot in N over one turn of the motors, which turn either way.

    Two feet are mirror images, as A and C are, and one is between them, as B is.
    """
    platform, omega = robot_platform(robot, motor), abs(omega_rad_s)
    feet = sorted((foot.y_m, foot.x_m) for foot in robot.feet)
    if [(-y, x) for y, x in feet[::-1]] != feet or len(feet) != 3:
        raise UserError(
            "the design needs three feet, two of them mirror images and one on the robot's axis; "
            "choose such a machine"
        )
    (_, pair_m), (_, single_m), _ = feet
    theta = 2.0 * math.pi * (_SETTLED_TURNS + np.linspace(0.0, 1.0, _ANGLES))
    unbalance = platform.m * platform.r
    drive = unbalance * omega**2 * np.sin(theta)
    normal = platform.weight + unbalance * omega**2 * np.cos(theta)
    friction = -drive
    for stroke in strokes(platform, omega, _SETTLED_TURNS + 2):
        sliding = (stroke.start < theta) & (theta < stroke.stop)
        friction[sliding] = -stroke.direction * platform.mu * normal[sliding]
    below = robot.motors[0].place_m[2] - robot.com_height_m
    torque = unbalance * platform.g * np.sin(theta)
    sense = math.copysign(1.0, omega_rad_s)
    pitching = sense * (below * drive + torque - robot.com_height_m * friction)
    single = (pair_m * normal - pitching) / (pair_m - single_m)
    return float(np.minimum(single, (normal - single) / 2.0).min())


def foot_lift_speed(robot: RobotParams, motor: MotorParams) -> float:
    """Motor speed in rad/s above which a foot lifts, forwards or backwards."""
    platform = robot_platform(robot, motor)
    top = lift_off_speed(platform)
    low, high = 0.1 * min(slip_speed(platform), top), (1.0 - 1e-9) * top

    def least(omega_rad_s: float) -> float:
        return min(least_foot_force(robot, motor, sense * omega_rad_s) for sense in (1.0, -1.0))

    if least(low) <= 0.0:
        raise UserError(
            f"a foot lifts at any motor speed with feet within {robot.foot_radius_m:g} m and "
            f"com_height_m = {robot.com_height_m:g}; put feet further out or the centre lower"
        )
    return root_scalar(least, bracket=(low, high), method="brentq", xtol=_SPEED_TOLERANCE).root

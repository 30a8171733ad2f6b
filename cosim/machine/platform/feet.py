"""Compute when a foot of a driving robot lifts: the platform's motion, the balance of moments.

Both motors in phase, all three feet down: friction follows from the platform's strokes, and what
each foot carries from the moments about the axis across the robot. The dynamics agree within 1 % of
the motor speed (`tests/cosim/physics/test_prescribed.py`).
"""

import math

import numpy as np
from scipy.optimize import root_scalar

from cosim.machine.platform.motion import lift_off_speed, robot_platform, slip_speed, strokes
from cosim.model.params import MotorParams, RobotParams

_ANGLES = 4_000
_SETTLED_TURNS = 10  # after which the motion repeats itself
_SPEED_TOLERANCE = 1e-3  # rad/s


def least_foot_force(robot: RobotParams, motor: MotorParams, omega_rad_s: float) -> float:
    """Smallest normal force of a foot in N over one turn of the motors.

    Args:
        robot: feet A and C stand half a foot radius ahead of the centre, B a whole one behind.
        motor: each of two.
        omega_rad_s: positive forwards, negative backwards.

    Raises:
        PlatformError: the whole robot would leave the floor, or the motors stand still.
    """
    platform, omega = robot_platform(robot, motor), abs(omega_rad_s)
    theta = 2.0 * math.pi * (_SETTLED_TURNS + np.linspace(0.0, 1.0, _ANGLES))
    unbalance = platform.m * platform.r
    drive = unbalance * omega**2 * np.sin(theta)
    weight = (platform.mass + platform.m) * platform.g
    normal = weight + unbalance * omega**2 * np.cos(theta)
    friction = -drive
    for stroke in strokes(platform, omega, _SETTLED_TURNS + 2):
        sliding = (stroke.start < theta) & (theta < stroke.stop)
        friction[sliding] = -stroke.direction * platform.mu * normal[sliding]
    below = robot.motor_axis_height_m - robot.com_height_m
    torque = unbalance * platform.g * np.sin(theta)
    sense = math.copysign(1.0, omega_rad_s)
    pitching = sense * (below * drive + torque - robot.com_height_m * friction)
    radius = robot.foot_radius_m
    rear = (0.5 * radius * normal - pitching) / (1.5 * radius)
    return float(np.minimum(rear, (normal - rear) / 2.0).min())


def foot_lift_speed(robot: RobotParams, motor: MotorParams) -> float:
    """Motor speed in rad/s above which a foot lifts, forwards or backwards.

    Args: as of `least_foot_force`.
    """
    platform = robot_platform(robot, motor)
    top = lift_off_speed(platform)
    bracket = 0.1 * min(slip_speed(platform), top), (1.0 - 1e-9) * top

    def least(omega_rad_s: float) -> float:
        return min(least_foot_force(robot, motor, sense * omega_rad_s) for sense in (1.0, -1.0))

    return root_scalar(least, bracket=bracket, method="brentq", xtol=_SPEED_TOLERANCE).root

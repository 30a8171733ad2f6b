"""Identified parameters, prior knowledge of them, and machines that have them."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from cosim.machine.identification.motion import Machine
from cosim.model.params import TABLE_I, TABLE_II, MotorParams, RobotParams


class RobotParameter(NamedTuple):
    """A parameter that is identified.

    Attributes:
        name: of a field of `RobotParams`, or as below.
        description: as text.
        unit: for people, and how many of it are one of the SI unit.
        scale: that number.
        spread: standard deviation around the usual value before anything is measured (assumed), in
            SI units as what follows.
        step: of its difference quotients.
        low, high: bounds; the circle of the feet is within the robot too.
    """

    name: str
    description: str
    unit: str
    scale: float
    spread: float
    step: float
    low: float
    high: float


PARAMETERS = (
    RobotParameter("mu", "friction of the feet", "", 1.0, 0.15, 0.004, 0.02, 1.0),
    RobotParameter(
        "com_height_m", "height of the centre of mass", "mm", 1e3, 0.01, 4e-4, 0.004, 0.04
    ),
    RobotParameter(
        "com_x_m", "centre of mass before the axis", "mm", 1e3, 0.003, 2e-4, -0.006, 0.006
    ),
    RobotParameter("com_y_m", "centre of mass to the left", "mm", 1e3, 0.003, 2e-4, -0.006, 0.006),
    RobotParameter("foot_radius_m", "circle of the feet", "mm", 1e3, 0.003, 3e-4, 0.005, 0.1),
    RobotParameter(
        "motor_d", "unbalance of motor 1 (D) over its usual one", "", 1.0, 0.3, 0.01, 0.4, 2
    ),
    RobotParameter(
        "motor_e", "unbalance of motor 2 (E) over its usual one", "", 1.0, 0.3, 0.01, 0.4, 2
    ),
    RobotParameter("camera_delay_s", "delay of the camera", "ms", 1e3, 0.1, 0.03, 0.0, 1.0),
)
NAMES = tuple(parameter.name for parameter in PARAMETERS)
SPREADS, STEPS, _LOW, _HIGH = np.array([p[4:] for p in PARAMETERS], dtype=float).T
_FACTORS = slice(NAMES.index("motor_d"), NAMES.index("camera_delay_s"))
DELAY = NAMES.index("camera_delay_s")


def usual_values(robot: RobotParams = TABLE_I) -> np.ndarray:
    """Values before anything is measured, shape (8,), SI units; a camera's delay is 30 ms."""
    return np.array([*(getattr(robot, name) for name in NAMES[: _FACTORS.start]), 1.0, 1.0, 0.03])


def limits(robot: RobotParams = TABLE_I) -> tuple[np.ndarray, np.ndarray]:
    """Least and largest values, shape (8,) each, SI units."""
    high = _HIGH.copy()
    high[NAMES.index("foot_radius_m")] = 0.499 * robot.diameter_m
    return _LOW, high


def machine(
    values: Sequence[float] | np.ndarray,
    robot: RobotParams = TABLE_I,
    motor: MotorParams = TABLE_II,
) -> Machine:
    """The machine that has some values.

    Args:
        values: in the order of `PARAMETERS`, SI units.
        robot, motor: what is not identified.
    """
    numbers = [float(value) for value in values]
    fields = dict(zip(NAMES[: _FACTORS.start], numbers, strict=False))
    d, e = numbers[_FACTORS]
    return Machine(
        robot._replace(**fields), motor._replace(r=d * motor.r), motor._replace(r=e * motor.r)
    )

"""Which parameter would explain a speed: relative derivatives in the dynamics."""

import math
from collections.abc import Callable
from dataclasses import replace

from cosim.coupling.fmu import MotorFmu
from cosim.machine.platform.gradient import speed_gradient
from cosim.machine.platform.motion import drift_speed, lift_off_speed, robot_platform
from cosim.machine.validation.driving import measured_speed
from cosim.model.config import CoSimConfig

STEP = 0.05  # of central differences, relative


# Of the robot, and the unbalance of its motors.
PARAMETERS = ("mu", "m r", "mass_kg", "com_height_m", "foot_radius_m", "motor_radius_m")


def _changed(config: CoSimConfig, parameter: str, factor: float) -> CoSimConfig:
    """Return a configuration with a multiple of one of `PARAMETERS`."""
    if parameter == "m r":
        return replace(config, motor=config.motor._replace(r=factor * config.motor.r))
    value = factor * getattr(config.robot, parameter)
    return replace(config, robot=config.robot._replace(**{parameter: value}))


def value_of(config: CoSimConfig, parameter: str) -> float:
    """Value of one of `PARAMETERS`, in SI units."""
    if parameter == "m r":
        return config.motor.m * config.motor.r
    return getattr(config.robot, parameter)


def sensitivities(
    config: CoSimConfig, fmu: MotorFmu, omega_rad_s: float, phases: int
) -> dict[str, float | None]:
    """Derivatives d ln v / d ln p of the speed forwards, by central differences of 5 %.

    Args:
        config: of the machine.
        fmu: of every motor.
        omega_rad_s: of both motors.
        phases: between them, see `measured_speed`; noise and phases are the same on both sides.

    Returns:
        By the names of `PARAMETERS`, and `motor speed`; None where the robot does not move
        forwards.

    Raises:
        FmuError: the FMU failed.
    """

    def speed(changed: CoSimConfig, omega: float) -> float:
        return measured_speed(changed, fmu, "forwards", omega, phases).mean

    def slope(at: Callable[[float], float]) -> float | None:
        high, low = at(1.0 + STEP), at(1.0 - STEP)
        if min(high, low) <= 0.0:
            return None
        return math.log(high / low) / math.log((1.0 + STEP) / (1.0 - STEP))

    found = {
        name: slope(lambda factor, name=name: speed(_changed(config, name, factor), omega_rad_s))
        for name in PARAMETERS
    }
    return found | {"motor speed": slope(lambda factor: speed(config, factor * omega_rad_s))}


def closed_form(config: CoSimConfig, omega_rad_s: float) -> dict[str, float]:
    """Return the 1-DOF platform's sensitivity, where it has the parameter and moves."""
    platform = robot_platform(config.robot, config.motor)
    if not drift_speed(platform) < omega_rad_s < lift_off_speed(platform):
        return {}
    gradient = speed_gradient(platform, omega_rad_s)
    values = {
        "mu": (platform.mu, gradient.mu),
        "m r": (platform.m * platform.r, gradient.unbalance),
        "mass_kg": (platform.mass, gradient.mass),
        "motor speed": (omega_rad_s, gradient.omega),
    }
    return {name: value * slope / gradient.value for name, (value, slope) in values.items()}

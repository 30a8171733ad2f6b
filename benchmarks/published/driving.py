"""Robots without feedback: speeds, what they depend on, and paths by the clock alone."""

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from benchmarks.published.points import Legs
from cosim.calibration.measuring import AIRBORNE, Point, measure_batch, shares_of
from cosim.calibration.speed_map import DIRECTIONS
from cosim.calibration.trial import Trial, heading_angles
from cosim.fmi.motor import MotorFmu
from cosim.machine.platform.motion import drift_speed, lift_off_speed, robot_platform, sensitivities
from cosim.model.config import CoSimConfig
from cosim.physics.body_state import PLANE, QUATERNION

_PHASE_S = 0.5  # in which motors come to their speed and to the phase between them
_REST_S = 0.5  # in which robots come to rest

STEP = 0.05  # of central differences, relative
# Of the robot, and the unbalance of its motors.
PARAMETERS = ("mu", "m r", "mass_kg", "com_height_m", "foot_radius_m", "motor_radius_m")


class MeasuredSpeed(NamedTuple):
    """One manoeuvre at one motor speed, over the uncontrolled phases between the motors."""

    # mean, least, largest: speed in m/s or yaw rate in rad/s, positive towards the manoeuvre
    mean: float
    least: float
    largest: float
    airborne_share: float


def measured_speed(
    config: CoSimConfig, fmu: MotorFmu, manoeuvre: str, omega_rad_s: float, phases: int
) -> MeasuredSpeed:
    """Co-simulate robots at constant set points, without dither, phases evenly over a turn."""
    points = [
        Point(manoeuvre, omega_rad_s, phase=phase, dithered=False)
        for phase in 2.0 * math.pi * np.arange(phases) / phases
    ]
    table = measure_batch(config, fmu, points, np.random.SeedSequence(0))
    motion = table[:, :3] @ DIRECTIONS[manoeuvre]
    shares = float(table[:, AIRBORNE].mean())
    return MeasuredSpeed(float(motion.mean()), float(motion.min()), float(motion.max()), shares)


def value_of(config: CoSimConfig, parameter: str) -> float:
    """Value of one of `PARAMETERS`, in SI units."""
    if parameter == "m r":
        return config.motor.m * config.motor.r
    if parameter == "motor_radius_m":
        return config.robot.motors[0].place_m[1]
    return getattr(config.robot, parameter)


def measured_sensitivities(
    config: CoSimConfig, fmu: MotorFmu, omega_rad_s: float, phases: int
) -> dict[str, float | None]:
    """Derivatives d ln v / d ln p of the speed forwards, by central differences of 5 %.

    They are by the names of `PARAMETERS`, and `motor speed`, and None where the robot does not move
    forwards. Noise and phases are the same on both sides.
    """

    def speed(parameter: str, factor: float) -> float:
        changed, omega = config, omega_rad_s
        if parameter == "motor speed":
            omega = factor * omega_rad_s
        elif parameter == "m r":
            changed = replace(config, motor=config.motor._replace(r=factor * config.motor.r))
        elif parameter in ("foot_radius_m", "motor_radius_m"):
            field = "feet" if parameter == "foot_radius_m" else "motors"
            places = {field: getattr(config.robot.spread(factor), field)}
            changed = replace(config, robot=config.robot._replace(**places))
        else:
            value = factor * getattr(config.robot, parameter)
            changed = replace(config, robot=config.robot._replace(**{parameter: value}))
        return measured_speed(changed, fmu, "forwards", omega, phases).mean

    slopes: dict[str, float | None] = {}
    for parameter in (*PARAMETERS, "motor speed"):
        high, low = speed(parameter, 1.0 + STEP), speed(parameter, 1.0 - STEP)
        moves = min(high, low) > 0.0
        run = math.log((1.0 + STEP) / (1.0 - STEP))
        slopes[parameter] = math.log(high / low) / run if moves else None
    return slopes


def closed_form(config: CoSimConfig, omega_rad_s: float) -> dict[str, float]:
    """The 1-DOF platform's sensitivities, of parameters that it has and where it moves."""
    platform = robot_platform(config.robot, config.motor)
    if not drift_speed(platform) < omega_rad_s < lift_off_speed(platform):
        return {}
    found = sensitivities(platform, omega_rad_s)
    names = {"unbalance": "m r", "mass": "mass_kg", "omega": "motor speed"}
    return {names.get(name, name): slope for name, slope in found.items()}


def drive_by_the_clock(
    config: CoSimConfig, fmu: MotorFmu, legs: Legs, robots: int, seed: int, dithered: bool
) -> np.ndarray:
    """Displacement (robots, 3) in m, x along the first heading, and turned angle in rad.

    Robots drive a path by the time that its parts take, blind for where they are.
    """
    steering, period_s = config.steering, config.timing.control_period_s
    speeds = {
        "forwards": (steering.forward_speed_rad_s, steering.drive_speed_m_s),
        "backwards": (steering.backward_speed_rad_s, steering.drive_speed_m_s),
        "left_turn": (steering.turn_speed_rad_s, steering.turn_rate_rad_s),
        "right_turn": (steering.turn_speed_rad_s, steering.turn_rate_rad_s),
    }
    noise, phases = np.random.SeedSequence(seed).spawn(2)
    phase_rad = np.random.default_rng(phases).uniform(-math.pi, math.pi, robots)
    # The dither changes its sign whenever the phase has gone once around, as the steering's does.
    dither = steering.dither_rad_s if dithered else 0.0
    half = round(math.pi / (steering.dither_rad_s * period_s))
    with Trial(fmu, config, np.zeros(robots), noise) as trial:
        angles = [trial.bodies[QUATERNION].T.copy()]

        def advance(set_points: np.ndarray, periods: int) -> None:
            trial.set_motors(set_points)
            trial.advance(periods)
            angles.append(trial.bodies[QUATERNION].T.copy())

        ahead = np.outer(phase_rad / _PHASE_S, (0.0, 1.0))
        ahead_periods, side = round(_PHASE_S / period_s), 1.0
        for manoeuvre, amount in legs:
            signs, (speed, rate) = np.array(shares_of(config, manoeuvre)), speeds[manoeuvre]
            left = round(amount / rate / period_s)
            while left:
                change = side * dither * np.array((-signs[0] * signs[1], 1.0)) + ahead
                periods = min(left, half, ahead_periods or half)
                advance(signs * speed + change, periods)
                ahead_periods, left, side = max(0, ahead_periods - periods), left - periods, -side
                if not ahead_periods:
                    ahead = np.zeros((robots, 2))
        advance(np.zeros(2), round(_REST_S / period_s))
        turned = heading_angles(np.array(angles))
        moved = trial.bodies[PLANE].T - trial.origins_m
    return np.column_stack([moved, turned[-1] - turned[0]])

"""How robots drive a line: where they are, period by period, and what that says of the steering."""

import math
from typing import NamedTuple

import numpy as np

from cosim.calibration.trial import Trial, heading_angles
from cosim.fmi.motor import MotorFmu
from cosim.model.config import CoSimConfig
from cosim.onboard.steering import DIRECTION, DRIVE, GOAL_X, GOAL_Y, HOLD, MODE, START
from cosim.physics.draws import draw_world

LIMIT_S = 150.0
PERIODS = 200  # simulated at a time


class Runs(NamedTuple):
    """Results of N robots on a line; arrays of shape (N,)."""

    duration_s: np.ndarray  # until the end of the line, infinite beyond the limit
    path_error_m: np.ndarray  # largest distance from the line while driving
    final_error_m: np.ndarray  # distance from the line at its end
    overshoot_m: np.ndarray  # how far beyond its end the robot came to rest
    heading_error_rad: np.ndarray  # angle between the robot's axis and the line at the end
    # How far the heading passed the course (towards the line, or its end) while turning, or within
    # half a second after
    turn_overshoot_rad: np.ndarray


def drive_line(
    fmu: MotorFmu, config: CoSimConfig, length_m: float, angle_rad: float, robots: int, seed: int
) -> Runs:
    """Let robots drive along +x, from a heading that is off by an angle to either side.

    Args:
        length_m: of the line.
        angle_rad: between line and robot at the start, below a right angle.
        robots: how many; every second one looks backwards.
        seed: of the noise, and of the motors.
    """
    sides = np.where(np.arange(robots) // 2 % 2 == 0, 1.0, -1.0)
    headings = np.where(np.arange(robots) % 2 == 0, 0.0, math.pi) + sides * angle_rad
    period_s = config.timing.control_period_s
    sequence = np.random.SeedSequence(seed)
    motors = draw_world(config.world, (config.motor,) * 2, robots, sequence).motors
    with Trial(fmu, config, headings, sequence, motors=motors) as trial:
        commands = trial.commands
        commands[:, GOAL_X] = trial.origins_m[:, 0] + length_m
        commands[:, GOAL_Y] = trial.origins_m[:, 1]
        commands[:, DIRECTION], commands[:, MODE] = 0.0, START
        parts = []
        while (commands[:, MODE] != HOLD).any() and trial.time_s < LIMIT_S:
            parts.append(trial.advance(PERIODS))
        parts.append(trial.advance(PERIODS))  # come to rest
        origins = trial.origins_m
    position, quaternion, mode, course = (
        np.concatenate([getattr(samples, name) for samples in parts])
        for name in ("position", "quaternion", "mode", "heading_error")
    )
    aside = position[:, :, 1] - origins[:, 1]
    errors = (heading_angles(quaternion) + math.pi / 2.0) % math.pi - math.pi / 2.0
    held = mode == HOLD
    end = np.where(held.any(axis=0), held.argmax(axis=0), len(mode) - 1)
    robot = np.arange(robots)
    driving = mode == DRIVE
    began = np.where(driving.any(axis=0), driving.argmax(axis=0), 0)
    turning = np.arange(len(mode))[:, None] < began + round(0.5 / period_s)
    turning &= np.arange(len(mode))[:, None] <= end
    passed = np.where(turning, -np.sign(course[0]) * course, 0.0).max(axis=0)
    return Runs(
        np.where(held.any(axis=0), end * period_s, np.inf),
        np.where(driving, np.abs(aside), 0.0).max(axis=0),
        np.abs(aside[end, robot]),
        position[-1, :, 0] - origins[:, 0] - length_m,
        np.abs(errors[end, robot]),
        passed if angle_rad > 0.0 else np.zeros(robots),
    )

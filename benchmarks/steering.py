"""Measure how straight and how fast controllers of the steering drive.

Every controller is the kernel of `cosim.onboard.steering` with other parameters, so that one code
is compared with itself; some go without feedback. FMUs, noise and friction are those of an episode.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from cosim.base.command import show_table
from cosim.base.errors import UserError
from cosim.calibration.trial import Trial, heading_angles
from cosim.coupling.fmu import MotorFmu
from cosim.model.config import CoSimConfig
from cosim.model.params import STEERING, TABLE_I
from cosim.model.world import World, draw_world
from cosim.onboard.steering import DIRECTION, DRIVE, GOAL_X, GOAL_Y, HOLD, MODE, START
from fmus.build import cached_fmu
from minirobots.options import CommandOptions, Count

LINE_M, CELL_M = 0.2, 0.01
LIMIT_S = 150.0
PERIODS = 200  # simulated at a time


@dataclass(frozen=True, kw_only=True)
class Options(CommandOptions):
    """Compare controllers: a straight line of 20 cm, and moves of one cell, over seeds.

    Robots have motors at rest, noise of ±5 % and unknown phases between the motors; half
    of them drive forwards, half backwards.
    """

    seeds: Count = 20
    """Robots of every case; each has noise of its own."""
    mu: float = TABLE_I.mu
    """Coulomb friction coefficient of the feet."""
    controllers: tuple[str, ...] = ()
    """Controllers to compare, by default all."""
    motor_spread: float = 0.0
    """Relative standard deviation of K_T, R, J and m r of every motor."""


def _with(**changes: float) -> CoSimConfig:
    return CoSimConfig(steering=STEERING._replace(**changes))


CONTROLLERS: dict[str, CoSimConfig] = {
    "kept": CoSimConfig(),
    "without dither": _with(dither_rad_s=0.0),
    # Faces the line, then holds the heading; what goes aside stays aside.
    "turn, then drive": _with(lookahead_m=1e9, least_lookahead_m=1e9),
    # Never turns on the spot: the slower motor may stop, the robot drives arcs.
    "line following only": _with(
        turned_rad=math.pi,
        turn_again_rad=math.pi,
        max_difference_rad_s=STEERING.max_speed_rad_s / 2.0,
    ),
    "first version": _with(
        forward_speed_rad_s=950.0,
        backward_speed_rad_s=950.0,
        turn_speed_rad_s=950.0,
        max_speed_rad_s=1100.0,
        dither_rad_s=0.0,
        turned_rad=0.05,
        heading_gain_1_s=600.0,
        max_difference_rad_s=150.0,
        least_lookahead_m=STEERING.lookahead_m,
    ),
    # What the feedback is worth, see docs/validation.md.
    "no course": CoSimConfig(open_loop=("heading",)),
    "motors in open loop": CoSimConfig(open_loop=("motors",)),
    "neither": CoSimConfig(open_loop=("motors", "heading")),
}
# Single moves: length in cells, and angle between the robot's axis and the line in degrees.
MOVES = {
    "straight": (1.0, 0.0),
    "straight after 45°": (1.0, 45.0),
    "straight after 90°": (1.0, 89.0),
    "diagonal": (math.sqrt(2.0), 0.0),
    "diagonal after 45°": (math.sqrt(2.0), 45.0),
}


class Runs(NamedTuple):
    """Results of N robots on a line; arrays of shape (N,).

    Attributes:
        duration_s: until the end of the line, infinite beyond the limit.
        path_error_m: largest distance from the line while driving.
        final_error_m: distance from the line at its end.
        overshoot_m: how far beyond its end the robot came to rest.
        heading_error_rad: angle between the robot's axis and the line at the end.
        turn_overshoot_rad: how far the heading passed the course (towards the line, or its end)
            while turning, or within half a second after.
    """

    duration_s: np.ndarray
    path_error_m: np.ndarray
    final_error_m: np.ndarray
    overshoot_m: np.ndarray
    heading_error_rad: np.ndarray
    turn_overshoot_rad: np.ndarray


def drive_line(
    fmu: MotorFmu, config: CoSimConfig, length_m: float, angle_rad: float, robots: int, seed: int
) -> Runs:
    """Let robots drive along +x, from a heading that is off by an angle to either side.

    Args:
        fmu: of the motors.
        config: of the co-simulation; its world's motor spread is drawn.
        length_m: of the line.
        angle_rad: between line and robot at the start, below a right angle.
        robots: how many; every second one looks backwards.
        seed: of the noise, and of the motors.
    """
    sides = np.where(np.arange(robots) // 2 % 2 == 0, 1.0, -1.0)
    headings = np.where(np.arange(robots) % 2 == 0, 0.0, math.pi) + sides * angle_rad
    period_s = config.timing.control_period_s
    sequence = np.random.SeedSequence(seed)
    motors = draw_world(config.world, config.motor, robots, sequence).motors
    with Trial(fmu, config, headings, sequence, motors=motors) as trial:
        commands = trial.commands
        commands[:, GOAL_X] = trial.origins_m[:, 0] + length_m
        commands[:, GOAL_Y] = trial.origins_m[:, 1]
        commands[:, DIRECTION], commands[:, MODE] = 0.0, START
        poses, modes, courses = [], [], []
        while (commands[:, MODE] != HOLD).any() and trial.time_s < LIMIT_S:
            samples = trial.advance(PERIODS)
            poses.append(np.concatenate([samples.position, samples.quaternion], axis=2))
            modes.append(samples.mode)
            courses.append(samples.heading_error)
        samples = trial.advance(PERIODS)  # come to rest
        poses.append(np.concatenate([samples.position, samples.quaternion], axis=2))
        modes.append(samples.mode)
        courses.append(samples.heading_error)
        origins = trial.origins_m
    pose, mode, course = (np.concatenate(parts) for parts in (poses, modes, courses))
    aside = pose[:, :, 1] - origins[:, 1]
    errors = (heading_angles(pose[:, :, 3:7]) + math.pi / 2.0) % math.pi - math.pi / 2.0
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
        pose[-1, :, 0] - origins[:, 0] - length_m,
        np.abs(errors[end, robot]),
        passed if angle_rad > 0.0 else np.zeros(robots),
    )


def figures(runs: Runs) -> dict[str, float]:
    """Mean and worst of the runs; units in the names."""
    return {
        "duration_s": float(runs.duration_s.mean()),
        "duration_max_s": float(runs.duration_s.max()),
        "path_error_max_mm": 1e3 * float(runs.path_error_m.max()),
        "final_error_max_mm": 1e3 * float(runs.final_error_m.max()),
        "overshoot_max_mm": 1e3 * float(runs.overshoot_m.max()),
        "heading_error_max_deg": float(np.rad2deg(runs.heading_error_rad.max())),
        "turn_overshoot_max_deg": float(np.rad2deg(runs.turn_overshoot_rad.max())),
    }


def measure(
    seeds: int, mu: float, controllers: Sequence[str], motor_spread: float = 0.0
) -> dict[str, Any]:
    """A row per case and controller.

    Raises:
        UserError: there is no such controller.
    """
    chosen = controllers or tuple(CONTROLLERS)
    unknown = set(chosen) - set(CONTROLLERS)
    if unknown:
        raise UserError(f"no controller {unknown.pop()!r}; choose from {', '.join(CONTROLLERS)}")
    fmu, world = MotorFmu(cached_fmu()), World(mu=mu, motor_spread=motor_spread)
    cases = {"line of 20 cm": (LINE_M, 0.0)} | {
        name: (cells * CELL_M, math.radians(angle)) for name, (cells, angle) in MOVES.items()
    }
    rows: list[dict[str, Any]] = []
    for case, (length_m, angle_rad) in cases.items():
        for name in chosen:
            config = CONTROLLERS[name].in_world(world)
            runs = drive_line(fmu, config, length_m, angle_rad, seeds, seed=0)
            rows.append({"case": case, "controller": name, **figures(runs)})
    return {"seeds": seeds, "mu": mu, "motor_spread": motor_spread, "rows": rows}


def show(found: dict[str, Any]) -> None:
    """Print a table: mean (largest) time, and the worst of all else."""
    rows = []
    for row in found["rows"]:
        case, name, duration, duration_max, *others = row.values()
        worst = (f"{value:.2f}" for value in others)
        rows.append((case, name, f"{duration:.2f} ({duration_max:.2f})", *worst))
    header = ("path error, mm", "final, mm", "overshoot, mm", "heading, °", "turn overshoot, °")
    title = f"worst of {found['seeds']}"
    show_table(None, ("case", "controller", "time, s (max)", *header), rows, names=2, title=title)

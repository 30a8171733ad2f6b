"""Measure how straight and how fast controllers of the steering drive.

A line of 20 cm, and moves of one cell, over seeds: robots have motors at rest, noise of ±5 % and
unknown phases between the motors; half of them drive forwards, half backwards. Every controller is
the kernel of `cosim.onboard.steering` with other parameters, so that one code is compared with
itself; some go without feedback.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from cosim.base.command import Checked, Count
from cosim.base.errors import UserError
from cosim.calibration.measuring import calibrated
from cosim.fmi.motor import MotorFmu
from cosim.model.config import CoSimConfig
from cosim.model.params import STEERING, TABLE_I
from cosim.model.preset import Preset
from cosim.model.world import World, tree_of
from fmus.build import cached_fmu
from tests.references.lines import Runs, drive_line

LINE_M, CELL_M = 0.2, 0.01


@dataclass(frozen=True, kw_only=True)
class Options(Checked):
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
    # The same robot with its motors and feet listed, so that set points are found for it.
    "found, no course": Preset(
        tree=tree_of("Fig. 4b", masses_included=False, motors=TABLE_I.motors, feet=TABLE_I.feet)
    ).config(tree_of("benchmark", open_loop=("heading",))),
}
# Single moves: length in cells, and angle between the robot's axis and the line in degrees.
MOVES = {
    "straight": (1.0, 0.0),
    "straight after 45°": (1.0, 45.0),
    "straight after 90°": (1.0, 89.0),
    "diagonal": (math.sqrt(2.0), 0.0),
    "diagonal after 45°": (math.sqrt(2.0), 45.0),
}


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


def measure(options: Options) -> dict[str, Any]:
    chosen, seeds = options.controllers or tuple(CONTROLLERS), options.seeds
    unknown = set(chosen) - set(CONTROLLERS)
    if unknown:
        raise UserError(f"no controller {unknown.pop()!r}; choose from {', '.join(CONTROLLERS)}")
    fmu, world = MotorFmu(cached_fmu()), World(mu=options.mu, motor_spread=options.motor_spread)
    cases = {"line of 20 cm": (LINE_M, 0.0)} | {
        name: (cells * CELL_M, math.radians(angle)) for name, (cells, angle) in MOVES.items()
    }
    rows: list[dict[str, Any]] = []
    for case, (length_m, angle_rad) in cases.items():
        for name in chosen:
            config = CONTROLLERS[name].in_world(world)
            if not config.steering.given:
                config = calibrated(config, cached_fmu())
            runs = drive_line(fmu, config, length_m, angle_rad, seeds, seed=0)
            rows.append({"case": case, "controller": name, **figures(runs)})
    return {"seeds": seeds, "mu": world.mu, "motor_spread": world.motor_spread, "rows": rows}

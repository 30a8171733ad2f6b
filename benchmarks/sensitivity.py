"""Measure how drive speed and turn rate depend on assumptions on feet, floor and centre of mass.

Robots with other assumed parameters, one at a time, are calibrated: speeds at the default motor
speeds and at the largest ones without hopping, and the share of time in which a foot is off the
floor; NaN where no trial was so fast or slow.
"""

import math
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from cosim.base.command import Checked, Jobs
from cosim.calibration.measuring import find_calibration
from cosim.model.config import CoSimConfig
from cosim.model.params import STEERING, RobotParams
from cosim.model.world import World
from fmus.build import cached_fmu

RESTITUTIONS = (0.0, 0.1, 0.2, 0.3, 0.5)
ROBOTS = {
    "com_height_m": (0.010, 0.015, 0.020),
    "foot_radius_m": (0.019, 0.021, 0.023),
    "mu": (0.1, 0.15, 0.2, 0.3, 0.4),
}


@dataclass(frozen=True, kw_only=True)
class Options(Checked):
    jobs: Jobs = 2


def measure(options: Options) -> dict[str, Any]:
    default = CoSimConfig()
    cases = [
        ("restitution", value, default.in_world(World(restitution=value))) for value in RESTITUTIONS
    ]
    cases += [
        (name, value, CoSimConfig(robot=_changed(default.robot, name, value)))
        for name, values in ROBOTS.items()
        for value in values
    ]
    return {"rows": [_found(*case, options.jobs) for case in cases]}


def _changed(robot: RobotParams, name: str, value: float) -> RobotParams:
    """Return a robot with another value of one of ROBOTS."""
    if name == "foot_radius_m":
        return robot._replace(feet=robot.spread(value / robot.foot_radius_m).feet)
    return robot._replace(**{name: value})


def _found(parameter: str, value: float, config: CoSimConfig, jobs: int) -> dict[str, Any]:
    calibration = find_calibration(config, cached_fmu(), jobs=jobs)
    largest = calibration.hop_free_rad_s
    row = {"parameter": parameter, "value": value, "hop_free_rad_s": largest}
    for name, unit, usual in (
        ("forwards", "m_s", STEERING.forward_speed_rad_s),
        ("left_turn", "rad_s", STEERING.turn_speed_rad_s),
    ):
        curve = calibration.curve(name)
        for when, omega_rad_s in (("", usual), ("largest_", largest)):
            at = partial(np.interp, omega_rad_s, curve.omega_rad_s, left=math.nan, right=math.nan)
            row[f"{when}{name}_{unit}"] = float(at(curve.mean))
            row[f"{when}{name}_lifted_share"] = float(at(curve.lifted_share))
    return row

"""Measure how drive speed and turn rate depend on assumptions on feet, floor and centre of mass."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from cosim.calibration.cache import find_calibration
from cosim.calibration.speed_map import Curve
from cosim.model.config import CoSimConfig
from cosim.model.params import STEERING
from cosim.model.world import World
from fmus.build import cached_fmu
from minirobots.options import CommandOptions, Jobs

RESTITUTIONS = (0.0, 0.1, 0.2, 0.3, 0.5)
ROBOTS = {
    "com_height_m": (0.010, 0.015, 0.020),
    "foot_radius_m": (0.019, 0.021, 0.023),
    "mu": (0.1, 0.15, 0.2, 0.3, 0.4),
}


@dataclass(frozen=True, kw_only=True)
class Options(CommandOptions):
    """Calibrate robots with other assumed parameters, one at a time, and see what changes.

    Speeds at the default motor speeds and at the largest ones without hopping, and the share of
    time in which a foot is off the floor.
    """

    jobs: Jobs = 2


def measure(jobs: int) -> dict[str, Any]:
    """Calibrations along one axis at a time, those found in the cache included."""
    default = CoSimConfig()
    cases = [
        ("restitution", value, default.in_world(World(restitution=value))) for value in RESTITUTIONS
    ]
    cases += [
        (name, value, CoSimConfig(robot=default.robot._replace(**{name: value})))
        for name, values in ROBOTS.items()
        for value in values
    ]
    return {"rows": [_found(*case, jobs) for case in cases]}


def _found(parameter: str, value: float, config: CoSimConfig, jobs: int) -> dict[str, Any]:
    """What the calibration of a robot says; of each pair the first is forwards, the second left.

    Speeds at the default motor speeds in m/s and rad/s, NaN where no trial was so fast or slow, and
    the share of time in which a foot is off the floor; the same at the largest motor speed without
    hopping.
    """
    calibration = find_calibration(config, cached_fmu(), jobs=jobs)
    top = calibration.hop_free_rad_s
    forwards, left = calibration.curve("forwards"), calibration.curve("left")
    drive, turn = STEERING.forward_speed_rad_s, STEERING.turn_speed_rad_s
    return {
        "parameter": parameter,
        "value": value,
        "speed": (_at(forwards, drive, forwards.mean), _at(left, turn, left.mean)),
        "lifted_share": tuple(
            _at(curve, omega, curve.lifted_share)
            for curve, omega in ((forwards, drive), (left, turn))
        ),
        "hop_free_rad_s": top,
        "largest": (_at(forwards, top, forwards.mean), _at(left, top, left.mean)),
        "largest_lifted_share": tuple(
            _at(curve, top, curve.lifted_share) for curve in (forwards, left)
        ),
    }


def _at(curve: Curve, omega_rad_s: float, values: np.ndarray) -> float:
    return float(np.interp(omega_rad_s, curve.omega_rad_s, values, math.nan, math.nan))


def show(found: dict[str, Any]) -> None:
    """Print the table."""
    drive, turn = STEERING.forward_speed_rad_s, STEERING.turn_speed_rad_s
    print(f"forwards in mm/s at {drive:g} rad/s, left in deg/s at {turn:g} rad/s, and the share of")
    print("time in which a foot is off the floor; the same at the largest motor speed without hops")
    print(f"{'parameter':14} {'value':>6} {'forwards':>15} {'left':>15} {'rad/s':>7}", end="")
    print(f" {'forwards':>15} {'left':>15}")
    for row in found["rows"]:
        cells = [
            f"{1e3 * drive:8.2f} {lifted[0]:6.1%} {math.degrees(turn):8.2f} {lifted[1]:6.1%}"
            for (drive, turn), lifted in (
                (row["speed"], row["lifted_share"]),
                (row["largest"], row["largest_lifted_share"]),
            )
        ]
        limit = f"{row['hop_free_rad_s']:7.1f}"
        print(f"{row['parameter']:14} {row['value']:6.3g} {cells[0]} {limit} {cells[1]}")

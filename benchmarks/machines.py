"""Measure what a tick of machines with other numbers and kinds of motors and feet costs.

Robots stand far apart, 16 in lanes, with all motors at 700 rad/s; the FMU's steps are included.
Rounds of all machines take turns; ratios are to the paper's two motors and three feet.
"""

import math
from dataclasses import dataclass

import numpy as np

from benchmarks.timing import best_s
from cosim.base.command import Checked, Count
from cosim.calibration.trial import Trial
from cosim.fmi.motor import MotorFmu
from cosim.model.config import CoSimConfig
from cosim.model.params import Foot, Leg, Mount
from cosim.model.preset import Preset
from fmus.build import cached_fmu

# Motors and feet, and whether these are elastic legs
RIGID = ((2, 3), (2, 4), (3, 3), (4, 6), (1, 8))
MACHINES = (*((*sizes, False) for sizes in RIGID), (2, 3, True), (4, 6, True), (1, 8, True))
LEG = Leg(25.0, 180.0, 200_000.0, 10_000.0, 5e-4, 0.006)
ROBOTS, PERIODS, SPEED_RAD_S = 16, 100, 700.0


@dataclass(frozen=True, kw_only=True)
class Options(Checked):
    rounds: Count = 10
    """Rounds of every measurement; the best counts."""


def machine(motors: int, feet: int, elastic: bool = False) -> CoSimConfig:
    """Parameters of a machine with motors and feet around it; the paper's for two and three."""
    if (motors, feet, elastic) == MACHINES[0]:
        return CoSimConfig()
    leg = LEG if elastic else None
    angles = (2.0 * math.pi * k / motors for k in range(motors))
    rims = (2.0 * math.pi * (k + 0.5) / feet for k in range(feet))
    tree = {
        "motors": tuple(
            Mount((0.02 * math.cos(a), 0.02 * math.sin(a), 0.003), (math.cos(a), math.sin(a), 0.0))
            for a in angles
        ),
        "feet": tuple(Foot(0.02 * math.cos(a), 0.02 * math.sin(a), None, leg) for a in rims),
    }
    return Preset(tree={name: (value, "benchmark") for name, value in tree.items()}).config()


def standing(motors: int, feet: int, elastic: bool) -> Trial:
    """Return robots whose motors turn."""
    trial = Trial(
        MotorFmu(cached_fmu()),
        machine(motors, feet, elastic),
        np.zeros(ROBOTS),
        np.random.SeedSequence(0),
    )
    trial.set_motors(np.full(motors, SPEED_RAD_S))
    trial.advance(PERIODS)
    return trial


def measure(options: Options) -> dict[str, dict[str, float]]:
    trials = [standing(*sizes) for sizes in MACHINES]
    works = [lambda trial=trial: trial.advance(PERIODS) for trial in trials]
    times = best_s(options.rounds, *works)
    ticks = ROBOTS * PERIODS * CoSimConfig().ticks_per_period
    return {
        f"{motors} motors, {feet} {'elastic legs' if elastic else 'feet'}": {
            "ns_per_robot_tick": 1e9 * s / ticks,
            "ratio": s / times[0],
        }
        for (motors, feet, elastic), s in zip(MACHINES, times, strict=True)
    }

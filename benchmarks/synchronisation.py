"""Measure whether the rotors of the paper's robot synchronise through its body (--reaction).

Robots drive forwards, each with set points that differ by another amount between its two motors,
in open and in closed loop, without noise. Rotors that synchronise turn equally fast in the mean,
although their set points differ; then also their phase stays.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from cosim.base.command import Checked, Positive, Seconds
from cosim.calibration.trial import Trial
from cosim.fmi.motor import MotorFmu
from cosim.model.config import CoSimConfig
from fmus.build import cached_fmu

DIFFERENCES_RAD_S = (0.0, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0)


@dataclass(frozen=True, kw_only=True)
class Options(Checked):
    time_s: Seconds = 10.0
    """Simulated time; means are over its second half."""
    speed_rad_s: Positive = 600.0
    """Set point in the middle."""
    factors: tuple[float, ...] = (1.0, 2.0)
    """Eccentric masses, as multiples of Table II's; the robot must not hop at the set point."""


def measure(options: Options) -> dict[str, Any]:
    usual, fmu = CoSimConfig().having("measured", relative_amplitude=0.0), MotorFmu(cached_fmu())
    rows = []
    for factor in options.factors:
        motor = usual.motor._replace(m=factor * usual.motor.m)
        for loop, open_loop in (("open", ("motors",)), ("closed", ())):
            for reaction in (False, True):
                speeds = [name for name in usual.steering._fields if name.endswith("speed_rad_s")]
                slow = usual.steering._replace(**dict.fromkeys(speeds, options.speed_rad_s))
                given = {"motor": motor, "open_loop": open_loop, "reaction": reaction}
                config = replace(usual, steering=slow, **given)
                found = _differences(fmu, config, options)
                row = {"loop": loop, "reaction": "on" if reaction else "off", "m": factor}
                rows.append(
                    row | {f"{d:g}": f for d, f in zip(DIFFERENCES_RAD_S, found, strict=True)}
                )
    return {"difference_rad_s": rows}


def _differences(fmu: MotorFmu, config: CoSimConfig, options: Options) -> list[float]:
    """Return mean differences of the motors' speeds by those of their set points, in rad/s."""
    speed, n = options.speed_rad_s, len(DIFFERENCES_RAD_S)
    half = 0.5 * np.array(DIFFERENCES_RAD_S)
    with Trial(fmu, config, np.zeros(n), np.random.SeedSequence(0)) as trial:
        trial.set_motors(np.column_stack([speed + half, -(speed - half)]))
        periods = round(0.5 * options.time_s / config.timing.control_period_s)
        trial.advance(periods)
        before = trial.advance(1).theta[0]
        after = trial.advance(periods).theta[-1]
    turned = (after - before) / (periods * config.timing.control_period_s)
    return (turned[:, 0] + turned[:, 1]).tolist()

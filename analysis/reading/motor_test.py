"""Recordings of `minirobots motor-test`: the signals of both loops as arrays."""

import json
import math
from pathlib import Path
from typing import NamedTuple

import numpy as np

from cosim.base.errors import UserError
from cosim.recording.reader import read_rrd

LOOPS = ("open_loop", "closed_loop")


class Response(NamedTuple):
    """Signals of one run; float64 arrays (n,) in SI units, one value per ms."""

    time_s: np.ndarray  # from 0 on
    omega: np.ndarray  # speed of the shaft, rad/s
    omega_des: np.ndarray  # set point, rad/s
    voltage: np.ndarray  # at the motor, V
    current: np.ndarray  # A
    disturbance: np.ndarray  # torque on the shaft, N m, from this time on


SIGNALS = Response._fields[1:]  # entities below /sim/<loop>


def read(path: Path) -> tuple[dict[str, Response], dict[str, float]]:
    """Return the signals of a recording by loop, and the motor's parameters as far as known."""
    try:
        data = read_rrd(path)
        signals = {
            loop: [data.signals[f"/sim/{loop}/{name}"] for name in SIGNALS] for loop in LOOPS
        }
    except KeyError as error:
        raise UserError(
            f"{path} is not a recording of a motor test ({error}); "
            "make one with `minirobots motor-test`"
        ) from error
    facts = data.properties.get("motor_test", {})
    return {
        loop: Response(of[0].time_s, *(signal.values for signal in of))
        for loop, of in signals.items()
    }, json.loads(facts.get("parameters", "{}"))


class Rise(NamedTuple):
    """Rise of a speed to its set point; None where it does not get there within the test."""

    # to_63_percent_s, to_90_percent_s, to_98_percent_s: time until the share is first reached
    to_63_percent_s: float | None
    to_90_percent_s: float | None
    to_98_percent_s: float | None
    # Time from which on the speed stays within ±2 % of the set point
    within_2_percent_s: float | None
    overshoot: float  # largest speed over the set point, less 1


SHARES = (1.0 - math.exp(-1.0), 0.9, 0.98)  # the first is the time constant of a first-order lag
BAND = 0.02


def rise(time_s: np.ndarray, omega: np.ndarray, set_point: float) -> Rise:
    """Return how a speed (n,) in rad/s comes up to its set point at times (n,) since the step."""
    near = np.abs(omega - set_point) <= BAND * set_point
    stays = np.logical_and.accumulate(near[::-1])[::-1]
    to_63, to_90, to_98, within = (
        float(time_s[np.argmax(there)]) if there.any() else None
        for there in (*(omega >= share * set_point for share in SHARES), stays)
    )
    return Rise(to_63, to_90, to_98, within, float(omega.max() / set_point - 1.0))

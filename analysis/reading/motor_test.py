"""Recordings of `python -m analysis.motor_test`: the signals of both loops as arrays."""

from pathlib import Path
from typing import NamedTuple

import numpy as np

from cosim.base.errors import UserError
from cosim.reading.rrd import RecordingReadError, Signal, read_rrd

LOOPS = ("open_loop", "closed_loop")
# Entities below /sim/<loop>, and what they hold.
SIGNALS = ("omega", "omega_des", "voltage", "current", "disturbance")


class MotorTestError(UserError):
    """A motor test that cannot be run or read; the message names the file and the mend."""


class Response(NamedTuple):
    """Signals of one run; float64 arrays (n,) in SI units, one value per ms.

    Attributes:
        time_s: from 0 on.
        omega: speed of the shaft, rad/s.
        omega_des: set point, rad/s.
        voltage: at the motor, V.
        current: A.
        disturbance: torque on the shaft, N m, from this time on.
    """

    time_s: np.ndarray
    omega: np.ndarray
    omega_des: np.ndarray
    voltage: np.ndarray
    current: np.ndarray
    disturbance: np.ndarray


def read(path: Path) -> dict[str, Response]:
    """Signals of a recording, by loop.

    Raises:
        MotorTestError: there is no such recording, or it is none of a motor test.
    """
    try:
        signals = read_rrd(path).signals
        return {loop: _response(signals, loop) for loop in LOOPS}
    except (RecordingReadError, KeyError) as error:
        raise MotorTestError(
            f"{path} is no recording of a motor test ({error}); "
            "make one with `python -m analysis.motor_test`"
        ) from error


def _response(signals: dict[str, Signal], loop: str) -> Response:
    held = [signals[f"/sim/{loop}/{signal}"] for signal in SIGNALS]
    return Response(held[0].time_s, *(signal.values for signal in held))

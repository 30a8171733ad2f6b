"""Derivatives of the platform's stroke and speed, in closed form.

Derivatives are carried along a stroke after the other, as the motion itself is: in units of
`cosim.physics.stroke` a stroke depends on α and s alone. Where a stroke begins by slip it begins at
an onset; where it begins by reversal, it begins where the one before ended. The end of a stroke is
the root of its speed, so its derivative is that of an implicit function.
"""

import math
from typing import NamedTuple

import numpy as np

from cosim.machine.platform.motion import (
    CYCLE_STROKES,
    REPEAT_TOLERANCE,
    Platform,
    dimensionless_strokes,
    length_unit,
    slip_ratio,
)
from cosim.physics.stroke import Stroke, distance


class Gradient(NamedTuple):
    """A quantity of the platform and its partial derivatives.

    Attributes:
        value: of the quantity.
        unbalance: derivative by u = m r of all motors (kg m), at constant weight.
        mu: by the friction coefficient.
        mass: by the platform's mass, 1/kg.
        omega: by the motor speed, s/rad.
    """

    value: float
    unbalance: float
    mu: float
    mass: float
    omega: float


def stroke_gradient(platform: Platform, omega_rad_s: float) -> Gradient:
    """Displacement in m along +Y per turn of the motor, once the motion repeats itself.

    Raises:
        PlatformError: the platform would leave the floor, or the motor stands still.
    """
    s, alpha = slip_ratio(platform, omega_rad_s), math.atan(platform.mu)
    total, by_alpha, by_s = _cycle(alpha, s)
    mu, mass, unit = platform.mu, platform.mass, length_unit(platform)
    unbalance = platform.m * platform.r
    square = 1.0 + mu * mu
    # Logarithmic derivatives of s and of the unit, times what they multiply.
    along_s = s * by_s
    return Gradient(
        unit * total,
        unit * (total - along_s) / unbalance,
        unit * (total * mu / square + along_s * (1.0 / mu - mu / square) + by_alpha / square),
        unit * (along_s / (mass + platform.m) - total / mass),
        -2.0 * unit * along_s / omega_rad_s,
    )


def speed_gradient(platform: Platform, omega_rad_s: float) -> Gradient:
    """Mean speed in m/s along +Y; arguments and errors as of `stroke_gradient`."""
    turns_1_s = omega_rad_s / (2.0 * math.pi)
    part = Gradient(*(turns_1_s * each for each in stroke_gradient(platform, omega_rad_s)))
    return part._replace(omega=part.omega + part.value / omega_rad_s)


def _cycle(alpha: float, s: float) -> tuple[float, float, float]:
    """Dimensionless displacement of a cycle, and its derivatives by α and s."""
    found: list[tuple[Stroke, np.ndarray]] = []
    stop = np.zeros(2)  # of the angle at which the last stroke ended, by α and s
    for stroke in dimensionless_strokes(alpha, s):
        parts, stop = _carried(alpha, s, stroke, found[-1][0].stop if found else 0.0, stop)
        for k, (before, _) in enumerate(found):
            if abs(stroke.start - 2.0 * math.pi - before.start) < REPEAT_TOLERANCE:
                total, by_alpha, by_s = np.sum([each for _, each in found[k:]], axis=0)
                return float(total), float(by_alpha), float(by_s)
        found = [*found[-CYCLE_STROKES:], (stroke, parts)]
    return 0.0, 0.0, 0.0


def _carried(
    alpha: float, s: float, stroke: Stroke, rested: float, resting: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """(3,) distance along +Y with its derivatives by α and s, and (2,) those of the stroke's end.

    Args:
        alpha, s: of the platform.
        stroke: from rest to rest.
        rested: angle at which the stroke before ended.
        resting: its derivatives.
    """
    d, start, stop = stroke
    first, last, turned = start - d * alpha, stop - d * alpha, stop - start
    begun = resting  # a stroke that begins by reversal
    if start > rested:
        begun = np.array([d, 1.0 / math.sqrt(1.0 - s * s)])
    # Of the speed at the end, which is zero whatever changes, and of the distance.
    drive = math.sin(first) - d * s
    by_parameters = np.array([d * (math.sin(first) - math.sin(last)), -d * turned])
    ended = (drive * begun - by_parameters) / (math.sin(last) - d * s)
    by_alpha = d * (turned * math.sin(first) - math.cos(first) + math.cos(last))
    moved = np.array([by_alpha, -d * turned * turned / 2.0]) - turned * drive * begun
    return np.array([distance(d, alpha, s, start, stop), *moved]), ended

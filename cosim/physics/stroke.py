"""One slide of the 1-DOF platform, from rest to rest, in dimensionless closed form.

The motor turns at constant speed, α = atan μ, and s = (ω_c/ω)² is the slip ratio. In units of
u ω √(1+μ²)/M for speed and u √(1+μ²)/M for distance, with u = m r of all motors, Eq. (1) reads
    sliding forwards   dv/dθ = sin(θ − α) − s
    sliding backwards  dv/dθ = sin(θ + α) + s
What those units are in metres, and sequences of strokes, belong to `cosim.machine.platform.motion`.
"""

import math
from typing import NamedTuple

from scipy.optimize import root_scalar

# Onsets closer than this share of a turn to the present angle are now: rounding after many turns.
ANGLE_ROUNDING = 1e-12
# Angle in rad to which the end of a stroke is found: rounding of an angle of some turns.
ROOT_TOLERANCE = 1e-14


class Stroke(NamedTuple):
    """One slide from rest to rest: direction 1.0 along +Y or −1.0, angles of start and stop."""

    direction: float
    start: float
    stop: float


def speed(direction: float, alpha: float, s: float, start: float, theta: float) -> float:
    """Dimensionless speed at θ of a stroke that began at rest."""
    shift = direction * alpha
    return math.cos(start - shift) - math.cos(theta - shift) - direction * s * (theta - start)


def distance(direction: float, alpha: float, s: float, start: float, theta: float) -> float:
    """Dimensionless distance from the start to θ of a stroke that began at rest."""
    shift, turned = direction * alpha, theta - start
    arc = math.sin(start - shift) - math.sin(theta - shift)
    return turned * math.cos(start - shift) + arc - direction * s * turned * turned / 2.0


def next_stroke(alpha: float, s: float, theta: float) -> Stroke:
    """The stroke that follows rest at θ, s < 1."""
    a = math.asin(s)
    onset = {1.0: alpha + a, -1.0: math.pi - alpha + a}
    turn = 2.0 * math.pi
    if math.sin(theta - alpha) > s:
        direction, start = 1.0, theta
    elif math.sin(theta + alpha) < -s:
        direction, start = -1.0, theta
    else:
        start, direction = min(
            (first + turn * math.ceil((theta - first) / turn - ANGLE_ROUNDING), d)
            for d, first in onset.items()
        )
    # The speed grows until the driving force falls below friction again, and is back at zero
    # before the next onset of the same direction.
    first = onset[direction]
    began = first + turn * math.floor((start - first) / turn + ANGLE_ROUNDING)
    fastest = began + math.pi - 2.0 * a
    stop = root_scalar(
        lambda angle: speed(direction, alpha, s, start, angle),
        bracket=(fastest, began + turn),
        method="brentq",
        xtol=ROOT_TOLERANCE,
    ).root
    return Stroke(direction, start, stop)

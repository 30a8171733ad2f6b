"""Numbers that were published of robots of this family: what, by whom, and how certain.

Figures only, each with the preset that it is compared with. *seen* is read in the source or its
stored text, *derived* is computed here from numbers that were seen.
"""

import math
from typing import Literal, NamedTuple

Certainty = Literal["seen", "derived"]
Manoeuvre = Literal["forwards", "backwards", "left_turn", "right_turn"]
Legs = tuple[
    tuple[Manoeuvre, float], ...
]  # manoeuvres one after the other, and how far in m or rad


class PublishedSpeed(NamedTuple):
    """A speed, or a yaw rate, at a motor speed."""

    preset: str
    manoeuvre: Manoeuvre
    omega_rad_s: float  # of both motors
    value: float | None  # in mm/s, or °/s; None where only the simulated one is of interest
    certainty: Certainty
    source: str


class PublishedPath(NamedTuple):
    """A path driven by the clock, as often as there were numbers of it."""

    name: str
    legs: Legs
    meant: tuple[float, float, float]  # displacement in m and turned angle in rad at its end
    off_mm: tuple[float, ...]  # distance from where it should have ended, of each that was driven
    turned_deg: float | None  # heading at the end next to that at the start; None if not published
    source: str


def polygon(
    sides: int, side_mm: float, off_mm: tuple[float, ...], turned_deg: float | None
) -> PublishedPath:
    """A closed path back to its start, and to its first heading."""
    legs: Legs = (("forwards", 1e-3 * side_mm), ("left_turn", 2.0 * math.pi / sides))
    name = f"{'triangle' if sides == 3 else 'square'} of {side_mm / 10.0:g} cm"
    return PublishedPath(
        name, legs * sides, (0.0, 0.0, 2.0 * math.pi), off_mm, turned_deg, _DROPLET
    )


def sideways(steps: int, leg_m: float, half_rad: float) -> PublishedPath:
    """Steps to the left in the shape of a V: forwards and back again, at an angle to each other."""
    legs: Legs = (
        ("left_turn", half_rad),
        ("forwards", leg_m),
        ("right_turn", 2.0 * half_rad),
        ("backwards", leg_m),
        ("left_turn", half_rad),
    )
    meant_m = steps * 2.0 * leg_m * math.sin(half_rad)
    name = f"V-shaped steps, {1e3 * meant_m:.1f} mm to the left"
    return PublishedPath(name, legs * steps, (0.0, meant_m, 0.0), (), None, "not at hand")


_ICRA = "ICRA 2006, prototype: 0.5 to 1.5 mm/s at 1050 to 1200 rad/s"
_KILOBOT = "Kilobot, ICRA 2012, two vibration motors on three legs: another machine, for the order"
_DROPLET = "Droplet, three vibration motors: another machine, for the order"

# That the ends of the ranges of speeds and motor speeds belong to each other is assumed.
SPEEDS = (
    PublishedSpeed("icra2006", "forwards", 1050.0, 0.5, "seen", _ICRA),
    PublishedSpeed("icra2006", "forwards", 1125.0, None, "seen", _ICRA),
    PublishedSpeed("icra2006", "forwards", 1200.0, 1.5, "seen", _ICRA),
    PublishedSpeed("icra2006", "backwards", 1050.0, None, "seen", _ICRA),
    PublishedSpeed("icra2006", "backwards", 1200.0, None, "seen", _ICRA),
    PublishedSpeed("paper", "forwards", 1083.0, 10.0, "seen", _KILOBOT),
    PublishedSpeed("paper", "left_turn", 1083.0, 45.0, "seen", _KILOBOT),
)

# The V are of 1 cm legs and 20° to either side (assumed; what was published is not at hand).
PATHS = (
    polygon(4, 80.0, (27.5,), 27.0),
    polygon(4, 65.0, (14.0,), 39.0),
    polygon(3, 60.0, (32.8, 27.7), None),
    sideways(3, 0.01, math.radians(20.0)),
)


def step_um(speed_mm_s: float, omega_rad_s: float) -> float:
    """Step in µm per turn of the motors."""
    return 1e3 * speed_mm_s * 2.0 * math.pi / omega_rad_s

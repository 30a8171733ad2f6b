"""Records of float64 and tables that a page and its compiled episode exchange."""

from typing import NamedTuple

from agent.firmware.build import STEERING
from cosim.model.params import EstimatorParams, ShieldParams

MOST_ROBOTS = 8
MOST_HIDDEN = 1024  # of a layer of a network


class Field(NamedTuple):
    """A part of a record of float64.

    Attributes:
        start: of it, in numbers.
        size: in numbers.
    """

    start: int
    size: int


def _fields(numbers: str, **sizes: int) -> dict[str, Field]:
    """Return fields of one number by their names, and others by their sizes."""
    found, start = {}, 0
    for name, size in (dict.fromkeys(numbers.split(), 1) | sizes).items():
        found[name] = Field(start, size)
        start += size
    return found


# Names of the parts of some fields, which the C writes in capitals.
PARTS = {
    "strides": tuple(f"stride_{feature}" for feature in "xydgbhp"),
    "steering": STEERING,
    "motion": ("drive_speed_m_s", "turn_rate_rad_s", "yaw_gain"),
    "shield": ShieldParams._fields,
    "camera": (
        *("interval", "delay", "position_noise_m", "heading_noise_rad", "dropout"),
        *("position_variance", "heading_variance", "flying", "sights"),
    ),
    "filter": EstimatorParams._fields,
}

# What determines an episode except for policy, starts and seed; units are SI, lengths in cells
# where nothing is said.
SETUP = _fields(
    "robots columns rows cell_m contact_squared near_squared medium_squared states hidden "
    "any_target walls closed patches control_period_s ticks_per_period decision_periods "
    "move_limit_periods episode_limit_ticks path_periods through ends_on_collision noise "
    "noise_hold_periods shielded spread com_height_m diameter_m mu mu_robots",
    size=2,
    within=2,
    targets=2 * MOST_ROBOTS,
    start_counts=MOST_ROBOTS,
    start_quaternion=2,
    closed_zone=4,
    direction_rad=8 + MOST_ROBOTS,  # behind those of moves those of retreats
    direction_x=8 + MOST_ROBOTS,
    direction_y=8 + MOST_ROBOTS,
    phases=2 * MOST_ROBOTS,
    body=33,
    mounts=14,
    motor=14,
    **{name: len(names) for name, names in PARTS.items()},
)

# What an episode shows of itself, all robots' values one after the other.
VIEW = _fields(
    "time_s outcome steps",
    position=3 * MOST_ROBOTS,
    heading=MOST_ROBOTS,
    goal=2 * MOST_ROBOTS,
    mode=MOST_ROBOTS,
    arrived=MOST_ROBOTS,
    path_m=MOST_ROBOTS,
    theta=2 * MOST_ROBOTS,
    omega=2 * MOST_ROBOTS,
    voltage=2 * MOST_ROBOTS,
    force=3 * MOST_ROBOTS,
)

# Fields that are records of fmus/mini_robot; the slope's direction in the body is the episode's.
_RECORDS = {"body": "BodyConstants body", "mounts": "Mount mounts[2]"}

# Types of the tables in C and numpy; those of a policy that does without one are empty.
TABLES = {
    "starts": ("int32_t", "<i4"),  # cells of each robot, one robot after the other
    "walls": ("double", "<f8"),  # left, bottom, right, top in m
    "closed": ("double", "<f8"),  # likewise, as many for each robot: of a zone that is closed
    "patches": ("double", "<f8"),  # left, bottom, right, top in m, and mu, NaN: the floor's
    "widths": ("double", "<f8"),  # of the layers that normal numbers are drawn by
    "bearings": ("uint8_t", "u1"),  # direction of another robot by its distance in x and y
    "best": ("uint8_t", "u1"),  # of each robot and state a bit for each direction of largest value
    "network": ("float", "<f4"),  # of `agent.deep.policy.Network`, one array after the other
    "possible": ("uint8_t", "u1"),  # of each robot and cell a bit for each move of `Inputs`
    "after": ("int32_t", "<i4"),  # see `agent.moves.pair.PairTimes`
    "seconds": ("double", "<f8"),
    "alone": ("double", "<f8"),
    "delay": ("uint16_t", "<u2"),  # without `first`, which compresses well
    "first": ("uint16_t", "<u2"),  # what each robot adds to the delay
}


def render_header() -> str:
    """Return the text of `layout.h`."""
    lines = [
        "/* Generated from agent/web/layout.py. */",
        "#ifndef LAYOUT_H",
        "#define LAYOUT_H",
        '#include "body.h"',
        f"enum {{ MOST_ROBOTS = {MOST_ROBOTS}, MOST_HIDDEN = {MOST_HIDDEN} }};",
    ]
    for name, record in (("Setup", SETUP), ("View", VIEW)):
        parts = (
            _RECORDS.get(k, f"double {k}[{f.size}]" if f.size > 1 else f"double {k}")
            for k, f in record.items()
        )
        size = sum(field.size for field in record.values())
        lines += [
            f"typedef struct {{ {'; '.join(parts)}; }} {name};",
            f'_Static_assert(sizeof({name}) == {size} * sizeof(double), "{name}");',
        ]
    for name, names in PARTS.items():
        lines += [f"#define {part.upper()} setup.{name}[{k}]" for k, part in enumerate(names)]
    pointers = " ".join(f"{kind} *{name};" for name, (kind, _) in TABLES.items())
    lines += [
        f"typedef struct {{ {pointers} }} Tables;",
        "extern Setup setup;",
        "extern Tables table;",
        "#endif",
    ]
    return "\n".join(lines) + "\n"

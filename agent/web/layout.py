"""Records of float64 and tables that a page and its compiled episode exchange."""

from typing import NamedTuple

from agent.firmware.tables import STEERING
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


def _fields(**sizes: int) -> dict[str, Field]:
    found, start = {}, 0
    for name, size in sizes.items():
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

# What determines an episode besides policy, starts and seed; units are SI, of lengths cells where
# nothing is said.
SETUP = _fields(
    robots=1,
    columns=1,
    rows=1,
    cell_m=1,
    size=2,
    targets=2 * MOST_ROBOTS,
    start_counts=MOST_ROBOTS,
    contact_squared=1,
    near_squared=1,
    medium_squared=1,
    strides=len(PARTS["strides"]),
    states=1,
    hidden=1,
    any_target=1,
    walls=1,
    control_period_s=1,
    ticks_per_period=1,
    decision_periods=1,
    move_limit_periods=1,
    episode_limit_ticks=1,
    path_periods=1,
    through=1,
    ends_on_collision=1,
    noise=1,
    noise_hold_periods=1,
    steering=len(PARTS["steering"]),
    direction_rad=8 + MOST_ROBOTS,  # behind those of moves those of retreats
    direction_x=8 + MOST_ROBOTS,
    direction_y=8 + MOST_ROBOTS,
    shielded=1,
    shield=len(PARTS["shield"]),
    closed=1,
    closed_zone=4,
    patches=1,
    spread=1,
    motion=len(PARTS["motion"]),
    camera=len(PARTS["camera"]),
    filter=len(PARTS["filter"]),
    within=2,
    start_quaternion=2,
    com_height_m=1,
    diameter_m=1,
    mu_robots=1,
    phases=2 * MOST_ROBOTS,
    # As `BodyConstants` of fmus/mini_robot/body.h, without the direction of a slope.
    inverse_mass=1,
    inertia=3,
    inverse_inertia=3,
    products=2,
    centre=2,
    gravity=3,
    mu=3,
    restitution=1,
    dt_s=1,
    inverse_dt=1,
    feet=9,
    step_normal=1,
    step_tangential=1,
    spin_inertia=1,
    tolerance=1,
    mounts=14,
    motor=14,
)

# What an episode shows of itself, all robots' values one after the other.
VIEW = _fields(
    time_s=1,
    outcome=1,
    steps=1,
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
        "#include <stdint.h>",
        f"enum {{ MOST_ROBOTS = {MOST_ROBOTS}, MOST_HIDDEN = {MOST_HIDDEN} }};",
    ]
    for name, record in (("Setup", SETUP), ("View", VIEW)):
        parts = (f"{k}[{f.size}]" if f.size > 1 else k for k, f in record.items())
        lines.append(f"typedef struct {{ double {', '.join(parts)}; }} {name};")
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

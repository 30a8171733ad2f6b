"""Worlds that walks are observed in: domain randomisation, by declared ranges.

Moves for learning can be observed in many worlds, each walk in its own (Tobin et al. 2017, Domain
randomization): `minirobots moves --worlds`. Environments draw one for every episode.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from cosim.base.arguments import ConfigError, validate_argument
from cosim.model.config import CoSimConfig
from cosim.model.world import Patch, Sensor, World

Range = tuple[float, float]


class WorldRange(NamedTuple):
    """Ranges that a world is drawn from uniformly; names and units as of `cosim.model.world.World`.

    What is not named is that of the ideal world, and μ that of the machine.

    >>> import agent.envs
    >>> agent.envs.WorldRange(mu=(0.1, 0.26)).motor_spread
    (0.0, 0.0)
    """

    mu: Range | None = None  # Friction coefficient of the floor, and of every patch.
    patches: int = 0  # Number of patches with a friction coefficient of their own.
    patch_cells: tuple[int, int] = (1, 1)  # Side of a patch in cells.
    motor_spread: Range = (0.0, 0.0)  # Scatter of the motors' parameters, relative.
    restitution: Range = (0.0, 0.0)  # Of the feet on the floor, 0 to 1.
    floor_tilt_deg: Range = (0.0, 0.0)  # Slope of the floor.
    payload_g: Range = (0.0, 0.0)  # Mass that a robot carries.
    payload_offset_mm: Range = (0.0, 0.0)  # Place of the payload along each axis of the robot.
    rate_hz: Range = (0.0, 0.0)  # Frames per second of the camera.
    delay_ms: Range = (0.0, 0.0)  # From a frame to its use.
    position_noise_mm: Range = (0.0, 0.0)  # Standard deviation of measured positions.
    heading_noise_deg: Range = (0.0, 0.0)  # Standard deviation of measured headings.
    dropout: Range = (0.0, 0.0)  # Probability that a frame is lost.


RANGES = WorldRange(
    mu=(0.1, 0.26),
    patches=6,
    patch_cells=(3, 12),
    motor_spread=(0.0, 0.1),
    restitution=(0.0, 0.3),
    floor_tilt_deg=(0.0, 0.5),
    payload_g=(0.0, 6.0),
    payload_offset_mm=(-8.0, 8.0),
    rate_hz=(15.0, 60.0),
    delay_ms=(0.0, 150.0),
    position_noise_mm=(0.0, 1.5),
    heading_noise_deg=(0.0, 2.0),
    dropout=(0.0, 0.1),
)


def draw_world(
    ranges: WorldRange, side_cells: int, reach_cells: int, rng: np.random.Generator
) -> World:
    """Draw a world for a walk from the middle of a board; patches begin within reach of that."""

    def one(range_: Range | None) -> float:
        assert range_ is not None
        return float(rng.uniform(*range_))

    def patch() -> Patch:
        left, bottom = rng.integers(-reach_cells, reach_cells, 2) + side_cells // 2
        width, height = rng.integers(*ranges.patch_cells, 2, endpoint=True)
        cells = int(left), int(bottom), int(left + width - 1), int(bottom + height - 1)
        return Patch(cells, one(ranges.mu))

    return World(
        mu=one(ranges.mu),
        mu_patches=tuple(patch() for _ in range(ranges.patches)),
        motor_spread=one(ranges.motor_spread),
        restitution=one(ranges.restitution),
        floor_tilt_deg=one(ranges.floor_tilt_deg),
        payload_g=one(ranges.payload_g),
        payload_offset_mm=(one(ranges.payload_offset_mm), one(ranges.payload_offset_mm)),
        sensor=Sensor(*(one(getattr(ranges, name)) for name in Sensor.__struct_fields__)),
    )


def checked_ranges(worlds: Any, config: CoSimConfig) -> WorldRange:
    """Return ranges of valid worlds, with μ."""
    if not isinstance(worlds, WorldRange):
        raise ConfigError(
            f"worlds = {worlds!r} has no ranges; give agent.envs.WorldRange(mu=(0.1, 0.26)), or "
            "agent.envs.ROBUST_WORLDS"
        )
    if worlds.mu is None:
        worlds = worlds._replace(mu=(config.robot.mu, config.robot.mu))
    if validate_argument("worlds.patches", worlds.patches, int) < 0:
        raise ConfigError(f"worlds.patches = {worlds.patches} must not be negative")
    ends: tuple[dict[str, Any], ...] = ({"patches": worlds.patches}, {"patches": worlds.patches})
    for name, value in worlds._asdict().items():
        if name == "patches":
            continue
        low, high = validate_argument(f"worlds.{name}", value, tuple[float, float])
        if not -math.inf < low <= high < math.inf:
            raise ConfigError(f"worlds.{name} = {value} must be ascending and finite")
        # the least payload has no offset, which worlds without a payload refuse
        for end, number in zip(ends, (high if name == "payload_g" else low, high), strict=True):
            end[name] = (number, number)
    for end in ends:
        end["patch_cells"] = tuple(max(1, int(n)) for n in end["patch_cells"])
        config.in_world(draw_world(WorldRange(**end), 30, 15, np.random.default_rng(0)))
    return worlds

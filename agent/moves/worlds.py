"""Worlds that walks are observed in: domain randomisation, by declared ranges.

What a policy meets later is drawn from no list that training knows: it learns on moves of many
worlds, each walk in its own (Tobin et al. 2017, Domain randomization).
"""

from typing import NamedTuple

import numpy as np

from cosim.model.world import Patch, Sensor, World

Range = tuple[float, float]


class Ranges(NamedTuple):
    """Ranges that a walk draws from uniformly; names and units as of `cosim.model.world.World`."""

    mu: Range = (0.1, 0.26)  # of the floor, and of every patch
    patches: int = 6
    patch_cells: tuple[int, int] = (3, 12)  # side of a patch
    motor_spread: Range = (0.0, 0.1)
    restitution: Range = (0.0, 0.3)
    floor_tilt_deg: Range = (0.0, 0.5)
    payload_g: Range = (0.0, 6.0)
    payload_offset_mm: Range = (-8.0, 8.0)
    rate_hz: Range = (15.0, 60.0)
    delay_ms: Range = (0.0, 150.0)
    position_noise_mm: Range = (0.0, 1.5)
    heading_noise_deg: Range = (0.0, 2.0)
    dropout: Range = (0.0, 0.1)


RANGES = Ranges()


def draw_world(
    ranges: Ranges, side_cells: int, reach_cells: int, rng: np.random.Generator
) -> World:
    """A world for a walk that begins in the middle of a board.

    Args:
        ranges: to draw from.
        side_cells: of the board.
        reach_cells: how far from the middle patches begin.
        rng: is drawn from.
    """

    def one(range_: Range) -> float:
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
        sensor=Sensor(
            one(ranges.rate_hz),
            one(ranges.delay_ms),
            one(ranges.position_noise_mm),
            one(ranges.heading_noise_deg),
            one(ranges.dropout),
        ),
    )

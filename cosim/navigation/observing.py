"""From poses to what a policy sees, and where episodes start: the grid laid over the dynamics.

A cell belongs to the robot whose centre is in it; distance class (Eq. 9) and gradient sign
(Eq. 10) are those of the cells, the sign since the robot's own last decision.
"""

import math
from itertools import combinations

import numpy as np

from cosim.base.scenario import Cell, Scenario
from cosim.navigation.features import (
    DIRECTION_COUNT,
    LARGE,
    Observation,
    distance_class,
    distance_thresholds,
    gradient_sign,
)
from cosim.physics.rotation import heading


def cells_of(bodies: np.ndarray, scenario: Scenario) -> np.ndarray:
    """Cell of each robot, (N, 2) int64, from body states (N, STATE_SIZE)."""
    return np.floor(bodies[:, :2] / scenario.cell_m).astype(np.int64)


def nearest_squared(cells: np.ndarray) -> np.ndarray:
    """Squared distance in cells² of each robot to the nearest other, (N,) int64."""
    squared = ((cells[:, None] - cells[None]) ** 2).sum(axis=2)
    np.fill_diagonal(squared, np.iinfo(np.int64).max)
    return squared.min(axis=1)


def observe(bodies: np.ndarray, scenario: Scenario, squared_before: np.ndarray) -> Observation:
    """What a policy sees.

    Args:
        bodies: (N, STATE_SIZE) states, layout in cosim.physics.body.
        scenario: the board.
        squared_before: (N,) `nearest_squared` at each robot's previous decision.
    """
    cells = cells_of(bodies, scenario)
    squared = nearest_squared(cells)
    thresholds = distance_thresholds(scenario)
    alone = scenario.robots == 1
    sector = 2.0 * math.pi / DIRECTION_COUNT
    angles = np.array([heading((body[3], body[4], body[5], body[6])) for body in bodies])
    pairs = zip(squared, squared_before, strict=True)
    return Observation(
        cells,
        np.array([LARGE if alone else distance_class(value, thresholds) for value in squared]),
        np.array([gradient_sign(now, before) for now, before in pairs]),
        np.round(angles / sector).astype(np.int64) % DIRECTION_COUNT,
    )


def draw_starts(scenario: Scenario, rng: np.random.Generator) -> tuple[Cell, ...]:
    """Start cells drawn uniformly, again while any two robots would touch."""
    contact = distance_thresholds(scenario).contact
    while True:
        starts = tuple(cells[rng.integers(len(cells))] for cells in scenario.starts)
        pairs = combinations(starts, 2)
        if all((a[0] - b[0]) ** 2 + (a[1] - b[1]) ** 2 > contact for a, b in pairs):
            return starts

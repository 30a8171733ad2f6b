"""From poses to what a policy sees, and where episodes start: the grid laid over the dynamics.

A cell belongs to the robot with its centre in it; distance class (Eq. 9) and gradient sign
(Eq. 10) are those of the cells, the sign since the robot's own last decision. Kernels here and in
`cosim.onboard.yielding` take C-contiguous arrays; another layout costs another compilation.
"""

import math

import numpy as np

from cosim.base.errors import UserError
from cosim.base.jit import inlined, kernel
from cosim.model.scenario import Cell, Scenario, touching_pair
from cosim.onboard.features import (
    DIRECTION_COUNT,
    DistanceThresholds,
    Observation,
    distance_class,
    distance_thresholds,
    gradient_sign,
)

_SECTOR_RAD = 2.0 * math.pi / DIRECTION_COUNT
DRAWS = 20_000  # of start cells, before a scenario counts as one without free ones
_NOBODY = np.iinfo(np.int64).max  # squared distance to the nearest other of a robot alone


@inlined
def cell_of(coordinate_m: float, cell_m: float) -> int:
    """Column or row of a coordinate, on a board of cells with an edge of `cell_m`."""
    return math.floor(coordinate_m / cell_m)


@kernel
def cells_of(positions_m: np.ndarray, cell_m: float) -> np.ndarray:
    """Cell of each robot, (N, 2) int64, from the robots' centres (N, 2)."""
    cells = np.empty((len(positions_m), 2), dtype=np.int64)
    for i in range(len(positions_m)):
        cells[i, 0] = cell_of(positions_m[i, 0], cell_m)
        cells[i, 1] = cell_of(positions_m[i, 1], cell_m)
    return cells


@kernel
def nearest_squared(cells: np.ndarray) -> np.ndarray:
    """Squared distance in cells² of each robot to the nearest other, (N,) int64."""
    squared = np.full(len(cells), _NOBODY)
    for i in range(len(cells)):
        for j in range(len(cells)):
            if j != i:
                dx, dy = cells[j, 0] - cells[i, 0], cells[j, 1] - cells[i, 1]
                squared[i] = min(squared[i], dx * dx + dy * dy)
    return squared


@kernel
def observe(
    positions_m: np.ndarray,
    headings_rad: np.ndarray,
    cell_m: float,
    thresholds: DistanceThresholds,
    squared_before: np.ndarray,
    targets: np.ndarray,
) -> Observation:
    """Return what a policy sees.

    Args:
        headings_rad: (N,) counter-clockwise from +x.
        squared_before: (N,) int64, `nearest_squared` at each robot's previous decision.
    """
    cells = cells_of(positions_m, cell_m)
    squared = nearest_squared(cells)
    classes, signs, directions = squared.copy(), squared.copy(), squared.copy()
    for i in range(len(cells)):
        classes[i] = distance_class(squared[i], thresholds)
        signs[i] = gradient_sign(squared[i], squared_before[i])
        sector = np.rint(headings_rad[i] / _SECTOR_RAD)
        directions[i] = int(sector) % DIRECTION_COUNT
    return Observation(cells, classes, signs, directions, targets.copy())


def draw_starts(scenario: Scenario, rng: np.random.Generator) -> tuple[Cell, ...]:
    """Start cells drawn uniformly, again while any two robots would touch."""
    scenario.require_free_starts()
    contact = distance_thresholds(scenario).contact
    for _ in range(DRAWS):
        starts = tuple(cells[int(len(cells) * rng.random())] for cells in scenario.starts)
        if touching_pair(starts, contact) is None:
            return starts
    raise UserError(
        f"scenario {scenario.name}: hardly any combination of starts keeps the robots "
        "apart; move the start cells further apart"
    )

"""From poses to what a policy sees, and where episodes start: the grid laid over the dynamics.

A cell belongs to the robot with its centre in it; distance class (Eq. 9) and gradient sign
(Eq. 10) are those of the cells, the sign since the robot's own last decision. Kernels here and in
`cosim.onboard.yielding` take C-contiguous arrays; another layout costs another compilation.
"""

import math

import numpy as np

from cosim.base.errors import UserError
from cosim.base.jit import inlined
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


@inlined
def nearest_squared(cells: np.ndarray, i: int) -> int:
    """Squared distance in cells² of robot i to the nearest other, from all robots' cells (N, 2)."""
    squared = _NOBODY
    for j in range(len(cells)):
        if j != i:
            dx, dy = cells[j, 0] - cells[i, 0], cells[j, 1] - cells[i, 1]
            squared = min(squared, dx * dx + dy * dy)
    return squared


@inlined
def observe(
    positions_m: np.ndarray,
    headings_rad: np.ndarray,
    cell_m: float,
    thresholds: DistanceThresholds,
    squared_before: np.ndarray,
    squared: np.ndarray,
    seen: Observation,
) -> None:
    """Write what a policy sees but for targets and goals.

    Args:
        positions_m: (N, 2) centres of the robots.
        headings_rad: (N,) counter-clockwise from +x.
        squared_before: (N,) int64, `squared` at each robot's previous decision.
        squared: (N,) int64, `nearest_squared` now; written.
    """
    for i in range(len(positions_m)):
        seen.cells[i, 0] = cell_of(positions_m[i, 0], cell_m)
        seen.cells[i, 1] = cell_of(positions_m[i, 1], cell_m)
    for i in range(len(positions_m)):
        squared[i] = nearest_squared(seen.cells, i)
        seen.distance_class[i] = distance_class(squared[i], thresholds)
        seen.gradient_sign[i] = gradient_sign(squared[i], squared_before[i])
        seen.direction[i] = int(np.rint(headings_rad[i] / _SECTOR_RAD)) % DIRECTION_COUNT


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

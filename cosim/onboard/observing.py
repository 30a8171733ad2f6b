"""From poses to what a policy sees, and where episodes start: the grid laid over the dynamics.

A cell belongs to the robot with its centre in it; distance class (Eq. 9) and gradient sign
(Eq. 10) are those of the cells, the sign since the robot's own last decision. Kernels here and in
`cosim.onboard.yielding` take C-contiguous arrays; another layout costs another compilation.
"""

import math
from typing import NamedTuple

import numpy as np

from cosim.base.errors import UserError
from cosim.base.jit import inlined
from cosim.model.scenario import Cell, Scenario, touching_pair
from cosim.onboard.estimation import POSE
from cosim.onboard.features import (
    DIRECTION_COUNT,
    DistanceThresholds,
    Observation,
    distance_class,
    distance_thresholds,
    gradient_sign,
)
from cosim.onboard.steering import GOAL_X, waits

_SECTOR_RAD = 2.0 * math.pi / DIRECTION_COUNT
DRAWS = 20_000  # of start cells, before a scenario counts as one without free ones
_NOBODY = np.iinfo(np.int64).max  # squared distance to the nearest other of a robot alone


class Area(NamedTuple):
    """Where robots are asked, and by which distances they see each other."""

    cell_m: float  # edge of a cell
    # Least and largest coordinate in m, the latter on each axis; infinite without a camera, which
    # may put robots off the board
    least_m: float
    most_m: tuple[float, float]
    thresholds: DistanceThresholds


def area_of(scenario: Scenario, camera: bool) -> Area:
    """Return the area of a scenario."""
    width_m, height_m = scenario.size_m
    inside = math.nextafter(width_m, 0.0), math.nextafter(height_m, 0.0)
    limits = (0.0, inside) if camera else (-math.inf, (math.inf, math.inf))
    return Area(scenario.cell_m, *limits, distance_thresholds(scenario))


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
    estimates: np.ndarray,
    commands: np.ndarray,
    area: Area,
    squared_before: np.ndarray,
    positions_m: np.ndarray,
    squared: np.ndarray,
    seen: Observation,
) -> None:
    """Write what a policy sees, except for targets.

    Args:
        estimates, commands: (N, …) of `cosim.onboard.estimation` and `steering`.
        squared_before: (N,) int64, `squared` at each robot's previous decision.
        positions_m: (N, 2) where robots take themselves to be; written.
        squared: (N,) int64, `nearest_squared` now; written.
    """
    for i in range(len(estimates)):
        for axis in range(2):
            # No robot that is asked estimates itself off the board.
            position_m = min(max(estimates[i, POSE + axis], area.least_m), area.most_m[axis])
            positions_m[i, axis], cell = position_m, cell_of(position_m, area.cell_m)
            goal = cell_of(commands[i, GOAL_X + axis], area.cell_m)
            seen.cells[i, axis] = cell
            seen.goals[i, axis] = cell if waits(commands[i]) else goal
    for i in range(len(estimates)):
        squared[i] = nearest_squared(seen.cells, i)
        seen.distance_class[i] = distance_class(squared[i], area.thresholds)
        seen.gradient_sign[i] = gradient_sign(squared[i], squared_before[i])
        sector = np.rint(estimates[i, POSE + 2] / _SECTOR_RAD)
        seen.direction[i] = int(sector) % DIRECTION_COUNT


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

"""Inputs of a network for one robot: rows of its first layer, one of each group; possible moves.

Groups are the robot itself, its column and row, its offset from its target, the offset of the
nearest other robot and that one's from its own target. All but cells are cut off at `REACH` cells.
An input is 1 at the rows named here, so that a layer of a network adds up as many of its rows.
"""

from typing import NamedTuple

import numpy as np

from agent.mdp.joint import cells_after
from agent.mdp.readings import Process
from cosim.base.jit import inlined, kernel
from cosim.model.scenario import Scenario
from cosim.onboard.features import DIRECTION_COUNT

REACH = 10  # cells; robots touch at 5
_NEAR = 2  # cells; of the nearest other robot's offset from its target: whether it has arrived
GROUPS = 9
NOTHING = -1  # the group has no row: there is no other robot


class Inputs(NamedTuple):
    """Numbering of the inputs of a scenario, for kernels.

    Attributes:
        targets: (N, 2) int64 cells.
        possible: (N, columns · rows, 8) bool, moves that neither leave the board nor end in an
            obstacle, at cell x·rows + y.
        first: (10,) int64, first row of each group, and the number of all.
    """

    targets: np.ndarray
    possible: np.ndarray
    first: np.ndarray

    @classmethod
    def of(cls, scenario: Scenario, process: Process) -> "Inputs":
        """Inputs of a scenario on the grid."""
        after = np.stack([cells_after(process, i) for i in range(scenario.robots)])
        wide, narrow = 2 * REACH + 1, 2 * _NEAR + 1
        sizes = (scenario.robots, scenario.columns, scenario.rows)
        sizes += (wide, wide, wide, wide, narrow, narrow)
        return cls(np.array(scenario.targets), after >= 0, np.cumsum([0, *sizes]))


@inlined
def _cut(offset: int, reach: int) -> int:
    return min(max(offset, -reach), reach) + reach


@inlined
def look(inputs: Inputs, cells: np.ndarray, i: int, seen: np.ndarray) -> None:
    """Write the (GROUPS,) rows of robot i among robots on (N, 2) cells of the board."""
    x, y = cells[i, 0], cells[i, 1]
    seen[0] = i
    seen[1] = x
    seen[2] = y
    seen[3] = _cut(x - inputs.targets[i, 0], REACH)
    seen[4] = _cut(y - inputs.targets[i, 1], REACH)
    nearest = np.int64(1) << 40
    for j in range(len(cells)):
        dx, dy = cells[j, 0] - x, cells[j, 1] - y
        if j != i and dx * dx + dy * dy < nearest:
            nearest = dx * dx + dy * dy
            seen[5] = _cut(dx, REACH)
            seen[6] = _cut(dy, REACH)
            seen[7] = _cut(cells[j, 0] - inputs.targets[j, 0], _NEAR)
            seen[8] = _cut(cells[j, 1] - inputs.targets[j, 1], _NEAR)
    for k in range(GROUPS):
        seen[k] += inputs.first[k]
    if len(cells) == 1:
        seen[5:] = NOTHING


@kernel
def look_at_boards(
    inputs: Inputs, cells: np.ndarray, seen: np.ndarray, possible: np.ndarray, rows: int
) -> None:
    """Write the inputs of all robots of K boards.

    Args:
        inputs: of the scenario.
        cells: (K, N, 2) int64.
        seen: (K, N, GROUPS) float32, written.
        possible: (K, N, 8) float32, written with 1 for moves that can be chosen.
        rows: of the board.
    """
    one = np.empty(GROUPS, dtype=np.int64)
    for m in range(cells.shape[0]):
        for i in range(cells.shape[1]):
            look(inputs, cells[m], i, one)
            for k in range(GROUPS):
                seen[m, i, k] = one[k]
            cell = cells[m, i, 0] * rows + cells[m, i, 1]
            for a in range(DIRECTION_COUNT):
                possible[m, i, a] = inputs.possible[i, cell, a]

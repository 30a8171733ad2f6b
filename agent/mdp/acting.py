"""From what robots see in the dynamics to rows of their tables and greedy directions, in kernels.

The features are those of `agent.mdp.grid`, so that policies act in the dynamics as on the grid.
"""

import numpy as np

from agent.mdp.grid import (
    AXIS,
    BEARING,
    CLASS,
    COLUMN_COUNT,
    PARTNER,
    SIGN,
    X,
    Y,
    least_rotation_argmax,
    nearest_other,
    state_index,
)
from agent.mdp.readings import Process
from cosim.base.jit import kernel
from cosim.onboard.features import AXIS_COUNT, Observation


@kernel
def on_grid(process: Process, observation: Observation) -> tuple[np.ndarray, np.ndarray]:
    """Return what robots see, as a world of the grid and as rows of their tables.

    Args:
        process: the decision process.
        observation: int64, C-contiguous.

    Returns:
        World (N, 11) without last moves and status, and state indices (N,); indices are −1 and the
        world is 0 if a cell is off the board.
    """
    cells = observation.cells
    columns, rows = process.terrain.shape[1] - 2, process.terrain.shape[2] - 2
    world = np.zeros((len(cells), COLUMN_COUNT), dtype=np.int64)
    states = np.full(len(cells), -1)
    for i in range(len(cells)):
        if not (0 <= cells[i, 0] < columns and 0 <= cells[i, 1] < rows):
            return world, states
    for i in range(len(cells)):
        world[i, X] = cells[i, 0]
        world[i, Y] = cells[i, 1]
        world[i, CLASS] = observation.distance_class[i]
        world[i, SIGN] = observation.gradient_sign[i]
        world[i, AXIS] = observation.direction[i] % AXIS_COUNT
    for i in range(len(cells)):
        _, world[i, BEARING], world[i, PARTNER] = nearest_other(process, world, i)
        states[i] = state_index(process, world, i)
    return world, states


@kernel
def greedy(values: np.ndarray, facing: np.ndarray) -> np.ndarray:
    """(N,) int64, greedy direction of each robot by its values (N, 8); ties by least rotation."""
    actions = np.empty_like(facing)
    for i in range(len(facing)):
        actions[i] = least_rotation_argmax(values[i], facing[i])
    return actions

"""What a robot's table says of each cell of the board, for pictures of values and policies."""

import numpy as np

from agent.process.readings import Process
from cosim.recording.policy_map import PolicyMap


def cell_map(process: Process, values: np.ndarray, visits: np.ndarray) -> PolicyMap:
    """A robot's table over cells, over the other features weighted by visits.

    Args:
        process: the decision process, for the layout of the table.
        values: (states, 8) action values.
        visits: (states,) decisions made in each state.
    """
    columns, rows = (size - 2 for size in process.terrain.shape[1:])
    strides, cells = process.strides, columns * rows
    x, y = np.divmod(np.arange(cells), rows)
    base = x * strides[0] + y * strides[1]
    # The other features have the smallest strides: a cell's states follow one another.
    told_apart = (columns if strides[0] else 1) * (rows if strides[1] else 1)
    states = base[:, None] + np.arange(process.state_count // told_apart)
    weights = visits[states].astype(np.float64)
    total = weights.sum(axis=1)
    value = (values.max(axis=1)[states] * weights).sum(axis=1) / np.maximum(total, 1.0)
    usual = states[np.arange(cells), weights.argmax(axis=1)]
    action = values[usual].argmax(axis=1)
    shape = (columns, rows)
    return PolicyMap(value.reshape(shape), action.reshape(shape), total.reshape(shape))

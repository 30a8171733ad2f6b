"""Values and actions of a policy in each cell: the record between the agent and the recordings."""

from typing import NamedTuple

import numpy as np


class PolicyMap(NamedTuple):
    """A robot's policy by cell; arrays of shape (columns, rows).

    Attributes:
        value: largest action value, mean over the cell's states weighted by visits.
        action: greedy direction index in the state visited most.
        visits: decisions made in the cell while learning.
    """

    value: np.ndarray
    action: np.ndarray
    visits: np.ndarray

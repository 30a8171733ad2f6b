"""One rule for all robots of a swarm, by what each sees of its nearest neighbours.

Nothing is learnt, planned or remembered. Robots drive towards their targets and pass each other on
the right: `minirobots evaluate --policy docs.examples.swarm:Local --scenario swarm-64 --shield`.
"""

import numpy as np
from scipy.spatial import KDTree

from cosim.onboard.features import AXIS_COUNT, DIRECTIONS, Observation

NEIGHBOURS = 6  # that a robot sees
KEPT = 1.1  # assumed: diameters that centres of cells stay apart
SEEN = 2.0  # assumed: diameters, see Eq. (9), within which robots begin to pass each other
_BLOCKED, _TURN, _RIGHT = 4.0, 0.05, 1.5  # assumed: weights against a move straight ahead, 1


class Local:
    """Drives in the direction of eight that is worth most.

    Args:
        diameter_cells: of every robot.
    """

    def __init__(self, diameter_cells: float = 5.0) -> None:
        self._kept, self._seen = KEPT * diameter_cells, SEEN * diameter_cells

    def act(self, observation: Observation) -> np.ndarray:
        """Return the direction of each robot (N,), counted counter-clockwise from east."""
        cells, goals = observation.cells, observation.goals
        n, k = len(cells), min(NEIGHBOURS, len(cells) - 1)
        away = (observation.targets - cells).astype(float)
        left = np.linalg.norm(away, axis=1, keepdims=True)
        ahead = away / np.maximum(left, 1e-9)
        near = KDTree(cells).query(cells, k + 1)[1].reshape(n, -1)
        near = np.array([row[row != i][:k] for i, row in enumerate(near)], dtype=int).reshape(n, k)
        # Eq. (9) knows the distance of the nearest one; here it has a direction as well.
        between = (cells[near] - cells[:, None]).astype(float)
        distance = np.linalg.norm(between, axis=2)
        facing = (between * ahead[:, None]).sum(axis=2) > 0.5 * distance
        meets = facing & (distance < np.minimum(self._seen, left))
        urge = np.where(meets, (self._seen - distance) / (self._seen - self._kept), 0.0)
        aside = np.column_stack([ahead[:, 1], -ahead[:, 0]])  # to the right
        wanted = ahead + _RIGHT * urge.max(axis=1, initial=0.0)[:, None].clip(0.0, 1.0) * aside
        steps = DIRECTIONS / np.linalg.norm(DIRECTIONS, axis=1, keepdims=True)
        worth = (wanted @ steps.T) / np.maximum(np.linalg.norm(wanted, axis=1, keepdims=True), 1e-9)
        turns = (
            np.arange(len(DIRECTIONS)) % AXIS_COUNT != observation.direction[:, None] % AXIS_COUNT
        )
        worth -= _TURN * turns
        after = cells[:, None] + DIRECTIONS
        for places in (cells, goals):
            apart = np.linalg.norm(after[:, :, None] - places[near][:, None], axis=3)
            nearer = apart < np.minimum(self._kept, distance[:, None])
            worth -= _BLOCKED * nearer.any(axis=2)
        closest = KDTree(observation.targets).query(after.reshape(-1, 2), min(n, 2))[1]
        closest = closest.reshape(n, len(DIRECTIONS), -1)
        own = np.arange(n)[:, None, None]
        others = (observation.targets[closest] == after[:, :, None]).all(axis=3)
        worth -= 2.0 * _BLOCKED * (others & (closest != own)).any(axis=2)
        worth -= 2.0 * _BLOCKED * (after < 0).any(axis=2)
        return worth.argmax(axis=1)

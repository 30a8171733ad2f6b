"""One rule for all robots of a swarm, by what each sees of its nearest neighbours.

Nothing is learnt, planned or remembered. Robots drive towards their targets and pass each other on
the right: `minirobots evaluate --policy docs.examples.swarm:Local --scenario swarm-64 --shield`.
"""

import math
from pathlib import Path

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import KDTree

from cosim.model.scenario import Scenario
from cosim.model.scenario_file import find_scenario
from cosim.onboard.features import AXIS_COUNT, DIRECTIONS, Observation

NEIGHBOURS = 6  # that a robot sees
KEPT = 1.1  # assumed: diameters that centres of cells stay apart
SEEN = 2.0  # assumed: diameters, see Eq. (9), within which robots begin to pass each other
_BLOCKED, _TURN = 4.0, 0.05  # assumed: weights against a move straight ahead, 1


def ways_of(scenario: Scenario) -> np.ndarray:
    """Lengths of the shortest paths to each target in cells, (N, columns, rows), inf where none."""
    shape = scenario.columns, scenario.rows
    x, y = np.mgrid[: shape[0], : shape[1]]
    free = ~np.broadcast_to(scenario.blocks(2 * x + 1, 2 * y + 1), shape)
    edges = []
    for dx, dy in DIRECTIONS.tolist():
        to_x, to_y = (x + dx).clip(0, shape[0] - 1), (y + dy).clip(0, shape[1] - 1)
        open_ = free & free[to_x, to_y]
        ends = (
            np.ravel_multi_index((a[open_], b[open_]), shape) for a, b in ((x, y), (to_x, to_y))
        )
        edges.append((*ends, np.full(open_.sum(), math.hypot(dx, dy))))
    start, end, length = (np.concatenate(part) for part in zip(*edges, strict=True))
    graph = csr_matrix((length, (start, end)), shape=(x.size, x.size))
    targets = np.ravel_multi_index(np.array(scenario.targets).T, shape)
    return dijkstra(graph, indices=targets).reshape(-1, *shape)


class Local:
    """Drives in the direction of eight that is worth most.

    Attributes:
        right: weight of passing a robot ahead on the right.

    Args:
        scenario: whose obstacles are known; by default none are, and robots have 5 cells.
    """

    right = 1.5  # assumed

    def __init__(self, scenario: Scenario | None = None) -> None:
        cells = 5.0 if scenario is None else scenario.diameter_m / scenario.cell_m
        self._kept, self._seen = KEPT * cells, SEEN * cells
        self._ways = None if scenario is None else ways_of(scenario)

    def act(self, observation: Observation) -> np.ndarray:
        """Return the direction of each robot (N,), counted counter-clockwise from east."""
        cells, goals = observation.cells, observation.goals
        n, k = len(cells), min(NEIGHBOURS, len(cells) - 1)
        away = (observation.targets - cells).astype(float)
        left = np.linalg.norm(away, axis=1, keepdims=True)
        ahead = away / np.maximum(left, 1e-9)
        after = cells[:, None] + DIRECTIONS
        steps = DIRECTIONS / np.linalg.norm(DIRECTIONS, axis=1, keepdims=True)
        ways = np.zeros(after.shape[:2])
        if self._ways is not None:
            at = after.clip(0, np.array(self._ways.shape[1:]) - 1)
            ways = self._ways[np.arange(n)[:, None], at[..., 0], at[..., 1]]
            ahead = steps[(ways + np.linalg.norm(DIRECTIONS, axis=1)).argmin(axis=1)]
        near = KDTree(cells).query(cells, k + 1)[1].reshape(n, -1)
        near = np.array([row[row != i][:k] for i, row in enumerate(near)], dtype=int).reshape(n, k)
        # Eq. (9) knows the distance of the nearest one; here it has a direction as well.
        between = (cells[near] - cells[:, None]).astype(float)
        distance = np.linalg.norm(between, axis=2)
        facing = (between * ahead[:, None]).sum(axis=2) > 0.5 * distance
        meets = facing & (distance < np.minimum(self._seen, left))
        urge = np.where(meets, (self._seen - distance) / (self._seen - self._kept), 0.0)
        aside = np.column_stack([ahead[:, 1], -ahead[:, 0]])  # to the right
        wanted = ahead + self.right * urge.max(axis=1, initial=0.0)[:, None].clip(0.0, 1.0) * aside
        worth = (wanted @ steps.T) / np.maximum(np.linalg.norm(wanted, axis=1, keepdims=True), 1e-9)
        turns = (
            np.arange(len(DIRECTIONS)) % AXIS_COUNT != observation.direction[:, None] % AXIS_COUNT
        )
        worth -= _TURN * turns
        for places in (cells, goals):
            apart = np.linalg.norm(after[:, :, None] - places[near][:, None], axis=3)
            worth -= _BLOCKED * self.cost(apart, distance[:, None])
        closest = KDTree(observation.targets).query(after.reshape(-1, 2), min(n, 2))[1]
        closest = closest.reshape(n, len(DIRECTIONS), -1)
        own = np.arange(n)[:, None, None]
        others = (observation.targets[closest] == after[:, :, None]).all(axis=3)
        worth -= 2.0 * _BLOCKED * (others & (closest != own)).any(axis=2)
        worth -= 2.0 * _BLOCKED * (after < 0).any(axis=2)
        worth -= 2.0 * _BLOCKED * np.isinf(ways)
        return worth.argmax(axis=1)

    def cost(self, apart: np.ndarray, now: np.ndarray) -> np.ndarray:
        """Return what is against each move, (N, 8): 1 if it leads nearer to a robot that is near.

        Args:
            apart: (N, 8, k) distances to neighbours after a move, in cells.
            now: (N, 1, k) the same before it.
        """
        return (apart < np.minimum(self._kept, now)).any(axis=2)


class Barrier(Local):
    """Drives straight ahead unless a discrete-time control barrier function is against it.

    With h the distance to a neighbour less the one to keep, moves shall leave h of at least
    (1 - α) h; what they miss is a slack, which costs much. Of the formulations that
    prajolshrestha/bristlebot-swarm-mpc compares (10 to 137 robots driven by vibration) it is
    "Slack Dt-CBF", here with a horizon of one move.
    """

    right, alpha = 0.0, 0.9  # α as in that benchmark

    def cost(self, apart: np.ndarray, now: np.ndarray) -> np.ndarray:
        """Return the largest slack of each move in cells, times 100."""
        kept = self._kept
        slack = kept + (1.0 - self.alpha) * (now - kept) - apart
        return 100.0 * slack.max(axis=2, initial=0.0)


class ThroughDoor(Local):
    """The rule for docs/examples/door.toml, whose walls it knows."""

    def __init__(self) -> None:
        super().__init__(find_scenario(Path(__file__).with_name("door.toml")))

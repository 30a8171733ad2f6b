"""Policies that want robots to collide, from what each sees of the nearest, and their board."""

import math
from itertools import combinations

import numpy as np

from cosim.coupling.rl_step import Step
from cosim.model.params import TABLE_I
from cosim.model.scenario import Cell, Scenario, touches_obstacle
from cosim.onboard.features import DIRECTION_COUNT, Observation

SIDE, CELL_M = 16, 0.01
NEAR_CELLS = 7.0  # farthest distance of robots at the start
TARGETS = ((2, 2), (13, 13), (2, 13))
OBSTACLES = ((7, 7), (8, 7))
WANDERING = 0.1  # share of decisions that the greedy and the learnt leave to chance
REACH, _RATE, _DISCOUNT = 9, 0.3, 0.8  # of the learnt: cells that it tells apart, Q-learning


class Random:
    """Any direction."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.rng = rng

    def act(self, observation: Observation) -> np.ndarray:
        """Direction index of each robot."""
        return self.rng.integers(DIRECTION_COUNT, size=len(observation.cells))


class Greedy(Random):
    """Straight at the nearest robot."""

    def act(self, observation: Observation) -> np.ndarray:
        """Direction index of each robot."""
        chosen = np.array([self.choice(offset) for offset in _offsets(observation)])
        wanders = self.rng.random(len(chosen)) < WANDERING
        return np.where(wanders, super().act(observation), chosen)

    def choice(self, offset: np.ndarray) -> int:
        """Direction for the offset (x, y) of the nearest robot in cells."""
        return round(math.atan2(offset[1], offset[0]) / (math.pi / 4.0)) % DIRECTION_COUNT


class Learnt(Greedy):
    """Q-learning, one table for all robots: every millimetre closer is a reward.

    What it learns of one episode of a block the next ones have.

    Args:
        rng: of its actions.
        q: what it has learnt, by offset and direction; changed.
    """

    def __init__(self, rng: np.random.Generator, q: np.ndarray) -> None:
        super().__init__(rng)
        self.q = q

    def choice(self, offset: np.ndarray) -> int:
        """See `Greedy`."""
        return int(np.argmax(self.q[tuple(offset + REACH)]))

    def learn(self, step: Step) -> None:
        """Take what the robots did in an RL step."""
        position = step.samples.position[:, :, :2]
        for robot, (before, after) in enumerate(
            zip(_offsets(step.before), _offsets(step.after), strict=True)
        ):
            if step.action[robot] < 0:
                continue  # it waited, or had arrived: what it wanted was not tried
            others = np.delete(position, robot, axis=1)
            gaps = np.linalg.norm(others - position[:, robot, None], axis=2).min(axis=1)
            value = self.q[tuple(after + REACH)].max()
            entry = *(before + REACH), step.action[robot]
            target = 1e3 * float(gaps[0] - gaps[-1]) + _DISCOUNT * value
            self.q[entry] += _RATE * (target - self.q[entry])


def _offsets(observation: Observation) -> np.ndarray:
    """(N, 2) offset of the nearest other robot of each in cells, clipped."""
    cells = observation.cells
    apart = cells[None] - cells[:, None]
    squared = (apart**2).sum(axis=2)
    np.fill_diagonal(squared, np.iinfo(np.int64).max)
    nearest = apart[np.arange(len(cells)), squared.argmin(axis=1)]
    return nearest.clip(-REACH, REACH)


def arena(robots: int) -> Scenario:
    """The board; every cell but targets where a robot touches no obstacle is a start of all."""
    targets, walls = TARGETS[:robots], np.array([(x, y, x + 1, y + 1) for x, y in OBSTACLES])
    radius = 0.5 * TABLE_I.diameter_m / CELL_M
    cells = tuple(
        (x, y)
        for x in range(SIDE)
        for y in range(SIDE)
        if (x, y) not in targets and not touches_obstacle(x + 0.5, y + 0.5, radius**2, walls)
    )
    starts = (cells,) * robots
    return Scenario(
        "arena", "", targets, starts, SIDE, SIDE, CELL_M, (7, 7, 8, 8), obstacles=OBSTACLES
    )


def near_starts(scenario: Scenario, rng: np.random.Generator) -> tuple[Cell, ...]:
    """Start cells of robots that do not touch, each near another one."""
    cells = scenario.starts[0]
    while True:
        starts = tuple(cells[k] for k in rng.integers(len(cells), size=scenario.robots))
        squared = [(a[0] - b[0]) ** 2 + (a[1] - b[1]) ** 2 for a, b in combinations(starts, 2)]
        if min(squared) > scenario.squared_contact and max(squared) <= NEAR_CELLS**2:
            return starts

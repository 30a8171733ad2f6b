"""The grid as learners see it: robots are rows, rewards are shaped, episodes begin anywhere."""

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from agent.deep import NetworkAlgorithm
from agent.deep.inputs import GROUPS, NOTHING, Inputs, look_at_boards
from agent.envs.boards import Boards
from agent.mdp.config import ProcessConfig
from agent.mdp.grid import X, Y
from agent.mdp.optimum import distances_alone, steps_alone
from agent.mdp.readings import FREE, Process, build_process
from cosim.model.scenario import Scenario
from cosim.onboard.features import DIRECTION_COUNT

WIDTH = GROUPS + DIRECTION_COUNT  # of an observation: rows of the first layer, possible moves
_SCALE = 0.1  # of rewards
_STEP_LIMIT = 150  # moves after which an episode is cut, and still has a value


class Shaping(NamedTuple):
    """Rewards of a learner.

    Attributes:
        process: readings, of which the worth of a target.
        gamma: discount rate.
        potential: φ, (N, columns · rows) float64, by the process and γ.
    """

    process: ProcessConfig
    gamma: float
    potential: Callable[[Process, float], np.ndarray]


def minus_distances_alone(process: Process, _: float) -> np.ndarray:
    """Each robot's shortest path to its target as if it were alone, negative."""
    return -_reachable(distances_alone(process))


def values_alone(process: Process, gamma: float) -> np.ndarray:
    """Return what Eq. (8) gives a robot that takes the fewest moves as if it were alone."""
    steps = _reachable(steps_alone(process)).astype(int)
    values = np.zeros(steps.max() + 1)
    for k in range(1, len(values)):
        values[k] = float(process.goal_reward) if k == 1 else gamma * values[k - 1] - 1.0
    return values[steps]


def _reachable(costs: np.ndarray) -> np.ndarray:
    """Costs where cells without a path cost as much as the farthest one."""
    finite = np.isfinite(costs)
    return np.where(finite, costs, costs[finite].max())


_PPO = Shaping(ProcessConfig(), 0.98, minus_distances_alone)
# Values of moves are compared with each other: they differ by some tenths, and next to the paper's
# 100 for a target a network would not see it. Of what a robot alone would earn nothing is left.
SHAPING: dict[NetworkAlgorithm, Shaping] = {
    "ddqn": Shaping(ProcessConfig(goal_reward=10.0), 0.95, values_alone),
    "ippo": _PPO,
    "mappo": _PPO,
}


class Gained(NamedTuple):
    """Result of one step for the R rows.

    Attributes:
        rewards: (R,) float32, shaped and scaled.
        after: (R, WIDTH) float32, what was observed after it.
        terminated: (R,) bool; also true for robots that took no part in the step.
        truncated: (R,) bool.
    """

    rewards: np.ndarray
    after: np.ndarray
    terminated: np.ndarray
    truncated: np.ndarray


class LearningGrid:
    """Boards whose episodes begin in any free cells out of contact.

    Rewards get γ φ(s') − φ(s) more, and φ = 0 at the end: best policies stay the best (Ng, Harada
    and Russell 1999).
    A robot that has ended observes nothing until its board begins again.

    Attributes:
        inputs: how what robots see is numbered.
        episodes: ended so far.
    """

    def __init__(self, scenario: Scenario, boards: int, seed: int, shaping: Shaping) -> None:
        config, self._gamma = shaping.process, shaping.gamma
        process = build_process(scenario, config)
        limited = replace(config, step_limit=min(config.step_limit, _STEP_LIMIT))
        self._boards = Boards(boards, exploring(scenario, process), limited)
        self._boards.seed(np.random.SeedSequence(seed).spawn(boards))
        self.inputs = Inputs.of(scenario, process)
        self._potential = shaping.potential(process, shaping.gamma)
        self._limits = np.array((scenario.columns - 1, scenario.rows - 1))
        shape = (boards, scenario.robots)
        self._rows = np.zeros((*shape, GROUPS), dtype=np.float32)
        self._possible = np.zeros((*shape, DIRECTION_COUNT), dtype=np.float32)
        self.episodes = 0
        self._boards.reset(None)
        self._look()

    def observations(self) -> np.ndarray:
        """(R, WIDTH) float32; nothing, and every move possible, for robots that have ended."""
        return np.where(self._active()[:, None], self._seen, _ENDED)

    def cells(self) -> np.ndarray:
        """(R, 2N) float32, cells of a row's robot and of the others of its board."""
        n = self._cells.shape[1]
        order = (np.arange(n)[:, None] + np.arange(n)) % n
        return self._cells[:, order].reshape(len(self._seen), 2 * n).astype(np.float32)

    def moving(self) -> np.ndarray:
        """(M,) int64, rows of the robots that take the next step."""
        return np.flatnonzero(self._active())

    def step(self, actions: np.ndarray) -> Gained:
        """Let robots take their (R,) actions."""
        active, before = self._active().copy(), self._height
        self._boards.step(actions.reshape(self._cells.shape[:2]).astype(np.int64))
        self._look()
        arrays = self._boards.arrays
        self.episodes += int(np.count_nonzero(arrays.outcomes))
        terminated = arrays.terminated.ravel() | ~active
        after = np.where(terminated, 0.0, self._gamma * self._height)
        rewards = np.where(active, arrays.rewards.ravel() + after - before, 0.0)
        return Gained(
            (_SCALE * rewards).astype(np.float32),
            self._seen,
            terminated,
            arrays.truncated.ravel().copy(),
        )

    def _active(self) -> np.ndarray:
        return self._boards.arrays.active.ravel()

    def _look(self) -> None:
        # a robot that left the board has ended, and is taken to be at its edge
        cells = np.clip(self._boards.grid.worlds[:, :, [X, Y]], 0, self._limits)
        rows = int(self._limits[1]) + 1
        look_at_boards(self.inputs, cells, self._rows, self._possible, rows)
        self._cells = cells
        self._seen = np.concatenate([self._rows, self._possible], axis=2).reshape(-1, WIDTH)
        robots = np.arange(cells.shape[1])
        self._height = self._potential[robots, cells[..., 0] * rows + cells[..., 1]].ravel()


_ENDED = np.array([NOTHING] * GROUPS + [1] * DIRECTION_COUNT, dtype=np.float32)


def exploring(scenario: Scenario, process: Process) -> Scenario:
    """The scenario with every free cell of the board as a start cell of every robot."""
    starts = tuple(
        tuple((int(x), int(y)) for x, y in np.argwhere(terrain[1:-1, 1:-1] == FREE))
        for terrain in process.terrain
    )
    return replace(scenario, starts=starts)

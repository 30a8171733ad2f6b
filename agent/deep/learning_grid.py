"""The grid as learners see it: robots are rows, rewards are shaped, episodes begin anywhere."""

import contextlib
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
from cosim.model.scenario import Scenario, ScenarioError
from cosim.onboard.features import DIRECTION_COUNT

WIDTH = GROUPS + DIRECTION_COUNT  # of an observation: rows of the first layer, possible moves
_SCALE = 0.1  # of rewards
_GRIDS = 15  # of different targets at a time
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
    """Boards with episodes that begin in any free cells out of contact.

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
        return np.where(self.active()[:, None], self._seen, _ENDED)

    def cells(self) -> np.ndarray:
        """(R, 2N) float32, cells of a row's robot and of the others of its board."""
        n = self._cells.shape[1]
        order = (np.arange(n)[:, None] + np.arange(n)) % n
        return self._cells[:, order].reshape(len(self._seen), 2 * n).astype(np.float32)

    def moving(self) -> np.ndarray:
        """(M,) int64, rows of the robots that take the next step."""
        return np.flatnonzero(self.active())

    def step(self, actions: np.ndarray) -> Gained:
        """Let robots take their (R,) actions."""
        active, before = self.active().copy(), self._height
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

    def active(self) -> np.ndarray:
        """(R,) bool, rows of the robots that take the next step."""
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


class DrawnTargets:
    """Learning grids with targets that are drawn, again and again.

    Attributes:
        inputs: see `LearningGrid`; but for the targets those of all grids.
    """

    def __init__(self, scenario: Scenario, boards: int, seed: int, shaping: Shaping) -> None:
        self._rng, self._steps, self._ended = np.random.default_rng(seed), 0, 0
        self._made = scenario, boards // _GRIDS, shaping
        self._grids = [self._drawn() for _ in range(_GRIDS)]
        self.inputs = self._grids[0].inputs

    @property
    def episodes(self) -> int:
        """Episodes ended so far."""
        return self._ended + sum(grid.episodes for grid in self._grids)

    def observations(self) -> np.ndarray:
        """(R, WIDTH) float32, see `LearningGrid`."""
        return np.concatenate([grid.observations() for grid in self._grids])

    def cells(self) -> np.ndarray:
        """(R, 2N) float32, see `LearningGrid`."""
        return np.concatenate([grid.cells() for grid in self._grids])

    def moving(self) -> np.ndarray:
        """(M,) int64, see `LearningGrid`."""
        return np.flatnonzero(np.concatenate([grid.active() for grid in self._grids]))

    def step(self, actions: np.ndarray) -> Gained:
        """Let robots take their (R,) actions; in turn, one grid begins with other targets."""
        parts = zip(self._grids, np.split(actions, len(self._grids)), strict=True)
        gained = [grid.step(taken) for grid, taken in parts]
        self._steps += 1
        turn, rest = divmod(self._steps, _STEP_LIMIT // _GRIDS)
        if not rest:
            gained[turn % _GRIDS].truncated[:] = True
            self._ended += self._grids[turn % _GRIDS].episodes
            self._grids[turn % _GRIDS] = self._drawn()
        return Gained(*map(np.concatenate, zip(*gained, strict=True)))

    def _drawn(self) -> LearningGrid:
        scenario, boards, shaping = self._made
        drawn = with_drawn_targets(scenario, shaping.process, self._rng)
        return LearningGrid(drawn, boards, int(self._rng.integers(2**32)), shaping)


World = LearningGrid | DrawnTargets
_ENDED = np.array([NOTHING] * GROUPS + [1] * DIRECTION_COUNT, dtype=np.float32)


def exploring(scenario: Scenario, process: Process) -> Scenario:
    """The scenario with every free cell of the board as a start cell of every robot."""
    starts = tuple(
        tuple((int(x), int(y)) for x, y in np.argwhere(terrain[1:-1, 1:-1] == FREE))
        for terrain in process.terrain
    )
    return replace(scenario, starts=starts)


def with_drawn_targets(
    scenario: Scenario, config: ProcessConfig, rng: np.random.Generator
) -> Scenario:
    """Return a scenario with drawn targets, and every other free cell as a start cell."""
    own = exploring(scenario, build_process(scenario, config))
    free = [{*cells, own.targets[robot]} for robot, cells in enumerate(own.starts)]
    while True:
        targets = tuple(sorted(cells)[rng.integers(len(cells))] for cells in free)
        starts = tuple(tuple(sorted(cells - {*targets})) for cells in free)
        with contextlib.suppress(ScenarioError):  # targets that touch
            return replace(scenario, targets=targets, starts=starts)

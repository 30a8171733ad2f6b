"""Boards that environments step together: what they have in common, and those of the grid.

Environments (`agent.envs.navigation`, `agent.envs.drive`) are views of boards, and add nothing to
the process. The boards in the dynamics are in `agent.envs.dynamics`.
"""

import copy
from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Annotated, Any, ClassVar, NamedTuple

import msgspec
import numpy as np
from gymnasium import spaces

from agent.mdp.config import ProcessConfig, refuse_without_effect
from agent.mdp.grid import (
    COLUMN_COUNT,
    FEATURE_COLUMNS,
    MOVING,
    STATUS,
    VX,
    VY,
    X,
    Y,
    move,
    place,
    place_randomly,
    slipped,
)
from agent.mdp.interpretations import FREE, GOAL, Process, build_process, feature_sizes
from agent.mdp.rng import seeded_state
from cosim.base.arguments import ConfigError, numbers, validate_argument
from cosim.base.errors import shorten
from cosim.base.jit import inlined, kernel
from cosim.model.outcome import RUNNING, TIMEOUT
from cosim.model.scenario import Scenario
from cosim.onboard.features import DIRECTION_COUNT, DIRECTIONS

Count = Annotated[int, msgspec.Meta(ge=1)]
_Seed = Annotated[int, msgspec.Meta(ge=0)]
_NO_LIMIT = 2**62  # of steps


class Results(NamedTuple):
    """Result of the last step of K boards of N robots with F features."""

    outcomes: np.ndarray  # (K,) int64, ranks of `cosim.model.outcome`
    over: np.ndarray  # (K,) bool, boards whose episode has an outcome or was cut
    # (K, N, F); on the grid int64 features counted from 0, where a robot that left the board seems
    # to be at its edge
    observations: np.ndarray
    rewards: np.ndarray  # (K, N) float64
    terminated: np.ndarray  # (K, N) bool, robots that arrived or failed in the step
    # (K, N) bool, robots still on their move when the episode ended in the step, and those that
    # moved in a step that cut it
    truncated: np.ndarray
    active: np.ndarray  # (K, N) bool, robots that use their next action


class EnvBoards(ABC):
    """K boards of N robots each, as the environments step them.

    A robot that has ended before the others of its board stays there, inactive: its actions are
    ignored, its rewards 0. The step after the end of a board's episode begins another one with all
    its robots, as the first step does without a reset. A limit of steps cuts an episode as
    Gymnasium's `TimeLimit` does: it is no outcome, and truncates whatever else the step has.

    Attributes:
        scenario: board, targets and start cells.
        shape: (K, N).
        arrays: results of the last step.
        terms: of the rewards of the last step, (K, N) float64 by name; empty on the grid.
        observation_space, action_space: of one robot.
        reset_options: names of what `reset` takes of each board.
    """

    reset_options: ClassVar[tuple[str, ...]] = ("starts",)
    _mutable: ClassVar[tuple[str, ...]]  # names of the attributes that change

    def __init__(
        self,
        count: int,
        scenario: Scenario,
        observation_space: spaces.Space,
        action_space: spaces.Space,
        *options: Any,
    ) -> None:
        self.scenario = scenario
        self.shape = rows = (validate_argument("num_envs", count, Count), scenario.robots)
        self.observation_space, self.action_space = observation_space, action_space
        # without which a state means something else
        self._identity = rows, scenario, observation_space, *options
        self.terms: dict[str, np.ndarray] = {}
        flags = [np.zeros(rows, dtype=bool) for _ in range(3)]
        size, kind = observation_space.shape or (), observation_space.dtype
        # none is running yet
        self.arrays: Results = Results(
            np.full(count, TIMEOUT),
            np.ones(count, dtype=bool),
            np.zeros((*rows, *size), dtype=kind),
            np.zeros(rows),
            *flags,
        )

    def seed(self, seed: int | Sequence[int | None] | None) -> None:
        """Seed the boards, see `board_seeds`."""
        for m, own in enumerate(board_seeds(seed, self.shape[0])):
            if own is not None:
                self._seed(m, own)

    @abstractmethod
    def _seed(self, m: int, seed: int) -> None:
        """Seed what board m draws."""

    def reset(
        self, options: dict[str, Any] | None, seed: int | Sequence[int | None] | None = None
    ) -> None:
        """Begin episodes.

        Args:
            options: K values of each of `reset_options`, None where the usual one is drawn or
                taken; "reset_mask", (K,) bool, boards to begin again, all without.
            seed: of the boards that begin again, see `board_seeds`.
        """
        count = self.shape[0]
        checked = checked_options(options, *self.reset_options, "reset_mask")
        given = {name: values for name, values in checked.items() if values is not None}
        for name, values in given.items():
            sized = isinstance(values, list | tuple) or getattr(values, "ndim", 0)
            if not sized or len(values) != count:
                raise ConfigError(
                    f"{name} = {shorten(values)}; give one to each of the {count} boards"
                )
        mask = validate_argument("reset_mask", given.pop("reset_mask", [True] * count), list[bool])
        if not (np.array(mask) | self._begun()).all():
            raise ConfigError("reset_mask leaves out environments that have not begun; reset all")
        seeds = board_seeds(seed, count)
        which = np.flatnonzero(mask).tolist()
        rows = {m: {k: v[m] for k, v in given.items() if v[m] is not None} for m in which}
        begins = {m: self._checked(**row) for m, row in rows.items()}
        self.seed([own if m in begins else None for m, own in enumerate(seeds)])
        self._begin(begins)

    def _begun(self) -> np.ndarray:
        """Return which boards have begun an episode or need none, (K,) bool."""
        return np.ones(self.shape[0], dtype=bool)

    @abstractmethod
    def _checked(self, *arguments: Any, **options: Any) -> Any:
        """Return what `_begin` takes of a board, from its options of a reset; raises UserError."""

    @abstractmethod
    def _begin(self, given: dict[int, Any]) -> None:
        """Begin episodes on some boards."""

    def joint(self, actions: Any) -> np.ndarray:
        """Return (K, N) directions for `step`, of those that a learner gave to K · N robots."""
        boards, robots = self.shape
        rows, last = numbers(actions, (boards * robots,), "iu"), DIRECTION_COUNT - 1
        if rows is not None and rows.min() >= 0 and rows.max() <= last:
            return rows.reshape(self.shape)
        given = np.asarray(actions, dtype=object)
        if given.shape != (boards * robots,):
            raise ConfigError(
                f"actions = {shorten(actions)} are not directions; choose one whole number from "
                f"0 to {last} for each of the {boards * robots} robots"
            )
        whole = [numbers(action, (), "iu") for action in given]
        row = next(k for k, number in enumerate(whole) if number is None or not 0 <= number <= last)
        where = f" on board {row // robots}" if boards > 1 else ""
        raise ConfigError(
            f"action {shorten(given[row])} of robot_{row % robots + 1}{where} is not a direction; "
            f"choose a whole number from 0 to {last}"
        )

    @abstractmethod
    def step(self, actions: np.ndarray) -> None:
        """Let every active robot take its action, of shape (K, N, ...)."""

    def remaining(self) -> np.ndarray:
        """Return which robots have not ended their episode, (K, N) bool."""
        return self.arrays.active & ~self.arrays.over[:, None]

    @abstractmethod
    def path_length_cm(self) -> np.ndarray:
        """Return path lengths since the start, (K, N) float64."""

    @abstractmethod
    def scenes(self) -> list[tuple[Scenario, np.ndarray]]:
        """Return of each board what a picture shows: its scenario and (N, 2) positions in m."""

    def close(self) -> None:
        """End all episodes, and free what simulates."""
        self.arrays.outcomes[:], self.arrays.over[:] = TIMEOUT, True

    def get_state(self) -> dict[str, Any]:
        """Return a copy of everything that changes; it can be pickled."""
        mine = {name: getattr(self, name) for name in self._mutable}
        return {"identity": self._identity} | {
            name: value.get_state() if hasattr(value, "get_state") else copy.deepcopy(value)
            for name, value in mine.items()
        }

    def set_state(self, state: dict[str, Any]) -> None:
        """Restore a state of these boards, or of some that were made with the same arguments."""
        if not isinstance(state, dict) or set(state) != {"identity", *self._mutable}:
            raise ConfigError(
                f"{shorten(state)} is not a state of this kind of environment; give the result "
                "of get_state() of one that was made with the same arguments"
            )
        if (its := state["identity"]) != self._identity:
            raise ConfigError(
                f"a state of {its[0][0]} boards of {its[0][1]} robots does not fit "
                f"{self.shape[0]} of {self.shape[1]} with this scenario and these options; "
                "restore it where the same arguments were given"
            )
        for name in self._mutable:
            mine, saved = getattr(self, name), state[name]
            if hasattr(mine, "set_state"):
                mine.set_state(saved)
            else:
                setattr(self, name, copy.deepcopy(saved))


class GridState(NamedTuple):
    """State of K boards with N robots each on the grid."""

    worlds: np.ndarray  # (K, N, COLUMN_COUNT) int64, see `agent.mdp.grid`
    random: np.ndarray  # (K, 1) uint64, generator states
    steps: np.ndarray  # (K,) int64, of the episode
    path_cells: np.ndarray  # (K, N) float64, path since the start in cells


@inlined
def _observe(features: np.ndarray, grid: GridState, results: Results, m: int) -> None:
    for i in range(grid.worlds.shape[1]):
        for k in range(features.shape[0]):
            value = grid.worlds[m, i, features[k, 0]] + features[k, 1]
            results.observations[m, i, k] = min(max(value, 0), features[k, 2])


@inlined
def _begin(features: np.ndarray, grid: GridState, results: Results, m: int) -> None:
    """Begin an episode on board m, after its robots have been placed."""
    grid.steps[m] = 0
    results.outcomes[m] = RUNNING
    results.over[m] = False
    grid.path_cells[m] = 0.0
    results.rewards[m] = 0.0
    results.terminated[m] = False
    results.truncated[m] = False
    results.active[m] = True
    _observe(features, grid, results, m)


@kernel
def _begin_some(
    process: Process,
    features: np.ndarray,
    grid: GridState,
    results: Results,
    which: np.ndarray,
    draws: np.ndarray,
) -> None:
    """Begin episodes on (B,) boards, from drawn start cells or as placed."""
    cells = np.empty((grid.worlds.shape[1], 2), dtype=np.int64)
    for k in range(len(which)):
        m = which[k]
        if draws[k]:
            place_randomly(process, grid.worlds[m], cells, grid.random[m])
        _begin(features, grid, results, m)


@kernel
def _step(
    process: Process,
    features: np.ndarray,
    grid: GridState,
    results: Results,
    actions: np.ndarray,
    limit: int,
) -> None:
    """Step every board by (K, N) int64 actions; one that has ended begins again instead.

    Args:
        limit: of steps, which cuts episodes.
    """
    n = len(process.start_offsets) - 1
    cells = np.empty((n, 2), dtype=np.int64)
    executed = np.empty(n, dtype=np.int64)
    rewards = np.empty(n, dtype=np.float32)
    slips = process.slip_threshold > np.uint64(0)
    for m in range(len(actions)):
        world = grid.worlds[m]
        if results.over[m]:
            place_randomly(process, world, cells, grid.random[m])
            _begin(features, grid, results, m)
            continue
        for i in range(n):
            executed[i] = actions[m, i]
            if slips and results.active[m, i]:
                executed[i] = slipped(process, executed[i], grid.random[m])
        outcome = move(process, world, executed, rewards)
        grid.steps[m] += 1
        if outcome == RUNNING and grid.steps[m] == process.step_limit:
            outcome = TIMEOUT
        cut = grid.steps[m] >= limit
        results.outcomes[m] = outcome
        results.over[m] = outcome != RUNNING or cut
        for i in range(n):
            moved, moving = results.active[m, i], world[i, STATUS] == MOVING
            grid.path_cells[m, i] += np.sqrt(float(world[i, VX] ** 2 + world[i, VY] ** 2))
            results.rewards[m, i] = rewards[i]
            results.terminated[m, i] = moved and not moving
            results.truncated[m, i] = moved and (cut or (moving and outcome != RUNNING))
            results.active[m, i] = moving and outcome == RUNNING
        _observe(features, grid, results, m)


class Boards(EnvBoards):
    """K boards of a scenario on the grid; `arrays` is overwritten by every step.

    Args:
        limit: of steps; None for none.
    """

    _mutable = ("grid", "arrays")

    def __init__(
        self, count: int, scenario: Scenario, config: ProcessConfig, limit: int | None = None
    ) -> None:
        refuse_without_effect(config, "environments on the grid")
        self._limit = min(limit or _NO_LIMIT, _NO_LIMIT)
        self.process = build_process(scenario, config)
        super().__init__(count, scenario, *direction_spaces(scenario, config), config)
        self._features = np.array(observed_columns(scenario, config))
        self._free = free_directions(self.process)
        self.grid: GridState = GridState(
            worlds=np.zeros((*self.shape, COLUMN_COUNT), dtype=np.int64),
            random=np.zeros((count, 1), dtype=np.uint64),
            steps=np.zeros(count, dtype=np.int64),
            path_cells=np.zeros(self.shape),
        )

    def _seed(self, m: int, seed: int) -> None:
        self.grid.random[m] = seeded_state(seed)

    def _checked(self, starts: Any = None) -> np.ndarray | None:
        """Return the world of robots on their (N, 2) start cells; None to draw them."""
        return None if starts is None else placed_world(self.process, starts)

    def _begin(self, given: dict[int, np.ndarray | None]) -> None:
        for m, world in given.items():
            if world is not None:
                self.grid.worlds[m] = world
        which = np.array([*given], dtype=np.int64)
        draws = np.array([world is None for world in given.values()], dtype=bool)
        _begin_some(self.process, self._features, self.grid, self.arrays, which, draws)

    def step(self, actions: np.ndarray) -> None:
        """See `EnvBoards.step`."""
        _step(self.process, self._features, self.grid, self.arrays, actions, self._limit)

    def path_length_cm(self) -> np.ndarray:
        """See `EnvBoards.path_length_cm`."""
        return 100.0 * self.scenario.cell_m * self.grid.path_cells

    def scenes(self) -> list[tuple[Scenario, np.ndarray]]:
        """See `EnvBoards.scenes`."""
        centres_m = (self.grid.worlds[:, :, [X, Y]] + 0.5) * self.scenario.cell_m
        return [(self.scenario, positions_m) for positions_m in centres_m]

    def action_masks(self) -> np.ndarray:
        """Return which directions lead to a free cell, (K, N, 8) int8; see `free_directions`."""
        x, y = self.grid.worlds[..., X], self.grid.worlds[..., Y]
        return self._free[np.arange(self.shape[1]), x + 1, y + 1]


def direction_spaces(
    scenario: Scenario, process: ProcessConfig
) -> tuple[spaces.MultiDiscrete, spaces.Discrete]:
    """Return the spaces of a robot that observes features and chooses directions."""
    sizes = list(feature_sizes(scenario, process).values())
    return spaces.MultiDiscrete(sizes), spaces.Discrete(DIRECTION_COUNT)


def board_seeds(seed: int | Sequence[int | None] | None, count: int) -> list[int | None]:
    """Return a seed for each board. A single seed counts up; None leaves a board unchanged."""
    seeds = validate_argument("seed", seed, _Seed | list[_Seed | None] | None)
    if not isinstance(seeds, list):
        seeds = [seeds if seeds is None else seeds + m for m in range(count)]
    if len(seeds) != count:
        raise ConfigError(f"{len(seeds)} seeds; give one to each of the {count} boards")
    return seeds


def observed_columns(scenario: Scenario, config: ProcessConfig) -> list[tuple[int, int, int]]:
    """Return a feature's column of a world, what to add to count from 0, and its largest value."""
    return [
        (FEATURE_COLUMNS[name], 1 if name == "g" else 0, size - 1)
        for name, size in feature_sizes(scenario, config).items()
    ]


def free_directions(process: Process) -> np.ndarray:
    """Return which directions lead to a free cell or to the robot's target.

    (N, columns + 2, rows + 2, 8) int8 of robot i in cell (x, y) at [i, x + 1, y + 1]. Where no
    direction does, all count as free, as learners need one.
    """
    free = np.pad(np.isin(process.terrain, (FREE, GOAL)), ((0, 0), (1, 1), (1, 1)))
    columns, rows = process.terrain.shape[1:]
    moved = [free[:, 1 + x : 1 + x + columns, 1 + y : 1 + y + rows] for x, y in DIRECTIONS]
    table = np.stack(moved, axis=-1)
    return (table | ~table.any(axis=-1, keepdims=True)).astype(np.int8)


def placed_world(process: Process, starts: Any) -> np.ndarray:
    """Return the (N, COLUMN_COUNT) int64 world of robots on the start cells that a user gave."""
    world = np.zeros((len(process.start_offsets) - 1, COLUMN_COUNT), dtype=np.int64)
    cells = whole_cells("starts", starts, (len(world), 2))
    columns, rows = (size - 2 for size in process.terrain.shape[1:])
    if (cells < 0).any() or (cells >= (columns, rows)).any():
        raise ConfigError(f"starts {cells.tolist()} are off the {columns} x {rows} board")
    terrain = process.terrain[np.arange(len(world)), cells[:, 0] + 1, cells[:, 1] + 1]
    if terrain.any():
        raise ConfigError(f"starts {cells.tolist()} are on an obstacle or on the robot's target")
    if not place(process, world, cells):
        raise ConfigError(f"starts {cells.tolist()} let robots touch; move them further apart")
    return world


def whole_cells(name: str, cells: Any, shape: tuple[int, ...]) -> np.ndarray:
    """Return start or target cells that a user gave, int64 of a shape; raises ConfigError."""
    array = numbers(cells, shape, "iu")
    if array is None:
        raise ConfigError(
            f"{name} = {shorten(cells)} are not cells; give whole numbers [x, y] of shape {shape}"
        )
    return array


def checked_options(options: dict[str, Any] | None, *names: str) -> dict[str, Any]:
    """Return options of a reset; raises ConfigError where one has none of the names."""
    for name in options or {}:
        if name not in names:
            raise ConfigError(f"reset has no option '{name}'; choose from {', '.join(names)}")
    return options or {}

"""Many boards of the decision process, stepped by one compiled loop into arrays that are kept.

What `agent.envs.vector` and `agent.envs.parallel_vector` share; neither adds anything to the
process. An episode of one environment is one such board, with the same bits.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from agent.envs.grid_episode import (
    StartsError,
    free_directions,
    known_options,
    observed_columns,
    place_checked,
    require_seed,
    whole_cells,
)
from agent.envs.state import Restorable
from agent.mdp.config import ProcessConfig, refuse_without_effect
from agent.mdp.grid import (
    COLUMN_COUNT,
    MOVING,
    STATUS,
    VX,
    VY,
    X,
    Y,
    move,
    place_randomly,
    slipped,
)
from agent.mdp.readings import Process, build_process, feature_sizes
from agent.mdp.rng import seeded_state
from cosim.base.arguments import ConfigError, taken
from cosim.base.errors import shown
from cosim.base.jit import inlined, kernel
from cosim.model.outcome import RUNNING, TIMEOUT
from cosim.model.scenario import Scenario


class Arrays(NamedTuple):
    """State of K boards with N robots each, and what their last step gave.

    Attributes:
        worlds: (K, N, COLUMN_COUNT) int64, see `agent.mdp.grid`.
        random: (K, 1) uint64, generator states.
        steps: (K,) int64, of the episode.
        outcomes: (K,) int64, ranks of `cosim.model.outcome`.
        path_cells: (K, N) float64, path since the start in cells.
        observations: (K, N, F) int64, features counted from 0; a robot that left the board seems to
            be at its edge.
        rewards: (K, N) float64.
        terminated: (K, N) bool, robots that arrived or failed in the step.
        truncated: (K, N) bool, robots still on their move when the episode ended in the step.
        active: (K, N) bool, robots that take an action in the next step.
    """

    worlds: np.ndarray
    random: np.ndarray
    steps: np.ndarray
    outcomes: np.ndarray
    path_cells: np.ndarray
    observations: np.ndarray
    rewards: np.ndarray
    terminated: np.ndarray
    truncated: np.ndarray
    active: np.ndarray


@inlined
def _observe(features: np.ndarray, arrays: Arrays, m: int) -> None:
    for i in range(arrays.worlds.shape[1]):
        for k in range(features.shape[0]):
            value = arrays.worlds[m, i, features[k, 0]] + features[k, 1]
            arrays.observations[m, i, k] = min(max(value, 0), features[k, 2])


@inlined
def _begin(features: np.ndarray, arrays: Arrays, m: int) -> None:
    """Begin an episode on board m, whose robots have been placed."""
    arrays.steps[m] = 0
    arrays.outcomes[m] = RUNNING
    arrays.path_cells[m] = 0.0
    arrays.rewards[m] = 0.0
    arrays.terminated[m] = False
    arrays.truncated[m] = False
    arrays.active[m] = True
    _observe(features, arrays, m)


@kernel
def _begin_some(
    process: Process, features: np.ndarray, arrays: Arrays, which: np.ndarray, draw: bool
) -> None:
    """Begin episodes on boards in `which`, (K,) bool, from drawn start cells or as placed."""
    cells = np.empty((arrays.worlds.shape[1], 2), dtype=np.int64)
    for m in range(len(which)):
        if which[m]:
            if draw:
                place_randomly(process, arrays.worlds[m], cells, arrays.random[m])
            _begin(features, arrays, m)


@kernel
def _step(process: Process, features: np.ndarray, arrays: Arrays, actions: np.ndarray) -> None:
    """Step every board by (K, N) int64 actions; one that has ended begins again instead."""
    n = len(process.start_offsets) - 1
    cells = np.empty((n, 2), dtype=np.int64)
    executed = np.empty(n, dtype=np.int64)
    rewards = np.empty(n, dtype=np.float32)
    slips = process.slip_threshold > np.uint64(0)
    for m in range(len(actions)):
        world = arrays.worlds[m]
        if arrays.outcomes[m] != RUNNING:
            place_randomly(process, world, cells, arrays.random[m])
            _begin(features, arrays, m)
            continue
        for i in range(n):
            executed[i] = actions[m, i]
            if slips and arrays.active[m, i]:
                executed[i] = slipped(process, executed[i], arrays.random[m])
        outcome = move(process, world, executed, rewards)
        arrays.steps[m] += 1
        if outcome == RUNNING and arrays.steps[m] == process.step_limit:
            outcome = TIMEOUT
        arrays.outcomes[m] = outcome
        for i in range(n):
            moved, moving = arrays.active[m, i], world[i, STATUS] == MOVING
            arrays.path_cells[m, i] += np.sqrt(float(world[i, VX] ** 2 + world[i, VY] ** 2))
            arrays.rewards[m, i] = rewards[i]
            arrays.terminated[m, i] = moved and not moving
            arrays.truncated[m, i] = moved and moving and outcome != RUNNING
            arrays.active[m, i] = moving and outcome == RUNNING
        _observe(features, arrays, m)


class Boards(Restorable):
    """K boards of a scenario; `arrays` is overwritten by every step.

    A robot that has ended before the others of its board stays there, inactive: its actions are
    ignored, its rewards 0. The step after the end of a board's episode begins another one with all
    its robots, as the first step does without a reset.

    Raises:
        ScenarioError: the scenario cannot be used with these readings.
    """

    _mutable = ("arrays",)

    def __init__(self, count: int, scenario: Scenario, config: ProcessConfig) -> None:
        refuse_without_effect(config, "environments on the grid")
        self.scenario = scenario
        self.process = build_process(scenario, config)
        self._features = np.array(observed_columns(scenario, config))
        rows = (count, scenario.robots)
        self.arrays = Arrays(
            worlds=np.zeros((*rows, COLUMN_COUNT), dtype=np.int64),
            random=np.zeros((count, 1), dtype=np.uint64),
            steps=np.zeros(count, dtype=np.int64),
            outcomes=np.full(count, TIMEOUT),
            path_cells=np.zeros(rows),
            observations=np.zeros((*rows, len(self._features)), dtype=np.int64),
            rewards=np.zeros(rows),
            terminated=np.zeros(rows, dtype=bool),
            truncated=np.zeros(rows, dtype=bool),
            active=np.zeros(rows, dtype=bool),
        )

    def seed(self, seeds: Sequence[int | np.random.SeedSequence | None]) -> None:
        """Seed the generators of the K boards; None leaves one as it is."""
        for m, seed in enumerate(seeds):
            if seed is not None:
                self.arrays.random[m] = seeded_state(seed)

    def reset(
        self, options: dict[str, Any] | None, seeds: Sequence[int | None] | None = None
    ) -> None:
        """Begin episodes.

        Args:
            options: "starts", (K, N, 2) start cells, drawn without; "reset_mask", (K,) bool, boards
                to begin again, all without.
            seeds: of the K generators, of which those of boards that begin again are seeded; None
                leaves one as it is.

        Raises:
            StartsError: start cells cannot be used; the boards are as they were.
        """
        which, starts = reset_options(options, self.arrays.active.shape)
        if starts is not None:
            worlds = self.arrays.worlds.copy()
            for m in np.flatnonzero(which):
                place_checked(self.process, worlds[m], starts[m])
            self.arrays.worlds[:] = worlds
        if seeds is not None:
            self.seed([seed if begins else None for seed, begins in zip(seeds, which, strict=True)])
        _begin_some(self.process, self._features, self.arrays, which, starts is None)

    def step(self, actions: np.ndarray) -> None:
        """Let every active robot take its (K, N) int64 action."""
        _step(self.process, self._features, self.arrays, actions)

    def path_length_cm(self) -> np.ndarray:
        """(K, N) float64."""
        return 100.0 * self.scenario.cell_m * self.arrays.path_cells

    def positions_m(self) -> np.ndarray:
        """(K, N, 2) float64, centres of the robots' cells."""
        return (self.arrays.worlds[:, :, [X, Y]] + 0.5) * self.scenario.cell_m


class GridEpisode(Restorable):
    """An episode on the grid, with what environments need of one; starts are drawn by default.

    Attributes:
        scenario: board, targets and start cells.
        sizes: number of values of each feature that a robot observes.
        reset_options: names of what `reset` takes.

    Raises:
        ScenarioError: the scenario cannot be used with these readings.
    """

    reset_options = ("starts",)
    _mutable = ("_boards",)

    def __init__(self, scenario: Scenario, config: ProcessConfig | None = None) -> None:
        config = config or ProcessConfig()
        self._boards = Boards(1, scenario, config)
        self.scenario, self.process = scenario, self._boards.process
        self.sizes = tuple(feature_sizes(scenario, config).values())
        self._free = free_directions(self.process)
        self.seed(None)

    @property
    def world(self) -> np.ndarray:
        """(N, COLUMN_COUNT) int64, see `agent.mdp.grid`."""
        return self._boards.arrays.worlds[0]

    @property
    def rewards(self) -> np.ndarray:
        """(N,) float64, of the last step."""
        return self._boards.arrays.rewards[0]

    @property
    def outcome(self) -> int:
        """Rank of the outcome."""
        return int(self._boards.arrays.outcomes[0])

    @property
    def status(self) -> np.ndarray:
        """(N,) int64, status of each robot."""
        return self.world[:, STATUS]

    @property
    def active(self) -> np.ndarray:
        """(N,) bool, robots that move."""
        return self._boards.arrays.active[0].copy()

    def seed(self, seed: int | None) -> None:
        """Seed the generator of start cells and slips; with entropy if None."""
        self._boards.arrays.random[0] = seeded_state(seed)

    def reset(self, starts: np.ndarray | None = None) -> None:
        """Begin an episode.

        Raises:
            StartsError: start cells are off the board, blocked or in contact.
        """
        cells = None if starts is None else whole_cells(starts, (len(self.world), 2))
        self._boards.reset(None if cells is None else {"starts": cells[None]})

    def step(self, actions: np.ndarray) -> None:
        """One move of every robot that moves."""
        self._boards.step(np.array(actions, dtype=np.int64)[None])

    def observation(self) -> np.ndarray:
        """(N, features) int64; a robot that left the board seems to be at its edge."""
        return self._boards.arrays.observations[0].copy()

    def path_length_cm(self) -> np.ndarray:
        """(N,) float64."""
        return self._boards.path_length_cm()[0]

    def action_mask(self, robot: int) -> np.ndarray:
        """(8,) int8, see `free_directions`."""
        return self._free[robot, self.world[robot, X] + 1, self.world[robot, Y] + 1].copy()

    def positions_m(self) -> np.ndarray:
        """(N, 2) float64, centres of the robots' cells."""
        return self._boards.positions_m()[0]

    def close(self) -> None:
        """Nothing to free."""


def reset_options(
    options: dict[str, Any] | None, shape: tuple[int, ...]
) -> tuple[np.ndarray, np.ndarray | None]:
    """Which boards begin again, (K,) bool, and from which start cells, (K, N, 2), None if drawn.

    Args:
        options: of `reset`.
        shape: (K, N), boards and robots.

    Raises:
        StartsError: a shape is another one, or an option is unknown.
    """
    options = known_options(options, "starts", "reset_mask")
    starts = options.get("starts")
    return _mask(options, shape[0]), None if starts is None else whole_cells(starts, (*shape, 2))


def board_options(
    options: dict[str, Any] | None, begun: np.ndarray, *names: str
) -> tuple[list[int], list[dict[str, Any]]]:
    """Return which boards begin again, and the options of each board.

    Args:
        options: of `reset`; None is one that is not given.
        begun: (K,) bool, boards that have begun an episode before.
        names: of options that are allowed in addition to "reset_mask".

    Raises:
        StartsError: an option is unknown or not given for each board, or the mask leaves out a
            board that has not begun.
    """
    given = known_options(options, "reset_mask", *names)
    which, rows = _mask(given, len(begun)), [{} for _ in begun]
    if not (which | begun).all():
        raise StartsError("reset_mask leaves out environments that have not begun; reset all")
    for name, values in given.items():
        if name == "reset_mask" or values is None:
            continue
        if not isinstance(values, list | tuple | np.ndarray) or len(values) != len(begun):
            raise StartsError(f"{name} = {shown(values)}; give one to each of the boards")
        for row, value in zip(rows, values, strict=True):
            row[name] = value
    return np.flatnonzero(which).tolist(), rows


def _mask(options: dict[str, Any], boards: int) -> np.ndarray:
    which = np.asarray(options.get("reset_mask", np.ones(boards, dtype=bool)))
    if which.shape != (boards,) or which.dtype != bool:
        raise StartsError(
            f"reset_mask of shape {which.shape} and type {which.dtype}; give one bool to each of "
            f"the {boards} boards"
        )
    return which


def counted(name: str, value: Any, kind: Any = int) -> Any:
    """Return an argument that counts something, which must be 1 or more.

    Raises:
        ConfigError: it is less, or not of the kind.
    """
    count = taken(name, value, kind)
    if count is not None and count < 1:
        raise ConfigError(f"{name} = {count} is not allowed; give 1 or more")
    return count


def board_seeds(seed: int | Sequence[int | None] | None, count: int) -> Sequence[int | None]:
    """One seed of each board; one for all counts up, None leaves them as they are.

    Raises:
        StartsError: there is not one for each, or one is negative.
    """
    if seed is None:
        return [None] * count
    if isinstance(seed, int | np.integer):
        seed = [int(seed) + m for m in range(count)]
    if not isinstance(seed, list | tuple | np.ndarray):
        raise StartsError(f"seed = {shown(seed)} is no whole number, nor one for each board")
    if len(seed) != count:
        raise StartsError(f"{len(seed)} seeds; give one to each of the {count} boards")
    return [require_seed(one) for one in seed]

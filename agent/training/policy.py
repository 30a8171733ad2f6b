"""Policies: what to do at an observation, by tables or by plans, and their files.

The file of a policy is one `.npz` (its arrays, and its configuration as JSON) with the same JSON
next to it for people; nothing in it is executed on loading. The cache of policies is
`agent.training.store`.
"""

import json
from abc import abstractmethod
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Self

import msgspec
import numpy as np

from agent.mdp.config import ProcessConfig, refuse_without_effect
from agent.mdp.exact import (
    MAX_STARTS,
    Evaluation,
    cell_map,
    evaluate_on_grid,
    evaluate_on_grid_by,
    some_starts,
)
from agent.mdp.greedy import GreedyPolicy, greedy, on_grid
from agent.mdp.interpretations import Process, build_process
from agent.mdp.joint import BLOCKED, IMPOSSIBLE
from agent.mdp.optimum import require_paths
from agent.moves.group import MOST_CELLS, MOST_TIMES, Group, group_of, plan
from agent.moves.model import ObservedMoves
from agent.moves.pair import UNREACHABLE, PairTimes, pair_values, solve_pair
from agent.moves.times import Board, at_start, board_of, least_times, numbered
from agent.training.learning import VERSION
from agent.training.settings import LearningConfig
from cosim.base.errors import FileError, UserError
from cosim.base.provenance import digest_of
from cosim.base.reading import Kind, parsing, read_arrays
from cosim.model.params import TIMING
from cosim.model.scenario import Scenario
from cosim.onboard.features import AXIS_COUNT, DIRECTION_COUNT, Observation, facing_of
from cosim.recording.series import PolicyMap

SCHEMA_VERSION = 1
_FILE = Kind("policy file", "name a policy.npz that training has saved")
_CONFIG = Kind("policy's configuration", "train it again")
_KEPT = 4096  # plans that are kept: policies are asked again before anything has changed


class Seed(msgspec.Struct, frozen=True):
    """Seed of a run's generator, see `numpy.random.SeedSequence`."""

    entropy: int
    spawn_key: tuple[int, ...] = ()

    @classmethod
    def of(cls, seed: int | np.random.SeedSequence) -> "Seed":
        """From what `agent.training.learning.initial_state` takes."""
        if isinstance(seed, np.random.SeedSequence):
            return cls(int(seed.entropy), tuple(int(k) for k in seed.spawn_key))  # pyright: ignore
        return cls(int(seed))

    def sequence(self) -> np.random.SeedSequence:
        """The seed sequence."""
        return np.random.SeedSequence(self.entropy, spawn_key=self.spawn_key)


class PolicyConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Everything that decides the bits of a policy, kept in its file.

    With moves it was trained on these, without on the grid. Its kernel version names the version
    of what made it.
    """

    scenario: Scenario
    process: ProcessConfig
    learning: LearningConfig
    seed: Seed
    moves: ObservedMoves | None = None
    method: str = "paper"
    schema_version: int = SCHEMA_VERSION
    kernel_version: str = f"training {VERSION}"

    def __post_init__(self) -> None:
        where = "training on the grid" if self.moves is None else "training on moves"
        refuse_without_effect(self.process, where)
        if self.moves is None:
            return
        if self.moves.cell_m != self.scenario.cell_m:
            raise UserError(
                f"moves = those on cells of {self.moves.cell_m:g} m do not fit scenario "
                f"{self.scenario.name} with cells of {self.scenario.cell_m:g} m; observe some with "
                f"`minirobots moves --cell {self.scenario.cell_m:g}`"
            )
        if self.moves.rl_step_s == TIMING.rl_step_s and self.process.reward_per == "time":
            raise UserError(
                "process: reward_per = time has no effect on moves with an RL step of "
                f"{TIMING.rl_step_s:g} s, where both are the same; leave it at step"
            )

    @property
    def facings(self) -> int:
        """What robots distinguish of their headings, see `SteeringParams.facings`."""
        return AXIS_COUNT if self.moves is None else self.moves.facings

    def build(self) -> Process:
        """Return the decision process that this is a policy of."""
        return build_process(self.scenario, self.process, self.facings)


@dataclass(frozen=True, repr=False)
class Policy(GreedyPolicy):
    """Greedy policy over one table per robot.

    >>> import minirobots as mr
    >>> policy = mr.train("1a", method="shortest", progress=None)
    >>> policy.save("policy.npz")
    >>> mr.Policy.load("policy.npz").digest() == policy.digest()
    True
    """

    kind = "table"
    config: PolicyConfig
    q: np.ndarray  # (tables, N, states, 8) float32, Q tables, see `agent.training.methods.Method`
    visits: np.ndarray  # (N, states) uint32, decisions made in each state; 1 each if computed
    random: np.ndarray  # (1,) uint64, generator state after training
    episodes: int = 0  # trained

    @cached_property
    def values(self) -> np.ndarray:
        """(N, states, 8) float32, action values: the mean of the tables."""
        return self.q.mean(axis=0) if len(self.q) > 1 else self.q[0]

    def states(self, observation: Observation) -> np.ndarray:
        """(N,) int64, row of each robot's table for an observation."""
        return on_grid(self.process, self.checked(observation))[1]

    def q_values(self, observation: Observation) -> np.ndarray:
        """See `GreedyPolicy.q_values`."""
        return self.values[np.arange(len(self.values)), self.states(observation)]

    def evaluate_on_grid(self, starts: np.ndarray | None = None) -> Evaluation:
        """See `GreedyPolicy.evaluate`."""
        return evaluate_on_grid(self.process, self.values, starts)

    def digest(self) -> str:
        """Hash (16 hex digits) of the interpretations of the process and of all action values."""
        return digest_of(self.config.process, self.values)

    def maps(self) -> list[PolicyMap]:
        """Return maps of each robot's table over the cells of the board, for pictures."""
        tables = zip(self.values, self.visits, strict=True)
        return [cell_map(self.process, values, visits) for values, visits in tables]

    def fits(self) -> bool:
        """See `GreedyPolicy.fits`."""
        shape = (
            max(1, len(self.q)),
            self.config.scenario.robots,
            self.process.state_count,
            DIRECTION_COUNT,
        )
        return (
            (self.q.shape, self.q.dtype) == (shape, np.float32)
            and (self.visits.shape, self.visits.dtype) == (shape[1:3], np.uint32)
            and (self.random.shape, self.random.dtype) == ((1,), np.uint64)
            and bool(np.isfinite(self.q).all())
        )

    @classmethod
    def load(cls, path: Path | str) -> Self:
        """Read a policy of this class; see `load_policy`."""
        policy = load_policy(path)
        if not isinstance(policy, cls):
            raise FileError(f"{path}: not a policy with tables; read it with minirobots.load")
        return policy


def table_policy(config: PolicyConfig, values: np.ndarray, decided: np.ndarray) -> Policy:
    """Return a policy with computed tables: action values (N, states, 8).

    `decided`, (N, states) bool, is whether there is anything to decide and a path to the target.
    """
    tables = np.asarray(values, dtype=np.float32)[None]
    return Policy(config, tables, decided.astype(np.uint32), np.zeros(1, dtype=np.uint64))


class _OnTimes(GreedyPolicy):
    """Policy of robots that know the times of their moves."""

    most_starts = MAX_STARTS  # of evaluations on the grid, by default
    config: PolicyConfig

    @abstractmethod
    def values_at(self, numbers: np.ndarray) -> np.ndarray:
        """(N, 8) float32, action values by (3, N) int64, see `agent.moves.times.numbered`."""

    def q_values(self, observation: Observation) -> np.ndarray:
        scenario, seen = self.config.scenario, self.checked(observation)
        board = scenario.columns, scenario.rows, self.config.facings
        return self.values_at(numbered(seen, *board))

    def evaluate_on_grid(self, starts: np.ndarray | None = None) -> Evaluation:
        starts = some_starts(self.process, self.most_starts) if starts is None else starts

        def decide(cells: np.ndarray, axes: np.ndarray) -> np.ndarray:
            return greedy(self.values_at(np.stack([cells, cells, axes])), axes)

        return evaluate_on_grid_by(self.process, starts, decide)

    def alone_maps(self, board: Board, alone: np.ndarray) -> list[PolicyMap]:
        """Maps of each robot as if alone: minus its least time, the direction that leads to it."""
        scenario = self.config.scenario
        shape, facings = (scenario.columns, scenario.rows), self.config.facings
        axes = [facing_of(direction, facings) for direction in range(DIRECTION_COUNT)]
        seconds = np.broadcast_to(board.seconds.T, (len(board.at), *board.seconds.T.shape))
        found = []
        for own_after, own in zip(board.after, alone, strict=True):
            rest = np.where(own_after == BLOCKED, np.inf, own[own_after, axes])
            action = (at_start(self.process, seconds) + rest).argmin(axis=1)
            value = -at_start(self.process, own)
            reached = np.isfinite(value) & (value < 0.0)
            layers = np.where(reached, value, 0.0), action, reached.astype(float)
            found.append(PolicyMap(*(layer.reshape(shape) for layer in layers)))
        return found


@dataclass(frozen=True, repr=False)
class PairPolicy(_OnTimes):
    """Joint moves of least time of two robots that drive through cells, one move ahead."""

    kind = "pair"
    config: PolicyConfig
    delay: np.ndarray  # see `agent.moves.pair.PairTimes`
    episodes: int = 0

    @classmethod
    def computed(cls, config: PolicyConfig) -> "PairPolicy":
        """Compute the policy of a configuration; some seconds, and some 200 MB meanwhile."""
        assert config.moves is not None
        process = config.build()
        delay = solve_pair(process, config.moves).delay
        begun = at_start(process, np.moveaxis(at_start(process, delay), 0, 2)).T
        require_paths(process, np.where(begun == UNREACHABLE, np.inf, begun))
        return cls(config, delay)

    @cached_property
    def times(self) -> PairTimes:
        """Return what moves are chosen by."""
        assert self.config.moves is not None
        board = board_of(self.process, self.config.moves)
        return PairTimes(board, least_times(self.process, self.config.moves), self.delay)

    def values_at(self, numbers: np.ndarray) -> np.ndarray:
        """Return minus the time in s of both robots if the other does what is best."""
        values = np.empty((2, DIRECTION_COUNT), dtype=np.float32)
        cells, goals, axes = numbers
        pair_values(self.times, cells, goals, axes, values)
        return values

    def digest(self) -> str:
        """Hash (16 hex digits) of the interpretations of the process and of all times."""
        return digest_of(self.config.process, *self.times.board, *self.times[1:])

    def maps(self) -> list[PolicyMap]:
        """See `GreedyPolicy.maps`."""
        return self.alone_maps(self.times.board, self.times.alone)

    def fits(self) -> bool:
        """See `GreedyPolicy.fits`."""
        cells = self.config.scenario.columns * self.config.scenario.rows
        shape = (cells, self.config.facings) * 2
        return (self.delay.shape, self.delay.dtype) == (shape, np.uint16)


def can_plan(scenario: Scenario) -> bool:
    """Return whether the robots and cells of a board are few enough to plan for."""
    robots, cells = scenario.robots, scenario.columns * scenario.rows
    return cells <= MOST_CELLS and robots * 2**robots * cells <= MOST_TIMES


def require_plannable(scenario: Scenario) -> None:
    """Refuse a board with too many robots or cells to plan for."""
    if not can_plan(scenario):
        robots, cells = scenario.robots, scenario.columns * scenario.rows
        raise UserError(
            f"scenario {scenario.name} has {robots} robots on {cells} cells, which is too much "
            f"to plan for: at most {MOST_CELLS} cells, and with 8 robots {MOST_TIMES // 2048}; "
            "choose a method that learns, such as moves"
        )


@dataclass(frozen=True, repr=False)
class GroupPolicy(_OnTimes):
    """Moves of the robots' plans (`agent.moves.group`), which are made while they drive."""

    kind = "group"
    most_starts = 50  # assumed: some 0.3 s each
    config: PolicyConfig
    episodes: int = 0

    @classmethod
    def computed(cls, config: PolicyConfig) -> "GroupPolicy":
        """Return the policy of a configuration."""
        require_plannable(config.scenario)
        policy = cls(config)
        require_paths(policy.process, policy.group.around[:, 0].min(axis=2), alone=True)
        return policy

    @cached_property
    def group(self) -> Group:
        """Return what plans are made by."""
        assert self.config.moves is not None
        return group_of(self.process, self.config.moves)

    @cached_property
    def _plans(self) -> dict[bytes, np.ndarray]:
        return {}

    def values_at(self, numbers: np.ndarray) -> np.ndarray:
        """Return minus the time in s that the plan of a robot takes, at its first move.

        Other moves, and all moves of robots that do not wait, have no value.
        """
        asked = numbers.tobytes()
        values = self._plans.get(asked)  # another thread may clear the plans at any time
        if values is None:
            cells, goals, axes = numbers
            actions, ends = np.empty_like(cells), np.empty(len(cells))
            plan(self.group, cells, goals, axes, actions, ends)
            values = np.full((len(actions), DIRECTION_COUNT), IMPOSSIBLE, dtype=np.float32)
            waits = np.flatnonzero(actions >= 0)
            values[waits, actions[waits]] = -ends[waits].clip(0.0, -0.4 * IMPOSSIBLE)
            if len(self._plans) >= _KEPT:
                self._plans.clear()
            self._plans[asked] = values
        return values.copy()

    def digest(self) -> str:
        """Return the hash (16 hex digits) of the interpretations, the version and the times."""
        return digest_of(
            self.config.process, self.config.kernel_version, *self.group.board, *self.group[1:]
        )

    def maps(self) -> list[PolicyMap]:
        """See `GreedyPolicy.maps`."""
        return self.alone_maps(self.group.board, self.group.around[:, 0].astype(float))


_KINDS = {kind.kind: kind for kind in (Policy, PairPolicy, GroupPolicy)}


def load_policy(path: Path | str, scenario: Scenario | None = None) -> Any:
    """Return the policy of a file, of any kind; with `scenario`, only if it has that geometry."""
    path = Path(path)
    text = read_arrays(path, _FILE, ("config",))["config"].tobytes()
    with parsing(path, _CONFIG):
        facts = dict(json.loads(text))
    if facts.get("schema_version") != SCHEMA_VERSION:
        raise FileError(
            f"{path}: policy schema {facts.get('schema_version')} is not the schema "
            f"{SCHEMA_VERSION} of this version; train it again with `minirobots train`"
        )
    digest = facts.pop("scenario_digest", None)
    with parsing(path, _CONFIG):
        episodes = msgspec.convert(facts.pop("episodes", 0), int)
        kind = _KINDS[facts.pop("kind")]
        config = msgspec.convert(facts, PolicyConfig)
    arrays = read_arrays(path, _FILE, kind.array_names())
    with parsing(path, _CONFIG):
        make: Any = kind
        policy = make(config, **arrays, episodes=episodes)
    if digest != config.scenario.digest():
        raise FileError(f"{path}: scenario and configuration do not fit; train it again")
    if scenario is not None:
        policy.require_scenario(scenario, f"{path}: the policy")
    return policy

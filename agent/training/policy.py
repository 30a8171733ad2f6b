"""A trained policy: what to do at an observation, and its file.

The file is one `.npz` (Q tables, visit counts, generator state, and its configuration as JSON)
with the same JSON next to it for people; nothing in it is executed on loading. Training is in
`agent.training.qlearning`, the cache of trained policies in `agent.training.store`.
"""

import json
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import msgspec
import numpy as np

from agent.mdp.config import Computed, ProcessConfig, refuse_without_effect
from agent.mdp.exact import Evaluation, cell_map, evaluate
from agent.mdp.greedy import GreedyPolicy, on_grid
from agent.mdp.optimum import computed_tables
from agent.mdp.readings import build_process
from agent.moves.bound import fastest_tables
from agent.moves.model import ObservedMoves
from agent.training.learning import VERSION, TrainingState
from agent.training.settings import LearningConfig
from cosim.base.errors import FileError, UserError
from cosim.base.provenance import digest_of
from cosim.base.reading import Kind, parsing, read_arrays
from cosim.model.params import TIMING
from cosim.model.scenario import Scenario
from cosim.onboard.features import DIRECTION_COUNT, Observation
from cosim.recording.series import PolicyMap

SCHEMA_VERSION = 1


FILE = Kind("policy file", "name a policy.npz that training has saved")
_CONFIG = Kind("policy's configuration", "train it again")


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

    With moves it was trained on these, without on the grid, with an objective computed. Its kernel
    version names the version of what made it.

    Raises:
        UserError: an interpretation of the process has no effect on what it is trained on, or
            the moves were observed on cells of another size.
        UserError: there is an objective, and something is said of learning, or moves are given
            where they do not matter or missing where they do.
    """

    scenario: Scenario
    process: ProcessConfig
    learning: LearningConfig
    seed: Seed
    moves: ObservedMoves | None = None
    objective: Computed | None = None
    schema_version: int = SCHEMA_VERSION
    kernel_version: str = f"training {VERSION}"

    def __post_init__(self) -> None:
        where = "training on the grid" if self.moves is None else "training on moves"
        refuse_without_effect(self.process, where)
        if self.moves is not None and self.moves.cell_m != self.scenario.cell_m:
            raise UserError(
                f"moves = those on cells of {self.moves.cell_m:g} m do not fit scenario "
                f"{self.scenario.name} with cells of {self.scenario.cell_m:g} m; observe some with "
                f"`minirobots moves --cell {self.scenario.cell_m:g}`"
            )
        asked_as_ever = self.moves is not None and self.moves.rl_step_s == TIMING.rl_step_s
        if asked_as_ever and self.process.reward_per == "time":
            raise UserError(
                "process: reward_per = time has no effect on moves with an RL step of "
                f"{TIMING.rl_step_s:g} s, where both are the same; leave it at step"
            )
        if self.objective is None:
            return
        if self.learning != LearningConfig():
            raise UserError(f"learning has no effect on {self.objective} paths; leave it out")
        if (self.objective in {"fastest", "planned"}) != (self.moves is not None):
            raise UserError(
                "only fastest and planned paths use observed moves; "
                f"{'leave them out' if self.moves else 'give some'}"
            )


@dataclass(frozen=True, repr=False)
class Policy(GreedyPolicy):
    """Greedy policy over one table per robot.

    >>> import minirobots as mr
    >>> policy = mr.train("1a", method="shortest", progress=None)
    >>> policy.save("policy.npz")
    >>> mr.Policy.load("policy.npz").digest() == policy.digest()
    True

    Attributes:
        config: what it was trained with.
        q: (tables, N, states, 8) float32, Q tables; two for double Q-learning.
        visits: (N, states) uint32, decisions made in each state; 1 each if computed.
        random: (1,) uint64, generator state after training.
        episodes: episodes trained.
    """

    config: PolicyConfig
    q: np.ndarray
    visits: np.ndarray
    random: np.ndarray
    episodes: int

    def __repr__(self) -> str:
        on = "on moves" if self.config.moves else "on the grid"
        made = self.config.objective or f"{self.episodes} episodes"
        return f"Policy(scenario {self.config.scenario.name}, {made} {on})"

    @classmethod
    def of_training(cls, config: PolicyConfig, state: TrainingState) -> "Policy":
        """Snapshot of a training run."""
        arrays = (state.q.copy(), state.visits.copy(), state.random.copy())
        return cls(config, *arrays, episodes=state.episode)

    @classmethod
    def computed(cls, config: PolicyConfig) -> "Policy":
        """Compute the policy of a configuration with an objective.

        Raises:
            UserError: the scenario is too large to compute optimal paths.
        """
        assert config.objective is not None
        process = build_process(config.scenario, config.process)
        if config.moves is None:
            tables, decided = computed_tables(process, config.objective)
        else:
            tables, decided = fastest_tables(process, config.moves)
        unused = np.zeros(1, dtype=np.uint64)
        return cls(config, tables[None], decided.astype(np.uint32), unused, episodes=0)

    @cached_property
    def values(self) -> np.ndarray:
        """(N, states, 8) float32, action values; the mean of the two tables of double Q."""
        return self.q.mean(axis=0) if len(self.q) > 1 else self.q[0]

    def states(self, observation: Observation) -> np.ndarray:
        """(N,) int64, row of each robot's table for an observation.

        Raises:
            ValueError: a cell is off the board, or the number of robots differs.
        """
        seen = self.seen(observation)
        _, states = on_grid(self.process, seen)
        if states[0] < 0:
            raise ValueError(f"cells {seen.cells.tolist()} are off the board")
        return states

    def q_values(self, observation: Observation) -> np.ndarray:
        """(N, 8) float32, action values of each robot."""
        return self.values[np.arange(len(self.values)), self.states(observation)]

    def evaluate(self, starts: np.ndarray | None = None) -> Evaluation:
        """Greedy episodes on the grid, see `agent.mdp.exact.evaluate`."""
        return evaluate(self.process, self.values, starts)

    def digest(self) -> str:
        """Hash (16 hex digits) of the readings of the process and of all action values."""
        return digest_of(self.config.process, self.values)

    def maps(self) -> list[PolicyMap]:
        """Return maps of each robot's table over the cells of the board, for pictures."""
        tables = zip(self.values, self.visits, strict=True)
        return [cell_map(self.process, values, visits) for values, visits in tables]

    def arrays(self) -> dict[str, np.ndarray]:
        """Tables, visits and generator state."""
        return {"q": self.q, "visits": self.visits, "random": self.random}

    @classmethod
    def load(cls, path: Path | str) -> "Policy":
        """Read a policy.

        Raises:
            FileError: no such file, not a policy, or another schema.
        """
        config, episodes, arrays = read_policy(path, ("q", "visits", "random"))
        with parsing(Path(path), _CONFIG):
            policy = cls(config, **arrays, episodes=episodes)
            consistent = policy._consistent()
        if not consistent:
            raise FileError(f"{path}: tables and configuration do not fit; train it again")
        return policy

    def _consistent(self) -> bool:
        tables = 2 if self.config.learning.algorithm == "double_q" else 1
        shape = (tables, self.config.scenario.robots, self.process.state_count, DIRECTION_COUNT)
        return (
            (self.q.shape, self.q.dtype) == (shape, np.float32)
            and (self.visits.shape, self.visits.dtype) == (shape[1:3], np.uint32)
            and (self.random.shape, self.random.dtype) == ((1,), np.uint64)
            and bool(np.isfinite(self.q).all())
        )


def read_policy(
    path: Path | str, names: tuple[str, ...]
) -> tuple[PolicyConfig, int, dict[str, np.ndarray]]:
    """Return configuration, trained episodes and the arrays of these names of a policy file.

    Raises:
        FileError: no such file, not a policy, another schema, or damaged.
    """
    path = Path(path)
    arrays = read_arrays(path, FILE, (*names, "config"))
    with parsing(path, _CONFIG):
        description = dict(json.loads(arrays.pop("config").tobytes()))
    if description.get("schema_version") != SCHEMA_VERSION:
        raise FileError(
            f"{path}: policy schema {description.get('schema_version')} is not the schema "
            f"{SCHEMA_VERSION} of this version; train it again with `minirobots train`"
        )
    digest, episodes = description.pop("scenario_digest", None), description.pop("episodes", 0)
    with parsing(path, _CONFIG):
        config = msgspec.convert(description, PolicyConfig)
        trained = msgspec.convert(episodes, int)
    if digest != config.scenario.digest():
        raise FileError(f"{path}: scenario and configuration do not fit; train it again")
    return config, trained, arrays

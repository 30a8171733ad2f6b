"""Settings of training: method, numbers of learning, and the files that people write them in.

Settings files have TOML tables `[process]` and `[learning]`, checked field by field. Nothing here
is slow to import, so that command lines can have these options.
"""

import math
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Literal, NamedTuple, TypeVar, get_args

import msgspec

from agent.mdp.config import Computed, ProcessConfig, require
from cosim.base.errors import UserError
from cosim.base.reading import Kind, read_toml

# See `agent.method`.
Method = Literal["paper", "moves", Computed]
METHODS: tuple[Method, ...] = get_args(Method)
COMPUTED: tuple[Computed, ...] = get_args(Computed)


class MethodFacts(NamedTuple):
    """Facts by which a user chooses a method.

    Attributes:
        robots: number of robots that it can drive.
        how: it makes a policy.
        needs: options of the co-simulation that it is made for.
        use: when to choose it.
    """

    robots: str
    how: str
    needs: str
    use: str


_OPTIMUM = "Dijkstra's algorithm over the joint grid"
FACTS: dict[Method, MethodFacts] = {
    "paper": MethodFacts(
        "any",
        "Q-learning on the grid (Section V of the paper)",
        "",
        "default for one robot and for two",
    ),
    "moves": MethodFacts(
        "any",
        "Q-learning on moves observed in the co-simulation",
        "",
        "default with obstacles, on large boards and for swarms",
    ),
    "shortest": MethodFacts("1, 2", f"computed: {_OPTIMUM}, by path", "", "bound of the path"),
    "fastest": MethodFacts(
        "1, 2", "computed: value iteration on observed moves", "--through (2 robots)", "least time"
    ),
    "planned": MethodFacts(
        "1 to 8", "computed while driving: paths in space and time", "", "default for 3 to 8 robots"
    ),
}
COMPARED: tuple[Method, ...] = ("moves", "paper")  # in the studies of transfer and robustness

Algorithm = Literal["q", "double_q"]


MAX_EPISODES, MAX_POINTS = 10**9, 10**7


@dataclass(frozen=True)
class LearningConfig:
    """Numbers of Section V and what the paper leaves open about learning."""

    episodes: int = 5_000_000
    """Training episodes (Section V)."""
    eta: float = 0.01
    """Learning rate of Eq. (7) (Section V; Section III says 0.001)."""
    eta_end: float | None = None
    """Learning rate at the end, to which eta falls linearly over the episodes (assumed: as at the
    start)."""
    gamma: float = 0.99
    """Discount rate (Section V)."""
    epsilon: float = 0.9
    """Probability of a random action at the start (Section V)."""
    epsilon_decay: float = 0.999
    """Factor on epsilon every `epsilon_episodes` episodes (Section V)."""
    epsilon_episodes: int = 500
    """Episodes between two reductions of epsilon (Section V)."""
    exploration: float = 0.6
    """Share of the episodes with exploration; epsilon is 0 afterwards (Section V)."""
    schedule: Literal["geometric", "linear"] = "geometric"
    """Reduction by the factor (assumed), or linear to 0 at the end of exploration."""
    algorithm: Algorithm = "q"
    """Q-learning of Eq. (7), or double Q-learning (two tables per robot)."""
    log_episodes: int = 1000
    """Episodes between two points of the learning curves."""
    log_window: int = 100
    """Last episodes that a point of the learning curves is the mean of (Section V.B: 100)."""
    greedy_points: int = 50
    """Exact evaluations of the greedy policy during training, evenly spread; 0 for none."""

    def __post_init__(self) -> None:
        valid = {
            "episodes": 1 <= self.episodes <= MAX_EPISODES,
            "eta": 0 < self.eta <= 1,
            "eta_end": self.eta_end is None or 0 < self.eta_end <= 1,
            "gamma": 0 <= self.gamma <= 1,
            "epsilon": 0 <= self.epsilon <= 1,
            "epsilon_decay": 0 <= self.epsilon_decay <= 1,
            "epsilon_episodes": 1 <= self.epsilon_episodes <= MAX_EPISODES,
            "exploration": 0 <= self.exploration <= 1,
            "log_episodes": 1 <= self.log_episodes <= MAX_EPISODES,
            "log_window": 1 <= self.log_window <= self.log_episodes,
            "greedy_points": 0 <= self.greedy_points <= MAX_POINTS,
        }
        require("learning", self, valid, UserError)
        usual = LearningConfig.epsilon_decay
        if self.schedule == "linear" and self.epsilon_decay != usual:
            raise UserError(
                f"learning: epsilon_decay = {self.epsilon_decay} has no effect with schedule = "
                f"linear; leave it at {usual}"
            )
        if self.block < self.episodes / MAX_POINTS:
            raise UserError(
                f"learning: epsilon_episodes = {self.epsilon_episodes} makes more than "
                f"{MAX_POINTS} blocks of equal epsilon; give a divisor of the episodes with them"
            )
        if self.log_episodes < self.episodes / MAX_POINTS:
            raise UserError(
                f"learning: log_episodes = {self.log_episodes} makes more than {MAX_POINTS} points "
                "of the learning curves; make it larger"
            )

    @property
    def block(self) -> int:
        """Episodes of constant epsilon, never across the end of exploration.

        The greatest common divisor of the schedule's period and that end.
        """
        explored = math.ceil(self.exploration * self.episodes)
        return math.gcd(self.epsilon_episodes, explored) if explored else self.epsilon_episodes


_Config = TypeVar("_Config", ProcessConfig, LearningConfig)


_FILE = Kind("settings file", "check the path")


def read_settings(path: Path) -> tuple[ProcessConfig, LearningConfig]:
    """Decision process and learning configuration of a TOML file; what it leaves out is default.

    Raises:
        UserError: the file is missing, no TOML, or a field is unknown or wrong.
    """
    content = read_toml(path, _FILE)
    unknown = set(content) - {"process", "learning"}
    if unknown:
        raise UserError(f"{path}: unknown table '{min(unknown)}'; use [process] and [learning]")
    process = _convert(path, "process", content.get("process", {}), ProcessConfig)
    return process, _convert(path, "learning", content.get("learning", {}), LearningConfig)


def _convert(path: Path, table: str, content: Any, config: type[_Config]) -> _Config:
    if not isinstance(content, dict):
        raise UserError(f"{path}: {table} is not a table; write [{table}]")
    known = {field.name for field in fields(config)}
    for name in content:
        if name not in known:
            raise UserError(
                f"{path}: unknown field {table}.{name}; choose one of {', '.join(sorted(known))}"
            )
    try:
        return msgspec.convert(content, config)
    except msgspec.ValidationError as error:
        problem, _, where = str(error).partition(" - at ")
        field = where.strip("`").replace("$", table)
        raise UserError(f"{path}: {field or table}: {problem.replace('`', '')}") from error
    except UserError as error:
        raise UserError(f"{path}: {error}") from error

"""Numbers of learning, and the files that people write settings in.

Settings files have TOML tables `[process]` and `[learning]`, checked field by field. Nothing here
is slow to import, so that command lines can have these options.
"""

import math
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec

from agent.mdp.config import Count, ProcessConfig, Share
from cosim.base.arguments import require_names, validate_argument, validate_fields
from cosim.base.errors import UserError
from cosim.base.reading import Kind, naming, read_toml

# Those of `agent.training.methods.METHODS` that are not a user's.
MethodName = Literal["paper", "double_q", "moves", "shortest", "fastest", "planned"]
MAX_POINTS = 10**7
_Rate = Annotated[float, msgspec.Meta(gt=0, le=1)]


@dataclass(frozen=True)
class LearningConfig:
    """Numbers of Section V and what the paper leaves open about learning."""

    episodes: Count = 5_000_000
    """Training episodes (Section V)."""
    eta: _Rate = 0.01
    """Learning rate of Eq. (7) (Section V; Section III says 0.001)."""
    eta_end: _Rate | None = None
    """Learning rate at the end, to which eta falls linearly over the episodes (assumed: as at the
    start)."""
    gamma: Share = 0.99
    """Discount rate (Section V)."""
    epsilon: Share = 0.9
    """Probability of a random action at the start (Section V)."""
    epsilon_decay: Share = 0.999
    """Factor on epsilon every `epsilon_episodes` episodes (Section V)."""
    epsilon_episodes: Count = 500
    """Episodes between two reductions of epsilon (Section V)."""
    exploration: Share = 0.6
    """Share of the episodes with exploration; epsilon is 0 afterwards (Section V)."""
    schedule: Literal["geometric", "linear"] = "geometric"
    """Reduction by the factor (assumed), or linear to 0 at the end of exploration."""
    log_episodes: Count = 1000
    """Episodes between two points of the learning curves."""
    log_window: Count = 100
    """Last episodes that a point of the learning curves is the mean of (Section V.B: 100)."""
    greedy_points: Annotated[int, msgspec.Meta(ge=0, le=MAX_POINTS)] = 50
    """Exact evaluations of the greedy policy during training, evenly spread; 0 for none."""

    def __post_init__(self) -> None:
        validate_fields(self, "learning: ")
        usual = LearningConfig.epsilon_decay
        if self.log_window > self.log_episodes:
            raise UserError(
                f"learning: log_window = {self.log_window} must not exceed log_episodes = "
                f"{self.log_episodes}"
            )
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


_FILE = Kind("settings file", "check the path")


def read_settings(path: Path) -> tuple[ProcessConfig, LearningConfig]:
    """Decision process and learning configuration of a TOML file; what it leaves out is default."""
    tables, found = {"process": ProcessConfig, "learning": LearningConfig}, list[Any]()
    content = read_toml(path, _FILE)
    with naming(path):
        require_names("table ", content, tables)
        for name, kind in tables.items():
            table = validate_argument(name, content.get(name, {}), dict)
            require_names(f"{name}.", table, [field.name for field in fields(kind)])
            found.append(kind(**table))
    return found[0], found[1]

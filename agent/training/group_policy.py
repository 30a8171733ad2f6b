"""The policy of a group of robots that plan in space and time, again at every decision."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from agent.mdp.exact import Evaluation, some_starts
from agent.mdp.greedy import GreedyPolicy
from agent.mdp.joint import IMPOSSIBLE
from agent.mdp.optimum import require_paths
from agent.moves.group import MOST_CELLS, MOST_TIMES, Group, evaluate_group, group_of, plan
from agent.training.pair_policy import alone_maps, numbered
from agent.training.policy import PolicyConfig, read_policy
from cosim.base.errors import UserError
from cosim.base.provenance import digest_of
from cosim.model.scenario import Scenario
from cosim.onboard.features import AXIS_COUNT, DIRECTION_COUNT, Observation
from cosim.recording.series import PolicyMap

_GRID_STARTS = 50  # assumed: of evaluations on the grid, some 0.3 s each
_KNOWN = 4096  # plans that are kept: policies are asked again before anything has changed


def can_plan(scenario: Scenario) -> bool:
    """Return whether the robots and cells of a board are few enough to plan for."""
    robots, cells = scenario.robots, scenario.columns * scenario.rows
    return cells <= MOST_CELLS and robots * 2**robots * cells <= MOST_TIMES


@dataclass(frozen=True, repr=False)
class GroupPolicy(GreedyPolicy):
    """Moves of the robots' plans (`agent.moves.group`), which are made while they drive.

    Attributes:
        config: with moves of robots that drive through cells.
        episodes: of training; none.
    """

    config: PolicyConfig
    episodes: int = 0

    def __repr__(self) -> str:
        return f"GroupPolicy(scenario {self.config.scenario.name}, planned on moves)"

    @classmethod
    def computed(cls, config: PolicyConfig) -> "GroupPolicy":
        """Return the policy of a configuration.

        Raises:
            UserError: not every kind of move was observed.
            UserError: there are too many robots, or a start without a path to its target.
        """
        scenario = config.scenario
        if not can_plan(scenario):
            robots, cells = scenario.robots, scenario.columns * scenario.rows
            raise UserError(
                f"scenario {scenario.name} has {robots} robots on {cells} cells, which is too much "
                f"to plan for: at most {MOST_CELLS} cells, and with 8 robots {MOST_TIMES // 2048}; "
                "choose a method that learns, such as moves"
            )
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

    def q_values(self, observation: Observation) -> np.ndarray:
        """(N, 8) float32, minus the time in s that the plan of a robot takes, at its first move.

        Other moves, and all moves of robots that do not wait, have no value.

        Raises:
            ValueError: a cell is off the board, or the number of robots differs.
        """
        seen, cells, goals = numbered(self, observation)
        axes = seen.direction % AXIS_COUNT
        asked = np.stack([cells, goals, axes]).tobytes()
        values = self._plans.get(asked)  # another thread may clear the plans at any time
        if values is None:
            actions, ends = np.empty(len(cells), dtype=np.int64), np.empty(len(cells))
            plan(self.group, cells, goals, axes, actions, ends)
            values = np.full((len(cells), DIRECTION_COUNT), IMPOSSIBLE, dtype=np.float32)
            waits = np.flatnonzero(actions >= 0)
            values[waits, actions[waits]] = -ends[waits].clip(0.0, -0.4 * IMPOSSIBLE)
            if len(self._plans) >= _KNOWN:
                self._plans.clear()
            self._plans[asked] = values
        return values.copy()

    def evaluate(self, starts: np.ndarray | None = None) -> Evaluation:
        """Episodes on the grid, see `agent.mdp.exact.evaluate`; by default from some starts."""
        starts = some_starts(self.process, _GRID_STARTS) if starts is None else starts
        return evaluate_group(self.process, self.group, starts)

    def digest(self) -> str:
        """Hash (16 hex digits) of the readings, of the version, and of what plans are made by."""
        return digest_of(self.config.process, self.config.kernel_version, *self.group)

    def maps(self) -> list[PolicyMap]:
        """Minus the least time of each robot as if alone, and the direction that leads to it."""
        group, alone = self.group, self.group.around[:, 0].astype(float)
        return alone_maps(group.after, group.seconds, alone, self.config.scenario)

    def arrays(self) -> dict[str, np.ndarray]:
        """Nothing: plans follow from the configuration."""
        return {}

    @classmethod
    def load(cls, path: Path | str) -> "GroupPolicy":
        """Read a policy.

        Raises:
            FileError: no such file, not such a policy, or another schema.
        """
        return cls(read_policy(path, ())[0])

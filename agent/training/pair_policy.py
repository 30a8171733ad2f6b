"""The policy of two robots that look one joint move ahead, by times that are computed."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from agent.mdp.exact import Evaluation, joint_starts
from agent.mdp.greedy import GreedyPolicy
from agent.mdp.grid import STARTING_AXIS
from agent.mdp.joint import BLOCKED
from agent.mdp.optimum import require_paths
from agent.mdp.readings import build_process
from agent.moves.pair import (
    UNREACHABLE,
    PairTimes,
    evaluate_pair,
    moves_of_pair,
    pair_values,
    solve_pair,
)
from agent.training.policy import PolicyConfig, read_policy
from cosim.base.errors import FileError
from cosim.base.provenance import digest_of
from cosim.model.scenario import Scenario
from cosim.onboard.features import AXIS_COUNT, DIRECTION_COUNT, Observation
from cosim.recording.series import PolicyMap


def alone_maps(
    after: np.ndarray, seconds: np.ndarray, alone: np.ndarray, scenario: Scenario
) -> list[PolicyMap]:
    """Maps of each robot as if alone: minus its least time, and the direction that leads to it.

    Args:
        after, seconds, alone: see `agent.moves.pair.PairTimes`, of any number of robots.
        scenario: board.
    """
    shape, axes = (scenario.columns, scenario.rows), np.arange(DIRECTION_COUNT) % AXIS_COUNT
    found = []
    for own_after, own in zip(after, alone, strict=True):
        rest = np.where(own_after == BLOCKED, np.inf, own[own_after, axes])
        action = (seconds[:, STARTING_AXIS] + rest).argmin(axis=1)
        value = -own[:, STARTING_AXIS]
        known = np.isfinite(value) & (value < 0.0)
        layers = np.where(known, value, 0.0), action, known.astype(float)
        found.append(PolicyMap(*(layer.reshape(shape) for layer in layers)))
    return found


def numbered(
    policy: GreedyPolicy, observation: Observation
) -> tuple[Observation, np.ndarray, np.ndarray]:
    """Return an observation, and the numbers of its cells and goals, (N,) int64 each.

    Raises:
        ValueError: a cell is off the board, or the number of robots differs.
    """
    seen, scenario = policy.seen(observation), policy.config.scenario
    size = np.array((scenario.columns, scenario.rows))
    if ((seen.cells < 0) | (seen.cells >= size)).any():
        raise ValueError(f"cells {seen.cells.tolist()} are off the board")
    cells = seen.cells @ (scenario.rows, 1)
    goals = seen.goals.clip(0, size - 1) @ (scenario.rows, 1) if len(seen.goals) else cells
    return seen, cells, goals


@dataclass(frozen=True, repr=False)
class PairPolicy(GreedyPolicy):
    """Joint moves of least time, looked for one move ahead.

    Attributes:
        config: with moves of robots that drive through cells.
        delay: see `agent.moves.pair.PairTimes`.
        episodes: of training; none.
    """

    config: PolicyConfig
    delay: np.ndarray
    episodes: int = 0

    def __repr__(self) -> str:
        return f"PairPolicy(scenario {self.config.scenario.name}, {self.config.objective} on moves)"

    @classmethod
    def computed(cls, config: PolicyConfig) -> "PairPolicy":
        """Compute the policy of a configuration; some seconds, and some 200 MB meanwhile.

        Raises:
            UserError: not every kind of move was observed.
            UserError: there is a start without a path to the targets.
        """
        assert config.moves is not None
        process = build_process(config.scenario, config.process)
        delay = solve_pair(process, config.moves).delay
        begun = delay[:, STARTING_AXIS, :, STARTING_AXIS]
        require_paths(process, np.where(begun == UNREACHABLE, np.inf, begun))
        return cls(config, delay)

    @cached_property
    def times(self) -> PairTimes:
        """Return what moves are chosen by."""
        assert self.config.moves is not None
        return moves_of_pair(self.process, self.config.moves)._replace(delay=self.delay)

    def q_values(self, observation: Observation) -> np.ndarray:
        """(2, 8) float32, minus the time in s of both robots if the other does what is best.

        Raises:
            ValueError: a cell is off the board, or there are not two robots.
        """
        seen, cells, goals = numbered(self, observation)
        values = np.empty((2, DIRECTION_COUNT), dtype=np.float32)
        pair_values(self.times, cells, goals, seen.direction % AXIS_COUNT, values)
        return values

    def evaluate(self, starts: np.ndarray | None = None) -> Evaluation:
        """Episodes on the grid, see `agent.mdp.exact.evaluate`."""
        starts = joint_starts(self.process) if starts is None else starts
        return evaluate_pair(self.process, self.times, starts)

    def digest(self) -> str:
        """Hash (16 hex digits) of the readings of the process and of all times."""
        return digest_of(self.config.process, *self.times)

    def maps(self) -> list[PolicyMap]:
        """Minus the least time of each robot as if alone, and the direction that leads to it."""
        times = self.times
        return alone_maps(times.after, times.seconds, times.alone, self.config.scenario)

    def arrays(self) -> dict[str, np.ndarray]:
        """The delay of every joint state."""
        return {"delay": self.delay}

    @classmethod
    def load(cls, path: Path | str) -> "PairPolicy":
        """Read a policy.

        Raises:
            FileError: no such file, not such a policy, or another schema.
        """
        config, _, arrays = read_policy(path, ("delay",))
        cells, delay = config.scenario.columns * config.scenario.rows, arrays["delay"]
        if (delay.shape, delay.dtype) != ((cells, AXIS_COUNT) * 2, np.uint16):
            raise FileError(f"{path}: times and configuration do not fit; compute it again")
        return cls(config, delay)

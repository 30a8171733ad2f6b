"""One RL step of the co-simulation: the policy's input and the result."""

from collections.abc import Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np

from cosim.base.arguments import numbers
from cosim.base.errors import UserError, shorten
from cosim.coupling.signals import RawSamples, Samples
from cosim.model.outcome import Outcome
from cosim.onboard.features import DIRECTION_COUNT, Observation

SAMPLED = 64  # robots with all signals kept: of an RL step of 2 s they take 58 MB
SOME = 4  # of more robots, the number that keep signals if none are named
POSES_S = 0.1  # between the poses of more robots


def sampled_of(robots: int, named: Sequence[int] = ()) -> tuple[int, ...]:
    """Return rising indices of robots with kept signals: `named` from 1, or by default some."""
    if not named:
        return tuple(range(robots if robots <= SAMPLED else SOME))
    if len(set(named)) < len(named) or not 1 <= min(named) <= max(named) <= robots:
        raise UserError(f"signals = {shorten(named)} must name different robots from 1 to {robots}")
    return tuple(sorted(number - 1 for number in named))


class Decision(NamedTuple):
    """Decision of a policy, with the values of the alternatives."""

    action: np.ndarray  # (N,) direction index of each robot
    values: np.ndarray | None = None  # (N, 8) that the action was chosen by, if there are any
    unit: str = "1"  # of the values; sums of rewards have none

    def of(self, robots: Sequence[int]) -> "Decision":
        """The decision on some of the robots."""
        chosen, values = np.array(robots, dtype=int), self.values
        values = None if values is None else values[chosen]
        return self._replace(action=np.asarray(self.action)[chosen], values=values)


class SupportsAct(Protocol):
    """Interface that the co-simulation needs of an agent."""

    def act(self, observation: Observation) -> np.ndarray | Decision:
        """Return the direction index of each robot, shape (N,), or a decision."""
        ...


def decide(policy: SupportsAct, observation: Observation) -> Decision:
    """Return what a policy decides.

    Arrays that it receives and those that it returns are copied: neither what it changes in an
    observation nor a buffer that it uses again changes an episode.
    """
    decided = policy.act(Observation(*(array.copy() for array in observation)))
    parts: Any = decided if isinstance(decided, Decision) else Decision(decided)
    if parts.values is not None:
        values, shape = parts.values, (len(observation.cells), DIRECTION_COUNT)
        if numbers(values, shape, finite=False) is None:  # NaN: a direction that fails
            raise UserError(
                f"the policy returned values = {shorten(values)}; expected {shape[0]} x {shape[1]} "
                "numbers, the value of every direction for each robot"
            )
        parts = parts._replace(values=np.asarray(values))
    if not isinstance(parts.unit, str):
        raise UserError(f"the policy returned unit = {shorten(parts.unit)}; expected a text")
    copied: Any = [p.copy() if isinstance(p, np.ndarray | list) else p for p in parts]
    return Decision(*copied)


class Step(NamedTuple):
    """One RL step of the co-simulation."""

    number: int  # of the step, from 0
    first_tick: int  # ticks of dt before the step
    # before, after: observations at its start and end
    before: Observation
    after: Observation
    # (N,) direction index in force during the step, −1 for a robot that arrived before or that the
    # shield lets wait
    action: np.ndarray
    decided: np.ndarray  # (N,) whether the action was adopted at the start of this step
    completed: np.ndarray  # (N,) whether the robot ended its move within this step
    samples: Samples  # of the robots in `sampled` at every control period that was simulated
    raw: RawSamples  # signals of these at every tick of the burst at the start of the step
    events: np.ndarray  # (N,) RUNNING, COLLISION or OUT_OF_BOARD of `cosim.model.outcome`
    outcome: Outcome  # of the episode, RUNNING until it ends
    duration_s: float  # simulated time
    moved_m: np.ndarray  # (N,) distance of each robot's centre from where it was at first
    # rising indices of the robots with signals: of all where they are few
    sampled: tuple[int, ...]
    # (p, N, 7) position and quaternion of all robots, `POSES_S` apart, where signals are kept of
    # some of them only; else none
    poses: np.ndarray

    def of_sampled(self) -> "Step":
        """Return the step of the sampled robots alone; `poses` stay those of all robots."""
        chosen = np.array(self.sampled, dtype=int)

        def chosen_of(observation: Observation) -> Observation:
            return Observation(*(part[chosen] if len(part) else part for part in observation))

        per_robot = ("action", "decided", "completed", "events", "moved_m")
        parts = {name: getattr(self, name)[chosen] for name in per_robot}
        return self._replace(before=chosen_of(self.before), after=chosen_of(self.after), **parts)

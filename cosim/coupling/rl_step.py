"""One RL step of the co-simulation: what a policy is asked, and what came of it."""

from typing import Any, NamedTuple, Protocol

import numpy as np

from cosim.base.errors import UserError, shown
from cosim.coupling.signals import RawSamples, Samples
from cosim.model.outcome import Outcome
from cosim.onboard.features import DIRECTION_COUNT, Observation


class Decision(NamedTuple):
    """Decision of a policy, with the values of the alternatives.

    Attributes:
        action: (N,) direction index of each robot.
        values: (N, 8) action values that the action was chosen by; None if the policy has none.
    """

    action: np.ndarray
    values: np.ndarray | None = None


class SupportsAct(Protocol):
    """Interface that the co-simulation needs of an agent."""

    def act(self, observation: Observation) -> np.ndarray | Decision:
        """Return the direction index of each robot, shape (N,), or a decision."""
        ...


def decide(policy: SupportsAct, observation: Observation) -> Decision:
    """Return what a policy decides.

    Arrays that it receives and those that it returns are copied: neither what it changes in an
    observation nor a buffer that it uses again changes an episode.

    Raises:
        UserError: the values of a decision are none.
    """
    decided = policy.act(Observation(*(array.copy() for array in observation)))
    parts: Any = decided if isinstance(decided, Decision) else Decision(decided)
    if parts.values is not None:
        values, shape = parts.values, (len(observation.cells), DIRECTION_COUNT)
        if getattr(values, "shape", ()) != shape or values.dtype.kind not in "fiu":
            raise UserError(
                f"the policy returned values = {shown(values)}; expected {shape[0]} x {shape[1]} "
                "numbers, the value of every direction for each robot"
            )
    copied: Any = [p.copy() if isinstance(p, np.ndarray | list) else p for p in parts]
    return Decision(*copied)


class Step(NamedTuple):
    """One RL step of the co-simulation.

    Attributes:
        number: of the step, from 0.
        first_tick: ticks of dt before the step.
        before, after: observations at its start and end.
        action: (N,) direction index in force during the step, −1 for a robot that arrived before
            or that the shield lets wait.
        decided: (N,) whether the action was adopted at the start of this step.
        completed: (N,) whether the robot ended its move within this step.
        samples: signals at every control period that was simulated.
        raw: signals at every tick of the burst at the start of the step.
        events: (N,) what became of each robot: RUNNING, COLLISION or OUT_OF_BOARD of
            `cosim.model.outcome`.
        outcome: of the episode, RUNNING until it ends.
        duration_s: simulated time.
    """

    number: int
    first_tick: int
    before: Observation
    after: Observation
    action: np.ndarray
    decided: np.ndarray
    completed: np.ndarray
    samples: Samples
    raw: RawSamples
    events: np.ndarray
    outcome: Outcome
    duration_s: float

    @property
    def moved_m(self) -> np.ndarray:
        """(N,) distance of each robot's centre from where it was at the start."""
        path = self.samples.position[[0, -1], :, :2]
        return np.hypot(*(path[1] - path[0]).T)

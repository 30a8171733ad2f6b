"""Episodes of policies that command motors, at the end of every control interval.

Such a policy has `drive(motion)`, which returns set points (N, motors) in rad/s, and
`interval_s`, the time between two commands. If it also has `calibrated = True`, the steering in
`motion.config` is calibrated for its machine. One that chooses directions has `act(observation)`.
"""

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, NamedTuple, Protocol

import numpy as np

from cosim.base.arguments import ConfigError, numbers, validate_argument
from cosim.base.errors import UserError, shorten
from cosim.coupling.rl_step import Decision, Step
from cosim.model.config import CoSimConfig
from cosim.model.scenario import Scenario
from cosim.onboard.estimation import POSE
from cosim.onboard.steering import DIRECT, HOLD, MODE, OMEGA_D
from cosim.physics.trig import sines_cosines
from cosim.simulation.episode import RunningEpisode
from cosim.simulation.options import SimulationOptions


class DriveObservation(NamedTuple):
    """Observation of a policy that commands motors: a row per robot.

    Attributes:
        poses: (N, 3) x, y in m and heading in rad, as the camera's filter estimates them where the
            world has a camera.
        velocities: (N, 3) ahead and to the left in m/s, yaw rate in rad/s: the mean since the
            command before, 0 at the start.
        speeds: (N, motors) in rad/s.
        targets_m: (N, 2) in m.
        memory: of the policy, for this episode alone.
    """

    poses: np.ndarray
    velocities: np.ndarray
    speeds: np.ndarray
    targets_m: np.ndarray
    scenario: Scenario
    config: CoSimConfig
    memory: dict[str, Any]


class SupportsDrive(Protocol):
    """Interface that the co-simulation needs of a policy that commands motors."""

    interval_s: float

    def drive(self, motion: DriveObservation) -> np.ndarray:
        """Return the set points of the motors of each robot in rad/s, (N, motors)."""
        ...


def drives(policy: Any) -> bool:
    """Return whether a policy commands motors instead of choosing directions."""
    acts, commands = (callable(getattr(policy, name, None)) for name in ("act", "drive"))
    if isinstance(policy, type) or acts == commands:
        both = acts and commands and not isinstance(policy, type)
        has = (
            "act(observation) and drive(motion)" if both else "no act(observation) or drive(motion)"
        )
        raise ConfigError(
            f"policy = {shorten(policy)} has {has}; give an object that has one of them, such as "
            'agent.load("policy.npz")'
        )
    return commands


def needs_calibration(policy: Any) -> bool:
    """Return whether a policy chooses directions, or asks for calibrated speeds."""
    return not drives(policy) or bool(getattr(policy, "calibrated", False))


def options_for(policy: Any, options: SimulationOptions) -> SimulationOptions:
    """Return options in which RL steps are the control intervals of a policy that has them."""
    if not drives(policy):
        return options
    calibrated = needs_calibration(policy)
    refuse_without_effect(vars(options), "on a policy that commands motors", calibrated=calibrated)
    interval_s = validate_argument(
        "interval_s of the policy", getattr(policy, "interval_s", None), float
    )
    return replace(options, rl_step=interval_s)


def refuse_without_effect(options: Mapping[str, Any], where: str, *, calibrated: bool) -> None:
    """Refuse options of the co-simulation that only matter where directions are chosen.

    Args:
        calibrated: whether commands are velocities, which the option `speed` scales.
    """
    names = ("rl_step", "through", "shield", *(() if calibrated else ("speed",)))
    given = [name for name in names if options.get(name)]
    if "heading" in (options.get("open_loop") or ()):
        given.append("open_loop = heading")
    if given:
        raise ConfigError(f"{', '.join(given)} has no effect {where}; leave it out")


class DrivenEpisode(RunningEpisode):
    """An episode with robots that get motor set points in every RL step.

    A robot has arrived when its centre is in its target's cell at the end of one.
    """

    _driven = True

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self.memory: dict[str, Any] = {}
        self.targets_m = np.array([self.scenario.centre_m(cell) for cell in self.scenario.targets])
        self._poses = self._robots.estimates[self._columns, POSE : POSE + 3].copy()
        self._velocities = np.zeros((self.scenario.robots, 3))

    def motion(self) -> DriveObservation:
        """Return what the policy sees now."""
        seen = self._poses.copy(), self._velocities.copy(), self._speeds.copy()
        return DriveObservation(
            *seen, self.targets_m.copy(), self.scenario, self.config, self.memory
        )

    def ask(self, policy: Any) -> Decision:
        """See `RunningEpisode.ask`."""
        commanded: Any = policy.drive(self.motion())
        return Decision(commanded.copy() if isinstance(commanded, np.ndarray) else commanded)

    def end_step(self) -> Step:
        """See `RunningEpisode.end_step`."""
        step = super().end_step()
        before = self._poses
        self._poses = self._robots.estimates[self._columns, POSE : POSE + 3].copy()
        self._velocities = velocities(before, self._poses, self.config.timing.rl_step_s)
        return step

    def _directions(self, action: Any) -> np.ndarray:
        n, motors = self.scenario.robots, len(self.config.robot.motors)
        if (set_points := numbers(action, (n, motors))) is None:
            raise UserError(
                f"the policy returned {shorten(action)}; expected {n} x {motors} finite numbers, "
                "the set points of each robot's motors in rad/s"
            )
        fastest, limit = float(np.abs(set_points).max()), self.config.limit_rad_s
        if fastest >= limit:
            raise UserError(
                f"the policy commands a motor speed of {fastest:g} rad/s, which would make the "
                f"robot hop; stay below lift-off at {limit:.0f} rad/s (without any hop up to "
                "motion.config.steering.max_speed_rad_s)"
            )
        return set_points

    def _adopt(self, action: np.ndarray) -> None:
        commands = self._robots.commands[self._columns]
        commands[:, OMEGA_D : OMEGA_D + action.shape[1]] = action
        commands[:, MODE] = np.where(self.moves.arrived, HOLD, DIRECT)


def in_frames(vectors: np.ndarray, cos: np.ndarray, sin: np.ndarray) -> np.ndarray:
    """(N, 2 or 3) vectors of the board in the frames of robots, by their headings' cosine, sine."""
    turned = vectors.copy()
    turned[:, 0] = cos * vectors[:, 0] + sin * vectors[:, 1]
    turned[:, 1] = cos * vectors[:, 1] - sin * vectors[:, 0]
    return turned


def velocities(before: np.ndarray, poses: np.ndarray, interval_s: float) -> np.ndarray:
    """(N, 3) ahead and to the left in m/s, yaw rate in rad/s, between two poses (N, 3)."""
    moved, angle = poses - before, poses[:, 2]
    moved[:, 2] = (moved[:, 2] + math.pi) % (2.0 * math.pi) - math.pi
    sin, cos = sines_cosines(angle)
    return in_frames(moved, cos, sin) / interval_s

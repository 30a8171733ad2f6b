"""Control-level environments: motors are commanded every control interval, targets are random.

    gymnasium.make("MiniRobots/Drive-v0")
    gymnasium.make_vec("MiniRobots/Drive-v0", num_envs=16)

A learner drives here, where the other environments choose directions. Boards of many environments
share the lanes of one batch; every row is a robot, with the bits of the single environment.
"""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import ArrayLike

from agent.envs.dynamics import DynamicsBoards, Place
from agent.envs.tasks import REACH_M, Driven, Interval, Task, is_free
from agent.envs.views import RowsVectorEnv, SingleEnv
from cosim.base.arguments import (
    ConfigError,
    imported,
    numbers,
    require_names,
    require_one_of,
    validate_argument,
)
from cosim.base.errors import shorten
from cosim.base.jit import kernel
from cosim.coupling.signals import Samples
from cosim.model.config import CoSimConfig, whole_ratio
from cosim.model.outcome import RUNNING, SUCCESS, TIMEOUT
from cosim.model.params import TIMING, Positive
from cosim.model.scenario import Scenario
from cosim.onboard.estimation import POSE
from cosim.onboard.steering import DIRECT, HOLD, MODE, OMEGA_D
from cosim.physics.body_state import X, Y, orientation_of, standing_state
from cosim.physics.rotation import heading
from cosim.physics.trig import sines_cosines
from cosim.simulation.driving import DriveObservation, in_frames, refuse_without_effect, velocities
from cosim.simulation.episode import RunningEpisode
from cosim.simulation.measures import Measures

TIME_LIMIT_S = 120.0
_LENGTH_M = 0.1  # unit of positions in observations
_LIMIT = 10.0  # bound of an observation
_ROOT = 0.25  # a robot's speed grows with about the fourth power of its motors' speeds
_PERIOD_S = TIMING.control_period_s
_NEW_DITHER = (0.0, 1.0)
ACTIONS = ("velocity", "motors")


@kernel
def _locate(
    bodies: np.ndarray, targets_m: np.ndarray, poses: np.ndarray, away_m: np.ndarray
) -> None:
    """Write true poses (R, 3) and distances from targets (R,) of the first R bodies."""
    for i in range(len(poses)):
        poses[i, 0], poses[i, 1] = bodies[X, i], bodies[Y, i]
        poses[i, 2] = heading(orientation_of(bodies[:, i]))
        dx, dy = bodies[X, i] - targets_m[i, 0], bodies[Y, i] - targets_m[i, 1]
        away_m[i] = math.sqrt(dx * dx + dy * dy)


class DrivePolicy:
    """A policy of `Drive-v0` as one that drives in any scenario.

    >>> ahead = DrivePolicy(lambda observations: [[1.0, 0.0]] * len(observations))

    Args:
        predict: (N, F) float32 observations of `DriveVectorEnv` to (N, A) actions.
        action, context, control_interval: of the environment that it was trained in.

    Attributes:
        interval_s: time between two commands.
        calibrated: whether actions are velocities, which needs a machine that can be steered.
    """

    def __init__(
        self,
        predict: Callable[[np.ndarray], ArrayLike],
        *,
        action: str = "velocity",
        context: bool = False,
        control_interval: float = 0.1,
    ) -> None:
        require_one_of("action", action, ACTIONS)
        self._predict, self.calibrated = predict, action == "velocity"
        self._context = validate_argument("context", context, bool)
        self.interval_s = validate_argument("control_interval", control_interval, Positive)

    def drive(self, motion: DriveObservation) -> np.ndarray:
        """Return the set points of the motors in rad/s, (N, motors)."""
        robots = len(motion.poses)
        worlds = np.tile(_world_of(motion.config), (robots, 1)) if self._context else None
        shape = robots, size_of_action(motion.config, self.calibrated)
        actions = checked_actions(self._predict(observed(motion, robots, worlds)), shape)
        dither = motion.memory.setdefault("dither", np.tile(_NEW_DITHER, (robots, 1)))
        return set_points(actions, motion.config, dither, velocity=self.calibrated)


class DriveBoards(DynamicsBoards):
    """Boards with robots that take motor commands; spaces as of `DriveVectorEnv`.

    Args:
        scenario: board and number of robots; starts and targets are drawn anywhere on it.
        action: "velocity" (ahead, and yaw rate) or "motors" (set points).
        reward, reach: of the task of `Drive-v0`: "dense" or "sparse", see `DriveEnv`, and largest
            distance of a target in m.
        task: another one, or its "module:Name".
        observe: "true" poses, or "estimated" by the filter of the world's camera.
        context: observe friction, motor spread, restitution, slope and payload of the episode.
        control_interval: simulated time of a step in s.
        max_episode_steps: limit of steps, which cuts episodes as Gymnasium's `TimeLimit` does, in
            addition to the physics' `time_limit` (120 s).
        physics: see `agent.envs.dynamics.DynamicsBoards`.
    """

    _mutable = (*DynamicsBoards._mutable, "_driven")

    def __init__(
        self,
        count: int,
        scenario: str | Scenario,
        *,
        action: str = "velocity",
        reward: str = "dense",
        observe: str = "true",
        context: bool = False,
        control_interval: float = 0.1,
        reach: float = REACH_M,
        task: Task | str | None = None,
        max_episode_steps: int | None = None,
        **physics: Any,
    ) -> None:
        require_one_of("action", action, ACTIONS)
        require_one_of("reward", reward, ("dense", "sparse"))
        require_one_of("observe", observe, ("true", "estimated"))
        self._context = validate_argument("context", context, bool)
        self._interval_s = validate_argument("control_interval", control_interval, Positive)
        validate_argument("reach", reach, Positive)
        whole_ratio("control_interval", control_interval, "control_period_s", _PERIOD_S)
        if task is not None and (reward, reach) != ("dense", REACH_M):
            raise ConfigError("reward and reach have no effect with task; leave them out")
        own = imported("task", task, "a Task") if isinstance(task, str) else task
        if not isinstance(own, Task | None):
            raise ConfigError(f"task = {shorten(own)} is not one; give an agent.envs.tasks.Task")
        self._task = own or Task(reach, None if reward == "dense" else {"end": 1.0})
        self._estimated, self._calibrated = observe == "estimated", action == "velocity"
        refuse_without_effect(physics, "where a learner drives", calibrated=self._calibrated)
        options = {"time_limit": TIME_LIMIT_S, **physics, "rl_step": control_interval}
        super().__init__(count, scenario, options, max_episode_steps, [*self._task.weights])
        self._identity = (*self._identity, observe)
        step_ticks = self._config.periods_per_step * self._config.ticks_per_period
        self._last_step = -(-self._config.ticks(self._config.timing.episode_limit_s) // step_ticks)
        sizes = ((3,), (3,), (2,), (), (2,), (5,))
        self._driven = Driven._make(np.zeros((*self.shape, *size)) for size in sizes)

    def _spaces(self) -> tuple[spaces.Space, spaces.Space]:
        motors = len(self._config.robot.motors)
        size = 11 + motors + 2 * (self.scenario.robots > 1) + 5 * self._context
        observation = spaces.Box(-_LIMIT, _LIMIT, (size,), np.float32)
        actions = size_of_action(self._config, self._calibrated)
        return observation, spaces.Box(-1.0, 1.0, (actions,), np.float32)

    def _placement(self, starts: Any, targets: Any) -> Place:
        given = self._positions("starts", starts, 3), self._positions("targets", targets, 2)
        # no robot's target cell is forbidden to the others: its centre is what counts here
        scenario = replace(self.scenario, zone_is_obstacle=False)

        def place(rng: np.random.Generator) -> tuple[Scenario, np.ndarray, Any]:
            poses, targets_m = self._task.place(self.scenario, rng, *given)
            return scenario, poses[:, :2] // scenario.cell_m, (poses, targets_m)

        return place

    def _positions(self, name: str, values: Any, size: int) -> np.ndarray | None:
        if values is None:
            return None
        array = numbers(values, shape := (self.shape[1], size))
        if array is None or not is_free(self.scenario, array[:, :2]):
            raise ConfigError(
                f"{name} = {shorten(values)} must be of shape {shape}, in m on the board, off "
                "obstacles and further apart than a diameter"
            )
        return array

    def _set_up(self, m: int, episode: RunningEpisode, placed: Any) -> None:
        poses, targets_m = placed
        episode.measures = Measures(poses[:, :2], poses[:, 2], _PERIOD_S)
        state, columns = self._batch.state, range(m * self.shape[1], (m + 1) * self.shape[1])
        for column, (x, y, angle) in zip(columns, poses.tolist(), strict=True):
            state.bodies.motion[:, column] = standing_state(episode.config.robot, x, y, angle)
            state.onboard.estimates[column, POSE : POSE + 3] = x, y, angle
        begun = poses, 0.0, targets_m, 0.0, _NEW_DITHER, _world_of(episode.config)
        for array, values in zip(self._driven, begun, strict=True):
            array[m] = values
        self._locate(np.empty_like(self._driven.poses))

    def _locate(self, poses: np.ndarray) -> None:
        """Write true poses (K, N, 3), and the distances from targets."""
        flat = self._driven.targets_m.reshape(-1, 2), poses.reshape(-1, 3)
        _locate(self._batch.state.bodies.motion, *flat, self._driven.away_m.reshape(-1))

    def joint(self, actions: Any) -> np.ndarray:
        """See `EnvBoards.joint`."""
        shape = self.shape[0] * self.shape[1], size_of_action(self._config, self._calibrated)
        return checked_actions(actions, shape).reshape(*self.shape, -1)

    def _advance(self, actions: np.ndarray, rewards: np.ndarray, lost: np.ndarray) -> None:
        """Drive for a control interval; see the base class."""
        driven, batch, outcomes = self._driven, self._batch, self.arrays.outcomes
        state, count, robots = batch.state, math.prod(self.shape), self.shape[1]
        running, moved = ~self.arrays.over, self.remaining()
        before = Driven._make(map(np.copy, driven))
        commands = state.onboard.commands[:count]
        speeds = set_points(
            actions.reshape(count, -1),
            self._config,
            driven.dither.reshape(-1, 2),
            velocity=self._calibrated,
        )
        commands[:, OMEGA_D : OMEGA_D + speeds.shape[1]] = speeds
        commands[:, MODE] = np.where(moved.ravel(), DIRECT, HOLD)
        episodes = self._episodes()
        for samples, _ in batch.stretches():
            for m in np.flatnonzero(running).tolist():
                own = slice(state.episodes.periods[m]), slice(m * robots, (m + 1) * robots)
                episodes[m].measures.add(Samples._make(signal[own] for signal in samples))
        self._locate(driven.poses)
        if self._estimated:
            estimates = state.onboard.estimates[:count, POSE : POSE + 3]
            driven.poses[:] = estimates.reshape(*self.shape, 3)
        poses = before.poses.reshape(-1, 3), driven.poses.reshape(-1, 3)
        driven.velocities[:] = velocities(*poses, self._interval_s).reshape(*self.shape, 3)
        self._arrived |= self._task.arrived(driven)
        events = state.episodes.events[:count].reshape(self.shape)
        worst = events.max(axis=1)
        ends = np.where(self._arrived.all(axis=1) & (worst == RUNNING), SUCCESS, worst)
        ends[(ends == RUNNING) & (self._steps >= self._last_step)] = TIMEOUT
        outcomes[running] = ends[running]
        lost[running & (worst != RUNNING)] = True
        step = Interval(before, driven, self._arrived, events != RUNNING, self._interval_s)
        earned = self._task.terms(step)
        require_names("task.weights.", self._task.weights, [*earned])
        for name, weight in self._task.weights.items():
            self.terms[name][:] = np.where(moved, weight * earned[name], 0.0)
            rewards += self.terms[name]

    def _observed(self) -> tuple[np.ndarray, np.ndarray]:
        state, count, robots = self._batch.state, math.prod(self.shape), self.shape[1]
        motors = state.motors.set_points.shape[0]
        speeds = state.motors.outputs[motors : 2 * motors, :count].T
        poses, moving, targets_m, *_, worlds = (a.reshape(count, -1) for a in self._driven)
        motion = DriveObservation(poses, moving, speeds, targets_m, self.scenario, self._config, {})
        observations = observed(motion, robots, worlds if self._context else None)
        return observations.reshape(*self.shape, -1), ~self._arrived

    def scenes(self) -> list[tuple[Scenario, np.ndarray]]:
        """See `EnvBoards.scenes`."""
        self._episodes()  # refuses before the first
        cells = (self._driven.targets_m // self.scenario.cell_m).astype(int)
        targets = [tuple((x, y) for x, y in board) for board in cells.tolist()]
        scenes = (replace(self.scenario, targets=of_board) for of_board in targets)
        return list(zip(scenes, self._driven.poses[..., :2], strict=True))


class DriveVectorEnv(RowsVectorEnv):
    """Robots that learn to drive to drawn targets; every robot of the boards is a row.

    `num_envs=K` boards of N robots have R = K · N rows, and `env.num_envs` is R.

    - Observation: Box (R, F) float32, cut to -10 to 10, as of `DriveEnv`: F is 11 and one
      for each motor, with several robots 2 more, offset ahead and to the left of the nearest other
      one in 0.1 m, and with `context` 5 more at the end.
    - Action: Box (R, A) from -1 to 1, as of `DriveEnv`; ignored by robots that have arrived, and in
      the step that begins a board again.
    - Reward: (R,) float64 as of `DriveEnv`, for every robot of its own; 0 for robots that have
      arrived, and where a board begins again.
    - Termination: (R,) bool, by `ends="together"` the rows of a board when all its robots have
      arrived (5 mm) or one has left the board or touched something; by `ends="own"` a robot that
      arrived in its own step, the others then.
    - Truncation: (R,) bool, robots that have not arrived at `time_limit` (120 s of simulated time);
      and at `max_episode_steps`, also robots that arrived or failed in that step, as Gymnasium's
      `TimeLimit` has it.
    - Restart: a board begins again in the step after its end, all its robots (next-step autoreset).
    - Infos: (R,) arrays as of `DriveEnv`. Gymnasium's masks `_outcome` and so on are True in every
      row.
    - Options of `reset`: `starts`, (K, N, 3), `targets`, (K, N, 2), `mu`, (K,), as of `DriveEnv`;
      `reset_mask`, (K,) bool, boards to begin again, whose seeds alone are used.
    - Arguments: `num_envs` and `ends` as above, those of `DriveBoards` and of `View`.

    >>> env = DriveVectorEnv(2, "2")
    >>> observations, infos = env.reset(seed=0)
    >>> observations.shape, env.action_space.shape
    ((4, 15), (4, 2))
    >>> env.close()
    """

    _boards_of = DriveBoards


class DriveEnv(SingleEnv):
    """One robot that learns to drive to drawn targets.

    - Observation: Box (F,) float32, cut to -10 to 10. 0, 1: target ahead and to the left in 0.1 m.
      2, 3: sine and cosine of the heading. 4, 5: x and y over the board's size. 6, 7: velocity
      ahead and to the left over the calibrated speed. 8: yaw rate over the calibrated one. With
      action "motors", which needs no calibration, over those of the paper's robot, 3.9 mm/s and 0.2
      rad/s. 9, 10: speeds of motors D and E over the largest (of a machine with M motors, 9 to
      8 + M). The last two: cosine and sine of the angle to the target.
      With `context` 5 more: µ, motor spread, restitution, slope in deg, payload in 10 g.
    - Action: Box (A,) from -1 to 1, cut beyond, for `control_interval` (0.1 s). "velocity": speed
      ahead and yaw rate over the calibrated ones. "motors": set points of D and E, or of the M
      motors, over the largest.
    - Reward, float: "dense" 1 per cm of progress, -0.1 per s, 10 on arrival, -10 on failure;
      "sparse" 1 on arrival, -1 on failure, else 0.
    - Termination: the centre is within 5 mm of the target, or left the board, or the robot touched
      an obstacle.
    - Truncation: after `max_episode_steps` (of the id 1200), whatever else that step has, or
      `time_limit` (120 s of simulated time).
    - Infos: as of `agent.envs.navigation.NavigationEnv`; the terms of the dense reward are
      `reward_progress`, `reward_time` and `reward_end`, that of the sparse one is the last.
    - Options of `reset`: `starts`, [[x, y, heading]] in m and rad, by default anywhere on it;
      `targets`, [[x, y]] in m, by default within `reach` (0.2 m) of the start; `mu`, friction
      coefficient of the floor, for this episode.
    - Arguments: those of `DriveBoards` without `count`, and of `View`.

    >>> env = DriveEnv(control_interval=0.5)
    >>> start = {"starts": [[0.15, 0.15, 0.0]], "targets": [[0.25, 0.15]]}
    >>> env.reset(seed=0, options=start)[0].round(2).tolist()
    [1.0, 0.0, 0.0, 1.0, 0.5, 0.5, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0]
    >>> observation, reward, terminated, truncated, info = env.step(np.array([1.0, 0.0]))
    >>> bool(observation[0] < 1.0), terminated, truncated, info["active"]
    (True, False, False, True)
    >>> env.close()
    """

    _boards_of = DriveBoards


def size_of_action(config: CoSimConfig, velocity: bool) -> int:
    """Return how many numbers command a robot: velocity and yaw rate, or one for each motor."""
    return 2 if velocity else len(config.robot.motors)


def checked_actions(actions: Any, shape: tuple[int, int]) -> np.ndarray:
    """Return float64 from -1 to 1 of what a learner gave, cut where it is beyond."""
    if (wanted := numbers(actions, shape)) is None:
        rows, size = shape
        raise ConfigError(
            f"actions = {shorten(actions)}: give {size} finite numbers from -1 to 1 to each of the "
            f"{rows} robots"
        )
    return np.clip(wanted, -1.0, 1.0)


def set_points(
    actions: np.ndarray, config: CoSimConfig, dither: np.ndarray, *, velocity: bool
) -> np.ndarray:
    """Return the speeds of the motors in rad/s, (N, motors).

    The calibrated speeds realise an action of 1. The dither alternates once per interval, like
    that of `cosim.onboard.steering`.

    Args:
        actions: (N, 2), or (N, motors), from -1 to 1.
        config: calibrated; an RL step is a control interval.
        dither: (N, 2) phase in rad that the dither has added, and its sign, at first 0 and 1;
            written.
        velocity: whether actions are velocity and yaw rate, else set points.
    """
    steering = config.steering
    most = steering.max_speed_rad_s
    if not velocity:
        return most * actions
    ahead, turn = actions.T
    full = np.where(ahead > 0, steering.forward_speed_rad_s, steering.backward_speed_rad_s)
    drive, rotate = np.abs(ahead) ** _ROOT * full, np.abs(turn) ** _ROOT * steering.turn_speed_rad_s
    largest = np.maximum(drive + rotate, 1e-9)
    share = np.minimum(1.0, np.maximum(drive, rotate) / largest)
    phase, sign = dither.T
    sign[phase <= 0.0], sign[phase >= 2.0 * math.pi] = 1.0, -1.0
    added = sign * steering.dither_rad_s * (largest > 1.0)
    phase += 2.0 * added * config.timing.rl_step_s
    speeds = []
    for own in steering.shares:
        along = drive * np.where(ahead > 0, own.forwards, own.backwards)
        around = rotate * np.where(turn > 0, own.left_turn, own.right_turn)
        dithered = added * np.where(drive >= rotate, own.dither, own.turn_dither)
        speeds.append(share * (around + along) + dithered)
    return np.clip(np.stack(speeds, axis=-1), -most, most)


def observed(motion: DriveObservation, robots: int, worlds: np.ndarray | None) -> np.ndarray:
    """Return observations of `DriveVectorEnv`, (R, F) float32.

    Args:
        motion: of the R robots of some boards, which have the same size and one calibration.
        worlds: (R, 5) of `Driven`, to observe as well; None for none.
    """
    poses, velocities, speeds, targets_m = motion[:4]
    steering, (sin, cos) = motion.config.steering, sines_cosines(poses[:, 2])
    error_m = in_frames(targets_m - poses[:, :2], cos, sin)
    parts = [
        error_m / _LENGTH_M,
        sin[:, None],
        cos[:, None],
        poses[:, :2] / motion.scenario.size_m,
        velocities[:, :2] / steering.drive_speed_m_s,
        velocities[:, 2:] / steering.turn_rate_rad_s,
        speeds / steering.max_speed_rad_s,
        error_m / np.maximum(np.linalg.norm(error_m, axis=1), 1e-9)[:, None],
    ]
    if robots > 1:
        positions = poses[:, :2].reshape(-1, robots, 2)
        apart = positions[:, None] - positions[:, :, None]
        gaps = np.linalg.norm(apart, axis=-1) + np.diag([np.inf] * robots)
        nearest = np.take_along_axis(apart, gaps.argmin(axis=2)[..., None, None], axis=2)
        parts.append(in_frames(nearest.reshape(-1, 2), cos, sin) / _LENGTH_M)
    if worlds is not None:
        parts.append(worlds)
    return np.concatenate(parts, axis=1).clip(-_LIMIT, _LIMIT).astype(np.float32)


def _world_of(config: CoSimConfig) -> tuple[float, ...]:
    """Return an episode's world, see `Driven`."""
    world = config.world
    spread, restitution = world.motor_spread or 0.0, world.restitution or 0.0
    return config.robot.mu, spread, restitution, world.floor_tilt_deg, 0.1 * world.payload_g

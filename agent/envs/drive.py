"""Control-level environments: motors are commanded every control interval, targets are random.

    gymnasium.make("MiniRobots/Drive-v0")
    gymnasium.make_vec("MiniRobots/Drive-v0", num_envs=16)

A learner drives here, where the other environments choose directions. Boards of many environments
share the lanes of one batch; every row is a robot, with the bits of the single environment.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import combinations, starmap
from typing import Any, Literal

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space
from numpy.typing import ArrayLike

from agent.envs.boards import board_options, board_seeds, counted
from agent.envs.cosim_episode import set_up
from agent.envs.grid_episode import ActionError, StartsError, known_options
from agent.envs.rendering import RENDER_MODES, picture, require_render_mode
from agent.envs.state import Restorable
from agent.envs.vector import lone, row_infos
from cosim.base.arguments import ConfigError, require_one_of, taken
from cosim.base.errors import shown
from cosim.model.config import CoSimConfig, whole_ratio
from cosim.model.outcome import BY_RANK, RUNNING, TIMEOUT
from cosim.model.params import TIMING
from cosim.model.scenario import Scenario, touches_obstacle
from cosim.onboard.estimation import POSE
from cosim.physics.body_state import standing_state
from cosim.simulation.driving import NO_EFFECT, DrivenEpisode, DriveObservation, in_frames, numbers

TIME_LIMIT_S = 120.0
REACH_M = 0.2
REACHED_M = 0.005
_LENGTH_M = 0.1  # unit of positions in observations
_LIMIT = 10.0  # bound of an observation
_DRAWS = 1000  # of poses, before a board counts as too small
_ROOT = 0.25  # a robot's speed grows with about the fourth power of its motors' speeds
_END_REWARD = 10.0  # of an arrival, and of a failure with its sign changed; a cm of progress has 1
_PERIOD_S = TIMING.control_period_s
ACTIONS = ("velocity", "motors")

Observe = Literal["true", "estimated"]


class FreeEpisode(DrivenEpisode):
    """An episode from poses to targets anywhere on the board.

    A robot has arrived within 5 mm of its target; `observe` "true" shows true poses whatever the
    camera sees.

    Attributes:
        away_m: (N,) true distances from the targets, in m.
    """

    observe: Observe = "true"

    def put(self, poses: np.ndarray, targets_m: np.ndarray, observe: Observe) -> None:
        """Set the robots down at (N, 3) x, y in m and heading in rad, for (N, 2) targets in m."""
        self.targets_m, self.observe = targets_m, observe
        self.away_m = np.hypot(*(poses[:, :2] - targets_m).T)
        for robot, (x, y, angle) in enumerate(poses.tolist()):
            self._bodies[robot] = standing_state(self.config.robot, x, y, angle)
        self._estimates[:, POSE : POSE + 3] = self._poses = poses
        self.measures._last_m[:], self.measures._last_rad[:] = poses[:, :2], poses[:, 2]

    def poses(self) -> np.ndarray:
        """See `DrivenEpisode.poses`."""
        return super().poses() if self.observe == "estimated" else self.true_poses()

    def _arriving(self, completed: np.ndarray) -> np.ndarray:
        self.away_m = np.hypot(*(self._bodies[:, :2] - self.targets_m).T)
        return self.away_m <= REACHED_M


class DrivePolicy:
    """A policy of `Drive-v0` as one that drives in any scenario.

    >>> ahead = DrivePolicy(lambda seen: [[1.0, 0.0]] * len(seen))

    Args:
        predict: (N, F) float32 observations of `DriveVectorEnv` to (N, 2) actions.
        action, context, control_interval: of the environment that it was trained in.

    Attributes:
        interval_s: time between two commands.
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
        self._predict, self._velocity = predict, action == "velocity"
        self._context = taken("context", context, bool)
        self.interval_s = positive("control_interval", control_interval)

    def drive(self, motion: DriveObservation) -> np.ndarray:
        """Return the set points of motors D and E in rad/s, (N, 2).

        Raises:
            ActionError: the policy returned something else than two numbers for each robot.
        """
        actions = checked_actions(
            self._predict(observed([motion], context=self._context)), len(motion.poses)
        )
        dither = motion.memory.setdefault("dither", new_dither(len(actions)))
        return set_points(actions, motion.config, dither, velocity=self._velocity)


class DriveVectorEnv(Restorable, gym.vector.VectorEnv[np.ndarray, np.ndarray, np.ndarray]):
    """Robots that learn to drive; every robot of `num_envs` boards is a row.

    Observations of a robot, as float32: target ahead and to the left (0.1 m), sine and cosine of
    the heading, position over the board's size, velocity ahead and to the left and yaw rate (of the
    calibrated ones), speeds of motors D and E over the largest, cosine and sine of the angle to the
    target; with several robots the nearest other (0.1 m), with `context` the drawn world. Actions
    in [-1, 1], beyond which they are cut: velocity and yaw rate over the calibrated ones, or set
    points of motors D and E over the largest speed. An episode ends when all robots have been
    within 5 mm of their targets, when one fails, or at the time limit.
    """

    metadata = {  # noqa: RUF012
        "render_modes": RENDER_MODES,
        "render_fps": 10,
        "autoreset_mode": AutoresetMode.NEXT_STEP,
    }
    _mutable = (
        "_batch",
        "_seeds",
        "_dither",
        "_outcomes",
        "_arrived",
    )

    def __init__(
        self,
        num_envs: int = 1,
        scenario: str | Scenario = "1a",
        *,
        action: str = "velocity",
        reward: str = "dense",
        observe: Observe = "true",
        context: bool = False,
        control_interval: float = 0.1,
        reach: float = REACH_M,
        render_mode: str | None = None,
        max_episode_steps: int | None = None,
        alone: bool = False,
        **physics: Any,
    ) -> None:
        """Make the boards.

        Args:
            num_envs: boards.
            scenario: board and number of robots; starts and targets are drawn anywhere on it.
            action: "velocity" (ahead, and yaw rate) or "motors" (set points of D and E).
            reward: "dense": 1 per cm of progress, -0.1 per second, 10 on arrival, -10 on failure;
                "sparse": 1 on arrival, -1 on failure, else 0.
            observe: "true" poses, or "estimated" by the filter of the world's camera.
            context: observe friction, motor spread, restitution, slope and payload of the episode.
            control_interval: simulated time of a step in s.
            reach: largest distance of a target in m.
            render_mode: "ansi", "rgb_array" or None.
            max_episode_steps: limit of steps, in addition to the physics' `time_limit` (120 s).
            alone: refuse scenarios of several robots.
            physics: see `agent.envs.cosim_episode.set_up`.

        Raises:
            UserError: the scenario or an option cannot be used, or the motor FMU cannot be built.
        """
        require_render_mode(render_mode)
        require_one_of("action", action, ACTIONS)
        require_one_of("reward", reward, ("dense", "sparse"))
        require_one_of("observe", observe, ("true", "estimated"))
        self._context = taken("context", context, bool)
        self._interval_s = positive("control_interval", control_interval)
        self._reach_m = positive("reach", reach)
        whole_ratio("control_interval", control_interval, "control_period_s", _PERIOD_S)
        for name in NO_EFFECT:
            if name in physics:
                raise ConfigError(
                    f"{name} has no effect where a learner drives; leave it out, or choose "
                    "control_interval"
                )
        self._limit = counted("max_episode_steps", max_episode_steps, int | None)
        self._boards: int = counted("num_envs", num_envs)
        options = {"time_limit": TIME_LIMIT_S, **physics, "rl_step": control_interval}
        self._setup = set_up(scenario, options)
        self.scenario = lone(self._setup.scenario) if alone else self._setup.scenario
        self._robots, self.num_envs = self.scenario.robots, self._boards * self.scenario.robots
        self.render_mode = render_mode
        self._observe: Observe = observe
        self._velocity, self._dense = action == "velocity", reward == "dense"
        size = 13 + 2 * (self._robots > 1) + 5 * self._context
        self.single_observation_space = spaces.Box(-_LIMIT, _LIMIT, (size,), np.float32)
        self.single_action_space = spaces.Box(-1.0, 1.0, (2,), np.float32)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self._batch = self._setup.batch(self._boards)
        self._dither = new_dither(self.num_envs)
        self._outcomes = np.full(self._boards, TIMEOUT)  # none is running yet
        self._arrived = np.zeros((self._boards, self._robots), dtype=bool)
        self._seeds = [np.random.SeedSequence()] * self._boards
        self._seed(int(self.np_random_seed or 0))

    def _seed(self, seed: int | Sequence[int | None] | None) -> None:
        for m, one in enumerate(board_seeds(seed, self._boards)):
            if one is not None:
                self._seeds[m] = np.random.SeedSequence(one)

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin episodes; one seed counts up over the boards.

        Args:
            seed: of starts, targets, worlds and noise.
            options: for each board "starts" (robots, 3), x and y in m and heading in rad, drawn on
                the whole board by default; "targets" (robots, 2) in m, drawn within reach of the
                starts by default; "mu" of the floor; "reset_mask" (boards,) bool, boards to begin.

        Raises:
            StartsError: starts or targets are off the board, touch, or have another shape; the
                environments are as they were.
            ConfigError: the friction cannot be used.
        """
        begun = np.array([episode is not None for episode in self._batch.episodes])
        which, rows = board_options(options, begun, "starts", "targets", "mu")
        given = {m: self._checked(**rows[m]) for m in which}
        if isinstance(seed, int | np.integer):
            super().reset(seed=int(seed))
        self._seed(seed)
        for m in which:
            self._begin(m, *given[m])
        self.closed = False
        return self._observations(), self._infos()

    def _checked(
        self, starts: Any = None, targets: Any = None, mu: Any = None
    ) -> tuple[np.ndarray | None, np.ndarray | None, float | None]:
        if mu is not None:
            self._setup.config.with_overrides(mu)
        return self._places("starts", starts, 3), self._places("targets", targets, 2), mu

    def _places(self, name: str, values: Any, size: int) -> np.ndarray | None:
        if values is None:
            return None
        array, shape = numbers(values), (self._robots, size)
        if array.shape != shape or not np.isfinite(array).all() or not self._free(array[:, :2]):
            raise StartsError(
                f"{name} = {shown(values)} must be of shape {shape}, in m on the board, off "
                "obstacles and further apart than a diameter"
            )
        return array

    def _free(self, places: np.ndarray, margin_m: float = 0.0) -> bool:
        scenario, diameter_m = self.scenario, self.scenario.robot_diameter_m
        inside = (places >= margin_m) & (places <= np.array(scenario.size_m) - margin_m)
        walls = scenario.walls * scenario.cell_m
        touched = touches_obstacle(
            places[:, 0], places[:, 1], (diameter_m / 2.0 + margin_m) ** 2, walls
        )
        gaps = starmap(math.dist, combinations(places.tolist(), 2))
        return bool(inside.all() and not np.any(touched)) and all(g > diameter_m for g in gaps)

    def _drawn(self, rng: np.random.Generator, around: np.ndarray | None) -> np.ndarray:
        """(N, 2) places, uniform on the board, or on what of it is within reach of others."""
        size_m = np.array(self.scenario.size_m)
        reach_m = min(self._reach_m, math.hypot(*size_m))
        for _ in range(_DRAWS):
            drawn = rng.uniform(0.0, 1.0, (self._robots, 2))
            if around is None:
                places = drawn * size_m
            else:
                away, angle = reach_m * np.sqrt(drawn[:, 0]), 2.0 * math.pi * drawn[:, 1]
                places = around + np.column_stack([away * np.cos(angle), away * np.sin(angle)])
            if self._free(places, REACHED_M):
                return places
        raise StartsError(
            f"scenario {self.scenario.name}: {_DRAWS} draws found no places for its robots within "
            f"reach = {self._reach_m:g} m; choose a larger reach, or give starts and targets"
        )

    def _begin(
        self,
        m: int,
        poses: np.ndarray | None = None,
        targets_m: np.ndarray | None = None,
        mu: float | None = None,
    ) -> None:
        start_seed, noise_seed = self._seeds[m].spawn(2)
        rng = np.random.default_rng(start_seed)
        if poses is None:
            headings = rng.uniform(-math.pi, math.pi, self._robots)
            poses = np.column_stack([self._drawn(rng, None), headings])
        if targets_m is None:
            targets_m = self._drawn(rng, poses[:, :2])
        config = self._setup.drawn(rng, mu)
        # no robot's target cell is forbidden to the others: its centre is what counts here
        scenario = replace(self.scenario, zone_is_obstacle=False)
        cells = tuple((int(x), int(y)) for x, y in poses[:, :2] // scenario.cell_m)
        episode = self._batch.begin(m, scenario, cells, noise_seed, config, FreeEpisode)
        assert isinstance(episode, FreeEpisode)
        episode.put(poses, targets_m, self._observe)
        rows = slice(m * self._robots, (m + 1) * self._robots)
        self._dither[rows] = new_dither(self._robots)
        self._outcomes[m], self._arrived[m] = RUNNING, False

    def step(
        self, actions: ArrayLike
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Drive for a control interval; a board that has ended begins again instead.

        Raises:
            ActionError: the actions are not two finite numbers per row.
            ClosedError: the environment is closed.
        """
        self._require_open()
        speeds = set_points(
            checked_actions(actions, self.num_envs),
            self._setup.config,
            self._dither,
            velocity=self._velocity,
        ).reshape(self._boards, -1, 2)
        running = np.flatnonzero(self._outcomes == RUNNING).tolist()
        before = {m: self._episode(m).away_m for m in running}
        steps = self._batch.advance({m: speeds[m] for m in running}) if running else {}
        rewards = np.zeros((self._boards, self._robots))
        for m in range(self._boards):
            if m not in steps:
                self._begin(m)
                continue
            episode, arrived_before = self._episode(m), self._arrived[m].copy()
            self._outcomes[m] = BY_RANK.index(steps[m].outcome)
            if self._outcomes[m] == RUNNING and steps[m].number + 1 == self._limit:
                self._outcomes[m] = TIMEOUT
                self._batch.stop(m)
            self._arrived[m] = episode.arrived
            ends = 1.0 * episode.arrived - 1.0 * (steps[m].events != RUNNING)
            rewards[m] = ends
            if self._dense:
                rest = 0.1 * self._interval_s  # assumed: a second costs as much as a millimetre
                progress_m = before[m] - episode.away_m
                rewards[m] = 100.0 * progress_m - rest + _END_REWARD * ends
            rewards[m, arrived_before] = 0.0
        ended = np.repeat(self._outcomes != RUNNING, self._robots)
        cut = np.repeat(self._outcomes == TIMEOUT, self._robots) & ~self._arrived.reshape(-1)
        return self._observations(), rewards.reshape(-1), ended & ~cut, cut, self._infos()

    def _episode(self, m: int) -> FreeEpisode:
        episode = self._batch.episodes[m]
        if not isinstance(episode, FreeEpisode):
            raise ActionError("no episode has begun; call reset first")
        return episode

    def _observations(self) -> np.ndarray:
        """(rows, F) float32."""
        motions = [self._episode(m).motion() for m in range(self._boards)]
        return observed(motions, context=self._context)

    def _infos(self) -> dict[str, Any]:
        paths_m = [self._episode(m).measures.path_length_m for m in range(self._boards)]
        active = (self._outcomes == RUNNING)[:, None] & ~self._arrived
        return row_infos(self._outcomes, 100.0 * np.concatenate(paths_m), active)

    def render(self) -> tuple[Any, ...] | None:
        """One picture per row, that of its board with the targets of the episode."""
        self._require_open()
        if self.render_mode is None:
            return None
        pictures = []
        for m in range(self._boards):
            motion = self._episode(m).motion()
            cells = (motion.targets_m // self.scenario.cell_m).astype(int)
            scene = replace(self.scenario, targets=tuple((int(x), int(y)) for x, y in cells))
            pictures += [picture(self.render_mode, scene, motion.poses[:, :2])] * self._robots
        return tuple(pictures)

    def close_extras(self, **_: Any) -> None:
        """Free the FMU instances; `reset` opens the environment again."""
        self._batch.close()
        self._outcomes[:] = TIMEOUT


class DriveEnv(Restorable, gym.Env[np.ndarray, np.ndarray]):
    """One robot that learns to drive: a row of `DriveVectorEnv`; arguments and spaces as there."""

    metadata = {"render_modes": RENDER_MODES, "render_fps": 10}  # noqa: RUF012
    _mutable = ("_rows",)

    def __init__(
        self, scenario: str | Scenario = "1a", render_mode: str | None = None, **options: Any
    ) -> None:
        self._rows = DriveVectorEnv(1, scenario, render_mode=render_mode, alone=True, **options)
        self.observation_space = self._rows.single_observation_space
        self.action_space = self._rows.single_action_space
        self.render_mode = render_mode
        self._rows._seed(self.np_random_seed)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin an episode; `starts` (1, 3), `targets` (1, 2) and `mu` can be given as options."""
        super().reset(seed=seed)
        given = known_options(options, "starts", "targets", "mu")
        rows = {name: [value] for name, value in given.items() if value is not None}
        observations, infos = self._rows.reset(seed=seed, options=rows)
        self.closed = False
        return observations[0], _first(infos)

    def step(self, action: Any) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Drive for a control interval.

        Raises:
            ActionError: the action is not two finite numbers, or no episode is running.
            ClosedError: the environment is closed.
        """
        self._require_open()
        if self._rows._outcomes[0] != RUNNING:
            raise ActionError("no episode is running; call reset before the next step")
        observations, rewards, terminated, truncated, infos = self._rows.step([action])
        ends = bool(terminated[0]), bool(truncated[0])
        return observations[0], float(rewards[0]), *ends, _first(infos)

    def render(self) -> Any:
        """The board as text or pixels."""
        self._require_open()
        pictures = self._rows.render()
        return None if pictures is None else pictures[0]

    def close(self) -> None:
        """Free the simulation; `reset` opens the environment again."""
        self._rows.close()
        self.closed = True


def positive(name: str, value: Any) -> float:
    """Return a finite positive number as float.

    Raises:
        ConfigError: it is none.
    """
    if not 0.0 < taken(name, value, float) < math.inf:
        raise ConfigError(f"{name} = {value} must be positive and finite")
    return float(value)


def checked_actions(actions: Any, rows: int) -> np.ndarray:
    """(rows, 2) float64 from -1 to 1 of what a learner returned, cut where it is beyond.

    Raises:
        ActionError: it is something else than two finite numbers per row.
    """
    wanted = numbers(actions)
    if wanted.shape != (rows, 2) or not np.isfinite(wanted).all():
        raise ActionError(
            f"actions = {shown(actions)}: give two finite numbers from -1 to 1 to each of the "
            f"{rows} robots"
        )
    return np.clip(wanted, -1.0, 1.0)


def new_dither(robots: int) -> np.ndarray:
    """(N, 2) state of the dither: the phase that it has added, in rad, and its sign."""
    return np.tile([0.0, 1.0], (robots, 1))


def set_points(
    actions: np.ndarray, config: CoSimConfig, dither: np.ndarray, *, velocity: bool
) -> np.ndarray:
    """(N, 2) speeds of motors D and E in rad/s.

    The calibrated speeds realise an action of 1. The dither alternates once per interval, like
    that of `cosim.onboard.steering`.

    Args:
        actions: (N, 2) from -1 to 1.
        config: calibrated; an RL step is a control interval.
        dither: (N, 2) of `new_dither`, written.
        velocity: whether actions are velocity and yaw rate, else set points.
    """
    steering = config.steering
    most = steering.max_speed_rad_s
    if not velocity:
        return most * actions
    ahead, turn = actions.T
    full = np.where(ahead > 0, steering.forward_speed_rad_s, steering.backward_speed_rad_s)
    drive = np.sign(ahead) * np.abs(ahead) ** _ROOT * full
    rotate = np.sign(turn) * np.abs(turn) ** _ROOT * steering.turn_speed_rad_s
    largest = np.maximum(np.abs(drive) + np.abs(rotate), 1e-9)
    share = np.minimum(1.0, np.maximum(np.abs(drive), np.abs(rotate)) / largest)
    phase, sign = dither.T
    sign[phase <= 0.0], sign[phase >= 2.0 * math.pi] = 1.0, -1.0
    added = sign * steering.dither_rad_s * (largest > 1.0)
    phase += 2.0 * added * config.timing.rl_step_s
    added_d = np.where(np.abs(drive) >= np.abs(rotate), added, -added)
    pair = [share * (rotate - drive) + added_d, share * (rotate + drive) + added]
    return np.clip(np.stack(pair, axis=-1), -most, most)


def observed(motions: Sequence[DriveObservation], *, context: bool) -> np.ndarray:
    """(rows, F) float32 of the robots of some boards, see `DriveVectorEnv`; `context` adds worlds.

    The boards have as many robots each, of one calibration.
    """
    parts = zip(*(motion[:4] for motion in motions), strict=True)
    poses, velocities, speeds, targets_m = map(np.concatenate, parts)
    steering, angle = motions[0].config.steering, poses[:, 2]
    error_m = in_frames(targets_m - poses[:, :2], angle)
    seen = [
        error_m / _LENGTH_M,
        np.column_stack([np.sin(angle), np.cos(angle)]),
        poses[:, :2] / motions[0].scenario.size_m,
        velocities[:, :2] / steering.drive_speed_m_s,
        velocities[:, 2:] / steering.turn_rate_rad_s,
        speeds / steering.max_speed_rad_s,
        error_m / np.maximum(np.hypot(*error_m.T), 1e-9)[:, None],
    ]
    if (robots := len(motions[0].poses)) > 1:
        places = poses[:, :2].reshape(-1, robots, 2)
        apart = places[:, None] - places[:, :, None]
        gaps = np.hypot(apart[..., 0], apart[..., 1]) + np.diag([np.inf] * robots)
        nearest = np.take_along_axis(apart, gaps.argmin(axis=2)[..., None, None], axis=2)
        seen.append(in_frames(nearest.reshape(-1, 2), angle) / _LENGTH_M)
    if context:
        seen.append(np.repeat([_context_of(m.config) for m in motions], robots, axis=0))
    return np.clip(np.concatenate(seen, axis=1), -_LIMIT, _LIMIT).astype(np.float32)


def _context_of(config: CoSimConfig) -> tuple[float, ...]:
    """Return an episode's world: µ, motor spread, restitution, slope in deg, payload in 10 g."""
    world = config.world
    spread, restitution = world.motor_spread or 0.0, world.restitution or 0.0
    return config.robot.mu, spread, restitution, world.floor_tilt_deg, 0.1 * world.payload_g


def _first(infos: dict[str, Any]) -> dict[str, Any]:
    return {name: values[0].item() for name, values in infos.items() if name[0] != "_"}

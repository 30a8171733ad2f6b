"""Control-level environments: motors are commanded every control interval, targets are random.

    gymnasium.make("MiniRobots/Drive-v0")
    gymnasium.make_vec("MiniRobots/Drive-v0", num_envs=16)

A learner drives here, where the other environments choose directions. Boards of many environments
share the lanes of one batch; every row is a robot, with the bits of the single environment.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations, starmap
from typing import Any, Literal

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space

from agent.envs.boards import board_seeds, require_boards
from agent.envs.cosim_episode import EnvSetup, set_up
from agent.envs.grid_episode import ActionError, StartsError, known_options
from agent.envs.rendering import RENDER_MODES, board_pixels, board_text, require_render_mode
from agent.envs.state import Restorable
from agent.envs.vector import lone
from cosim.base.arguments import ConfigError, require_one_of
from cosim.coupling.signals import MOTORS, State
from cosim.model.config import CoSimConfig
from cosim.model.outcome import BY_RANK, RUNNING, SUCCESS, TIMEOUT
from cosim.model.scenario import Scenario, touches_obstacle
from cosim.onboard.estimation import POSE
from cosim.onboard.steering import DIRECT, MODE, OMEGA_D, OMEGA_E
from cosim.physics.body_state import standing_state
from cosim.physics.rotation import heading
from cosim.simulation.episode import RunningEpisode

TIME_LIMIT_S = 120.0
REACH_M = 0.2
REACHED_M = 0.005
_LENGTH_M = 0.1  # unit of positions in observations
_LIMIT = 10.0  # bound of an observation
_DRAWS = 1000  # of poses, before a board counts as too small
_ROOT = 0.25  # a robot's speed grows with about the fourth power of its motors' speeds
_END_REWARD = 10.0  # of an arrival, and of a failure with its sign changed; a cm of progress has 1

Observe = Literal["true", "estimated"]


class DrivenEpisode(RunningEpisode):
    """An episode whose robots get motor set points in every step."""

    def bind(self, state: State) -> None:
        """See `RunningEpisode.bind`; also the motors' speeds."""
        super().bind(state)
        self._speeds = state.outputs[MOTORS : 2 * MOTORS, self._columns].T

    def __getstate__(self) -> dict[str, Any]:
        """See `RunningEpisode`."""
        return {k: v for k, v in super().__getstate__().items() if k != "_speeds"}

    def put(self, poses: np.ndarray, targets_m: np.ndarray) -> None:
        """Set the robots down at (N, 3) x, y in m and heading in rad, for (N, 2) targets in m."""
        self.targets_m = targets_m
        for robot, (x, y, angle) in enumerate(poses.tolist()):
            self._bodies[robot] = standing_state(self.config.robot, x, y, angle)
        self._estimates[:, POSE : POSE + 3] = poses
        self.measures._last_m[:], self.measures._last_rad[:] = poses[:, :2], poses[:, 2]

    def poses(self, observe: Observe) -> np.ndarray:
        """(N, 3) x, y in m and heading in rad, true or as the camera's filter estimates them."""
        if observe == "estimated":
            return self._estimates[:, POSE : POSE + 3].copy()
        angles = [heading((q[0], q[1], q[2], q[3])) for q in self._bodies[:, 3:7].tolist()]
        return np.column_stack([self._bodies[:, :2], angles])

    def speeds_rad_s(self) -> np.ndarray:
        """(N, 2) of motors D and E."""
        return self._speeds.copy()

    def _directions(self, action: Any) -> np.ndarray:
        return action

    def _adopt(self, action: np.ndarray) -> np.ndarray:
        moving = ~self._arrived
        self._commands[moving, OMEGA_D], self._commands[moving, OMEGA_E] = action[moving].T
        self._commands[moving, MODE] = DIRECT
        return moving

    def _arriving(self, completed: np.ndarray) -> np.ndarray:
        return np.hypot(*(self._bodies[:, :2] - self.targets_m).T) <= REACHED_M


class DriveBoards(Restorable):
    """K boards of N robots that are driven by set points.

    Attributes:
        count, robots: K and N.
        outcomes: (K,) ranks of `cosim.model.outcome`.
        rewards: (K, N).
        arrived: (K, N) bool.
    """

    _mutable = (
        "_batch",
        "_seeds",
        "_poses",
        "_velocities",
        "_dither",
        "_contexts",
        "outcomes",
        "rewards",
        "arrived",
    )

    def __init__(
        self,
        count: int,
        scenario: str | Scenario,
        *,
        action: str,
        reward: str,
        observe: Observe,
        context: bool,
        control_interval: float,
        reach: float,
        alone: bool,
        physics: dict[str, Any],
    ) -> None:
        require_boards(count)
        require_one_of("action", action, ("velocity", "motors"))
        require_one_of("reward", reward, ("dense", "sparse"))
        require_one_of("observe", observe, ("true", "estimated"))
        if not reach > 0.0:
            raise ConfigError(f"reach = {reach} must be a positive distance in m")
        for name in ("rl_step", "through", "shield"):
            if name in physics:
                raise ConfigError(
                    f"{name} has no effect where a learner drives; leave it out, or choose "
                    "control_interval"
                )
        options = {"time_limit": TIME_LIMIT_S, **physics, "rl_step": control_interval}
        self.setup: EnvSetup = set_up(scenario, options)
        if alone:
            lone(self.setup.scenario)
        self.scenario, self.count, self.robots = (
            self.setup.scenario,
            count,
            self.setup.scenario.robots,
        )
        self._steering = self.setup.config.steering
        self._interval_s, self._reach_m = control_interval, reach
        self._velocity, self._dense = action == "velocity", reward == "dense"
        self._observe: Observe = observe
        self._context = context
        self._batch = self.setup.batch(count)
        rows = (count, self.robots)
        self._seeds = [np.random.SeedSequence(m) for m in range(count)]
        self._poses, self._velocities = np.zeros((*rows, 3)), np.zeros((*rows, 3))
        self._dither = np.zeros((*rows, 2))  # phase that the dither has added in rad, its sign
        self._contexts = np.zeros((count, 5))
        self.outcomes = np.full(count, TIMEOUT)
        self.rewards = np.zeros(rows)
        self.arrived = np.zeros(rows, dtype=bool)

    @property
    def size(self) -> int:
        """Numbers that a robot observes."""
        return 11 + 2 * (self.robots > 1) + 5 * self._context

    def seed(self, place: int, seed: int) -> None:
        """Seed starts, targets, worlds and noise of a board."""
        self._seeds[place] = np.random.SeedSequence(seed)

    def begin(self, place: int, starts: Any = None, targets: Any = None, mu: Any = None) -> None:
        """Begin an episode.

        Args:
            place: of the board.
            starts: (N, 3) x, y in m and heading in rad; drawn on the whole board if None.
            targets: (N, 2) x, y in m; drawn within reach of the starts if None.
            mu: friction coefficient of the floor in this episode.

        Raises:
            StartsError: starts or targets are off the board, touch, or have another shape; nothing
                has changed.
            ConfigError: the friction cannot be used.
        """
        scenario = self.scenario
        given = [self._checked("starts", starts, 3), self._checked("targets", targets, 2)]
        if mu is not None:
            self.setup.config.with_overrides(mu)
        start_seed, noise_seed = self._seeds[place].spawn(2)
        rng = np.random.default_rng(start_seed)
        poses, targets_m = given
        if poses is None:
            places = self._draw(rng, None)
            poses = np.column_stack([places, rng.uniform(-math.pi, math.pi, self.robots)])
        if targets_m is None:
            targets_m = self._draw(rng, poses[:, :2])
        config = self.setup.drawn(rng, mu)
        # no robot's target cell is forbidden to the others: its centre is what counts here
        cells = tuple((int(x), int(y)) for x, y in poses[:, :2] // scenario.cell_m)
        episode = self._batch.begin(
            place,
            replace(scenario, zone_is_obstacle=False),
            cells,
            noise_seed,
            config,
            DrivenEpisode,
        )
        assert isinstance(episode, DrivenEpisode)
        episode.put(poses, targets_m)
        self._poses[place], self._velocities[place], self._dither[place] = poses, 0.0, (0.0, 1.0)
        self._contexts[place] = _context_of(config)
        self.outcomes[place] = RUNNING
        self.rewards[place], self.arrived[place] = 0.0, False

    def _checked(self, name: str, values: Any, size: int) -> np.ndarray | None:
        if values is None:
            return None
        try:
            array = np.asarray(values, dtype=np.float64)
        except (TypeError, ValueError):
            array = np.empty(0)
        if array.shape != (self.robots, size) or not self._free(array[:, :2]):
            raise StartsError(
                f"{name} = {values!r} must be of shape {(self.robots, size)}, in m on the board, "
                "off obstacles and further apart than a diameter"
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

    def _draw(self, rng: np.random.Generator, around: np.ndarray | None) -> np.ndarray:
        """(N, 2) places, uniform on the board, or of it within reach of (N, 2) others."""
        margin_m = REACHED_M
        for _ in range(_DRAWS):
            places = rng.uniform(0.0, self.scenario.size_m, (self.robots, 2))
            near = (
                around is None or (np.hypot(*(places - around).T) <= np.array(self._reach_m)).all()
            )
            if near and self._free(places, margin_m):
                return places
        raise StartsError(
            f"scenario {self.scenario.name}: {_DRAWS} draws found no places for its robots within "
            f"reach = {self._reach_m:g} m; choose a larger reach, or give starts and targets"
        )

    def step(self, actions: np.ndarray) -> None:
        """Drive for a control interval by (K, N, 2) actions; one that has ended begins again."""
        running = np.flatnonzero(self.outcomes == RUNNING).tolist()
        before = self._distances()
        set_points = self._set_points(np.clip(actions, -1.0, 1.0))
        steps = self._batch.advance({m: set_points[m] for m in running}) if running else {}
        for m in range(self.count):
            if m not in steps:
                self.begin(m)
                continue
            episode, last = self._episode(m), self._poses[m].copy()
            self._poses[m] = episode.poses(self._observe)
            moved = self._poses[m] - last
            moved[:, 2] = (moved[:, 2] + math.pi) % (2.0 * math.pi) - math.pi
            self._velocities[m] = _turned(moved, self._poses[m, :, 2]) / self._interval_s
            arrived = episode.arrived
            self.outcomes[m] = BY_RANK.index(steps[m].outcome)
            self.rewards[m] = self._rewards(before[m], episode, arrived, steps[m].events != RUNNING)
            self.rewards[m, self.arrived[m]] = 0.0
            self.arrived[m] = arrived

    def _rewards(
        self, before: np.ndarray, episode: DrivenEpisode, arrived: np.ndarray, lost: np.ndarray
    ) -> np.ndarray:
        if not self._dense:
            return 1.0 * arrived - 1.0 * lost
        now = np.hypot(*(episode.poses("true")[:, :2] - episode.targets_m).T)
        rest = 0.1 * self._interval_s  # assumed: a second costs as much as a millimetre
        return 100.0 * (before - now) - rest + _END_REWARD * (1.0 * arrived - 1.0 * lost)

    def _episode(self, place: int) -> DrivenEpisode:
        episode = self._batch.episodes[place]
        assert isinstance(episode, DrivenEpisode)
        return episode

    def _distances(self) -> np.ndarray:
        found = np.zeros((self.count, self.robots))
        for m in np.flatnonzero(self.outcomes == RUNNING).tolist():
            episode = self._episode(m)
            found[m] = np.hypot(*(episode.poses("true")[:, :2] - episode.targets_m).T)
        return found

    def _set_points(self, actions: np.ndarray) -> np.ndarray:
        """(K, N, 2) speeds of motors D and E in rad/s.

        The calibrated speeds realise an action of 1. The dither alternates once per interval, like
        that of `cosim.onboard.steering`.
        """
        most = self._steering.max_speed_rad_s
        if not self._velocity:
            return most * actions
        steering, ahead, turn = self._steering, actions[..., 0], actions[..., 1]
        full = np.where(ahead > 0, steering.forward_speed_rad_s, steering.backward_speed_rad_s)
        drive = np.sign(ahead) * np.abs(ahead) ** _ROOT * full
        rotate = np.sign(turn) * np.abs(turn) ** _ROOT * steering.turn_speed_rad_s
        largest = np.maximum(np.abs(drive) + np.abs(rotate), 1e-9)
        share = np.minimum(1.0, np.maximum(np.abs(drive), np.abs(rotate)) / largest)
        phase, sign = self._dither[..., 0], self._dither[..., 1]
        sign[phase <= 0.0], sign[phase >= 2.0 * math.pi] = 1.0, -1.0
        dither = sign * steering.dither_rad_s * (largest > 1.0)
        phase += 2.0 * dither * self._interval_s
        dither_d = np.where(np.abs(drive) >= np.abs(rotate), dither, -dither)
        pair = [share * (rotate - drive) + dither_d, share * (rotate + drive) + dither]
        return np.clip(np.stack(pair, axis=-1), -most, most)

    def observations(self) -> np.ndarray:
        """(K, N, F) float32."""
        rows = np.zeros((self.count, self.robots, self.size), dtype=np.float32)
        for m in range(self.count):
            if self._batch.episodes[m] is None:
                continue
            episode, poses = self._episode(m), self._poses[m]
            angle = poses[:, 2]
            error = _turned(episode.targets_m - poses[:, :2], angle)
            steering, size = self._steering, self.scenario.size_m
            parts = [
                error[:, :2] / _LENGTH_M,
                np.column_stack([np.sin(angle), np.cos(angle)]),
                poses[:, :2] / size,
                self._velocities[m, :, :2] / steering.drive_speed_m_s,
                self._velocities[m, :, 2:] / steering.turn_rate_rad_s,
                episode.speeds_rad_s() / steering.max_speed_rad_s,
            ]
            if self.robots > 1:
                apart = poses[None, :, :2] - poses[:, None, :2]
                gaps = np.hypot(*np.moveaxis(apart, -1, 0)) + np.diag([np.inf] * self.robots)
                nearest = apart[np.arange(self.robots), gaps.argmin(axis=1)]
                parts.append(_turned(nearest, angle)[:, :2] / _LENGTH_M)
            if self._context:
                parts.append(np.tile(self._contexts[m], (self.robots, 1)))
            rows[m] = np.clip(np.concatenate(parts, axis=1), -_LIMIT, _LIMIT)
        return rows

    def positions_m(self) -> np.ndarray:
        """(K, N, 2), as they are observed."""
        return self._poses[..., :2]

    def steps(self, place: int) -> int:
        """Control intervals of a board's episode so far."""
        return round(self._episode(place).time_s / self._interval_s)

    def targets_m(self, place: int) -> np.ndarray:
        """(N, 2) of a board's episode."""
        return self._episode(place).targets_m

    def path_length_cm(self) -> np.ndarray:
        """(K, N)."""
        return np.array(
            [100.0 * self._episode(m).measures.path_length_m for m in range(self.count)]
        )

    def close(self) -> None:
        """Free the FMU instances."""
        self._batch.close()
        self.outcomes[:] = TIMEOUT


def _turned(vectors: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """(N, 2 or 3) vectors of the board in the frames of robots with (N,) headings."""
    turned, c, s = vectors.copy(), np.cos(angle), np.sin(angle)
    turned[:, 0] = c * vectors[:, 0] + s * vectors[:, 1]
    turned[:, 1] = c * vectors[:, 1] - s * vectors[:, 0]
    return turned


def _context_of(config: CoSimConfig) -> tuple[float, ...]:
    """What an episode's world is: µ, motor spread, restitution, slope in deg, payload in 10 g."""
    world = config.world
    return (
        config.robot.mu,
        world.motor_spread or 0.0,
        world.restitution or 0.0,
        world.floor_tilt_deg,
        0.1 * world.payload_g,
    )


class DriveVectorEnv(Restorable, gym.vector.VectorEnv[np.ndarray, np.ndarray, np.ndarray]):
    """Robots that learn to drive; every robot of `num_envs` boards is a row.

    Observations of a robot, as float32: target ahead and to the left (0.1 m), sine and cosine of
    the heading, position over the board's size, velocity ahead and to the left and yaw rate (of the
    calibrated ones), speeds of motors D and E over the largest; with several robots the nearest
    other (0.1 m), with `context` the drawn world. Actions in [−1, 1]: velocity and yaw rate over
    the calibrated ones, or set points of motors D and E over the largest speed. An episode ends
    when all robots have been within 5 mm of their targets, when one fails, or at the time limit.
    """

    metadata = {  # noqa: RUF012
        "render_modes": RENDER_MODES,
        "render_fps": 10,
        "autoreset_mode": AutoresetMode.NEXT_STEP,
    }
    _mutable = ("boards",)

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
            reward: "dense": 1 per cm of progress, −0.1 per second, 10 on arrival, −10 on failure;
                "sparse": 1 on arrival, −1 on failure, else 0.
            observe: "true" poses, or "estimated" by the filter of the world's camera.
            context: observe friction, motor spread, restitution, slope and payload of the episode.
            control_interval: simulated time of a step in s.
            reach: largest distance of a target in m.
            render_mode: "ansi", "rgb_array" or None.
            max_episode_steps: limit of steps, next to the physics' `time_limit` (120 s).
            alone: refuse scenarios of several robots.
            physics: see `agent.envs.cosim_episode.set_up`.

        Raises:
            UserError: the scenario or an option cannot be used, or the motor FMU cannot be built.
        """
        require_render_mode(render_mode)
        self.render_mode, self._limit = render_mode, max_episode_steps
        self.boards = DriveBoards(
            num_envs,
            scenario,
            action=action,
            reward=reward,
            observe=observe,
            context=context,
            control_interval=control_interval,
            reach=reach,
            alone=alone,
            physics=physics,
        )
        self.num_envs = num_envs * self.boards.robots
        self.single_observation_space = spaces.Box(-_LIMIT, _LIMIT, (self.boards.size,), np.float32)
        self.single_action_space = spaces.Box(-1.0, 1.0, (2,), np.float32)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self._seed_boards(int(self.np_random_seed or 0))

    def _seed_boards(self, seed: int | Sequence[int | None] | None) -> None:
        for m, one in enumerate(board_seeds(seed, self.boards.count)):
            if one is not None:
                self.boards.seed(m, one)

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin episodes; one seed counts up over the boards.

        Args:
            seed: of starts, targets, worlds and noise.
            options: "starts" (boards, robots, 3), "targets" (boards, robots, 2) and "mu" (boards,),
                see `DriveBoards.begin`; "reset_mask" (boards,) bool, boards to begin, all without.

        Raises:
            StartsError: starts or targets cannot be used.
        """
        given = dict(known_options(options, "starts", "targets", "mu", "reset_mask"))
        for name, values in given.items():
            if np.shape(values)[:1] != (self.boards.count,):
                raise StartsError(f"{name} = {values!r}; give one to each of the boards")
        if isinstance(seed, int | np.integer):
            super().reset(seed=int(seed))
        self._seed_boards(seed)
        for m in np.flatnonzero(given.pop("reset_mask", np.ones(self.boards.count, dtype=bool))):
            self.boards.begin(int(m), **{name: values[m] for name, values in given.items()})
        self.closed = False
        return self._observations(), self._infos()

    def step(
        self, actions: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Drive for a control interval; a board that has ended begins again instead.

        Raises:
            ActionError: the actions are not two finite numbers per row.
            ClosedError: the environment is closed.
        """
        self._require_open()
        actions = np.asarray(actions, dtype=np.float64)
        if actions.shape != (self.num_envs, 2) or not np.isfinite(actions).all():
            raise ActionError(
                f"actions of shape {actions.shape}; give two finite numbers from -1 to 1 to each "
                f"of the {self.num_envs} environments"
            )
        boards = self.boards
        boards.step(actions.reshape(boards.count, boards.robots, 2))
        if self._limit is not None:
            for m in np.flatnonzero(boards.outcomes == RUNNING).tolist():
                if boards.steps(m) == self._limit:
                    boards.outcomes[m] = TIMEOUT
        ended = np.repeat(boards.outcomes != RUNNING, boards.robots)
        truncated = np.repeat(boards.outcomes == TIMEOUT, boards.robots)
        truncated &= ~boards.arrived.reshape(-1)
        rewards = boards.rewards.flatten()
        return self._observations(), rewards, ended & ~truncated, truncated, self._infos()

    def _observations(self) -> np.ndarray:
        return self.boards.observations().reshape(self.num_envs, -1)

    def _infos(self) -> dict[str, Any]:
        boards = self.boards
        outcomes = np.repeat(boards.outcomes, boards.robots)
        values = {
            "outcome": outcomes,
            "is_success": outcomes == SUCCESS,
            "path_length": boards.path_length_cm().reshape(-1),
        }
        everywhere = np.ones(self.num_envs, dtype=bool)
        return values | {f"_{name}": everywhere for name in values}

    def render(self) -> tuple[Any, ...] | None:
        """One picture per row, that of its board; targets are those of the scenario's cells."""
        self._require_open()
        if self.render_mode is None:
            return None
        draw, boards = board_text if self.render_mode == "ansi" else board_pixels, self.boards
        pictures = []
        for m, positions in enumerate(boards.positions_m()):
            cells = (boards.targets_m(m) // boards.scenario.cell_m).astype(int)
            scene = replace(boards.scenario, targets=tuple((int(x), int(y)) for x, y in cells))
            pictures += [draw(scene, positions)] * boards.robots
        return tuple(pictures)

    def close_extras(self, **_: Any) -> None:
        """Free the FMU instances; `reset` opens the environment again."""
        self.boards.close()


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
        self._rows._seed_boards(self.np_random_seed)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin an episode; `starts` (1, 3), `targets` (1, 2) and `mu` can be given as options."""
        super().reset(seed=seed)
        given = {name: [value] for name, value in (options or {}).items()}
        observations, infos = self._rows.reset(seed=seed, options=given)
        self.closed = False
        return observations[0], _first(infos)

    def step(self, action: Any) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Drive for a control interval.

        Raises:
            ActionError: the action is not two finite numbers, or no episode is running.
            ClosedError: the environment is closed.
        """
        self._require_open()
        if self._rows.boards.outcomes[0] != RUNNING:
            raise ActionError("no episode is running; call reset before the next step")
        observations, rewards, terminated, truncated, infos = self._rows.step(np.array([action]))
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


def _first(infos: dict[str, Any]) -> dict[str, Any]:
    return {name: values[0].item() for name, values in infos.items() if name[0] != "_"}

"""One episode in RL steps, on top of the master: observe, act, terminate.

An action aims at the centre of the neighbouring cell and stays in force until the robot gets there
or a time limit passes; policies are asked every RL step, and a robot under way ignores the answer.
RL steps last 2 s, or so little that robots are asked when their moves end.
A cell belongs to the robot with its centre in it; distance class and gradient sign are those of
the cells. Nothing here advances time (that is `cosim.simulation.batch`), learns or records.
"""

import math
from typing import Any

import numpy as np

from cosim.base.arguments import numbers
from cosim.base.errors import UserError, shorten
from cosim.coupling.assembly import SpeedNoise, robot_properties
from cosim.coupling.rl_step import POSES_S, SAMPLED, Decision, Step, decide, sampled_of
from cosim.coupling.signals import RawSamples, Samples, State
from cosim.model.config import CoSimConfig
from cosim.model.outcome import BY_RANK, RUNNING, Outcome
from cosim.model.params import motors_of
from cosim.model.scenario import Cell, Scenario
from cosim.onboard.camera import camera_of, draw_sight
from cosim.onboard.estimation import POSE
from cosim.onboard.features import DIRECTION_COUNT, DIRECTIONS, Observation, distance_thresholds
from cosim.onboard.observing import cells_of, nearest_squared, observe
from cosim.onboard.shield import PARKED, STOPS, plan_margin
from cosim.onboard.steering import (
    DIRECTION,
    DRIVE,
    GOAL_X,
    GOAL_Y,
    HOLD,
    MODE,
    PAST,
    START,
    THROUGH,
)
from cosim.onboard.yielding import NEAREST_FIRST, WAIT, board_of, permitted
from cosim.physics.body_state import PLANE, standing_state
from cosim.physics.contact import floor_margin
from cosim.physics.draws import CAMERA_CHILD, DETOUR_CHILD, draw_world, generator
from cosim.physics.properties import gravity
from cosim.simulation.measures import Measures


class RunningEpisode:
    """One episode in its columns of a co-simulation's state."""

    def __init__(
        self,
        scenario: Scenario,
        config: CoSimConfig,
        state: State,
        columns: slice,
        starts: tuple[Cell, ...],
        seed: np.random.SeedSequence,
        sampled: tuple[int, ...] | None = None,
    ) -> None:
        """Put the robots on their start cells, facing the board's centre row.

        Args:
            seed: of the speed noise, of which every motor gets a child of its own, and of the
                world.
            sampled: indices of the robots with kept signals; by default all of up to
                `SAMPLED`, else the first `SOME`.
        """
        n = scenario.robots
        self.sampled = sampled_of(n) if sampled is None else sampled
        self._taken: list[tuple[Samples, RawSamples, np.ndarray, np.ndarray, np.ndarray]] = []
        self.scenario, self.config = scenario, config
        motors_each = motors_of(config.robot, config.motor)
        self.drawn = draw_world(config.world, motors_each, n, seed)
        down = gravity(config.world, self.drawn, config.motor.g)
        for column, motors in enumerate(self.drawn.motors, columns.start):
            state.properties[:, column] = robot_properties(config, down, motors)
        self._board = board_of(scenario, floor_margin(config.robot, config.world))
        self._thresholds = distance_thresholds(scenario)
        self._targets = np.array(scenario.targets)
        self._columns = columns
        self.bind(state)
        sensor, period_s = config.world.camera, config.timing.control_period_s
        self._estimates[:] = 0.0
        state.cameras[columns] = camera_of(sensor, period_s)
        self._commands[:] = self._shields[:] = 0.0
        self._commands[:, THROUGH] = config.through
        headings_rad = np.empty(n)
        for robot, cell in enumerate(starts):
            x, y = scenario.centre_m(cell)
            # Assumed: robots are set down facing the middle of the board.
            facing = math.copysign(math.pi / 2.0, scenario.size_m[1] / 2.0 - y)
            self._bodies[robot] = standing_state(config.robot, x, y, facing)
            self._estimates[robot, POSE : POSE + 3] = x, y, facing
            headings_rad[robot] = facing
        self._detours = generator(seed, DETOUR_CHILD)
        self.noise = SpeedNoise(config, seed, n)
        self._cameras = [generator(seed, CAMERA_CHILD + robot) for robot in range(n)]
        self._step = self._tick = 0
        self.conflicts = 0
        self._arrived = np.zeros(n, dtype=bool)
        self._moving_since = np.zeros(n, dtype=np.int64)  # ticks
        self._move_limit = config.ticks(config.timing.move_limit_s)
        self._episode_limit = config.ticks(config.timing.episode_limit_s)
        self._action = np.full(n, -1)
        positions_m = self._positions_m()
        self._squared_at_decision = nearest_squared(cells_of(positions_m, self._board.cell_m))
        self.measures = Measures(positions_m, headings_rad, config.timing.control_period_s)
        self.outcome = Outcome.RUNNING
        self.observation = self._observe()

    def bind(self, state: State) -> None:
        """Take the episode's columns of a co-simulation's state for its own."""
        columns = self._columns
        self._bodies, self._commands = state.bodies[:, columns].T, state.commands[columns]
        self._estimates, self._shields = state.estimates[columns], state.shields[columns]
        self._events = state.events[columns]
        motors = self.config.robot.motors_count
        self._speeds = state.outputs[motors : 2 * motors, columns].T

    def __getstate__(self) -> dict[str, Any]:
        """Everything but the columns, which `bind` gives to a copy."""
        views = ("_bodies", "_commands", "_estimates", "_shields", "_events", "_speeds")
        return {name: value for name, value in vars(self).items() if name not in views}

    @property
    def time_s(self) -> float:
        """Simulated time in s."""
        return self._tick * self.config.timing.dt_s

    @property
    def positions_m(self) -> np.ndarray:
        """True centres of the robots, (N, 2)."""
        return self._bodies[:, PLANE].copy()

    @property
    def arrived(self) -> np.ndarray:
        """Which robots have reached their targets, shape (N,), bool."""
        return self._arrived.copy()

    @property
    def shield_stops(self) -> int:
        """Moves that the shield has ended."""
        return int(self._shields[:, STOPS].sum())

    @property
    def awaiting(self) -> np.ndarray:
        """(N,) bool, robots that adopt an action next: they wait for one, or are late."""
        late = self._tick - self._moving_since >= self._move_limit
        return ~self._arrived & (self._at_end() | late)

    def ask(self, policy: Any) -> Decision:
        """Return what a policy decides on what it sees now."""
        return decide(policy, self.observation)

    def begin_step(self, action: Any) -> None:
        """Adopt (N,) directions, as a policy returned them; a robot under way keeps its own."""
        self._decided = self._adopt(self._directions(action))
        self._first_tick = self._tick
        self._was_moving = ~self._at_end()

    def draw_camera(self, sight: np.ndarray) -> None:
        """Draw the camera's frames of an RL step, (M, N, NOISE) of `cosim.onboard.camera`."""
        sensor = self.config.world.camera
        if sensor.rate_hz:
            for robot, rng in enumerate(self._cameras):
                sight[:, robot] = draw_sight(sensor, rng, len(sight))

    def take(self, samples: Samples, raw: RawSamples, periods: int) -> None:
        """Take a stretch of an RL step: samples of all columns, which may be written again."""
        ticks = periods * self.config.ticks_per_period
        samples = Samples._make([signal[:periods, self._columns] for signal in samples])
        raw = RawSamples._make([signal[:ticks, self._columns] for signal in raw])
        self.measures.add(samples)
        path_m, every = samples.position, round(POSES_S / self.config.timing.control_period_s)
        poses = np.empty((0, *path_m.shape[1:2], 7))
        if len(self.sampled) < self.scenario.robots:
            since = self._tick // self.config.ticks_per_period
            rows = slice(-(since + 1) % every, None, every)
            poses = np.concatenate([path_m[rows], samples.quaternion[rows]], axis=2)
        first_m, last_m = path_m[0, :, :2].copy(), path_m[-1, :, :2].copy()
        if len(self.sampled) < self.scenario.robots or self.scenario.robots > SAMPLED:
            chosen = np.array(self.sampled, dtype=int)
            samples = Samples(*(signal[:, chosen] for signal in samples))
            raw = RawSamples(*(signal[:, chosen] for signal in raw))
        self._taken.append((samples, raw, poses, first_m, last_m))

    def pass_periods(self, periods: int) -> None:
        """Count control periods that were simulated."""
        self._tick += periods * self.config.ticks_per_period

    def end_step(self) -> Step:
        """Determine the outcome of the simulation since the step began."""
        in_force, before = self._action.copy(), self.observation
        samples, raw, poses, first_m, _ = self._taken[0]
        if len(self._taken) > 1:
            of_all = list(zip(*self._taken, strict=True))
            samples = Samples(*map(np.concatenate, zip(*of_all[0], strict=True)))
            raw = RawSamples(*map(np.concatenate, zip(*of_all[1], strict=True)))
            poses = np.concatenate(of_all[2])
        moved = self._taken[-1][4] - first_m
        self._taken.clear()
        completed = self._was_moving & self._at_end()
        self.observation = self._observe()
        self._arrived |= self._arriving(completed)
        self._commands[self._arrived, MODE] = HOLD
        self._shields[:, PARKED] = self._arrived
        events = self._events.copy()
        self.outcome = self._judge(max(events.tolist()))
        step = Step(
            number=self._step,
            first_tick=self._first_tick,
            before=before,
            after=self.observation,
            action=in_force,
            decided=self._decided,
            completed=completed,
            samples=samples,
            raw=raw,
            events=events,
            outcome=self.outcome,
            duration_s=(self._tick - self._first_tick) * self.config.timing.dt_s,
            moved_m=np.linalg.norm(moved, axis=1),
            sampled=self.sampled,
            poses=poses,
        )
        self._step += 1
        return step

    def _arriving(self, completed: np.ndarray) -> np.ndarray:
        """(N,) bool, robots that ended their move on their target, wherever they think they are."""
        where = cells_of(self.positions_m, self._board.cell_m)
        return completed & (where == self._targets).all(axis=1)

    def _directions(self, action: Any) -> np.ndarray:
        n = self.scenario.robots
        directions = numbers(action, (n,), "iu")
        if directions is None or not 0 <= directions.min() <= directions.max() < DIRECTION_COUNT:
            raise UserError(
                f"the policy returned {shorten(action)}; expected {n} integers from 0 to "
                f"{DIRECTION_COUNT - 1}, the direction of each robot"
            )
        return directions

    def _adopt(self, action: np.ndarray) -> np.ndarray:
        """Give fresh commands to the robots that wait or are late; returns which, (N,) bool."""
        commands, cells = self._commands, cells_of(self._positions_m(), self._board.cell_m)
        decided = self.awaiting
        squared = nearest_squared(cells)
        for robot in np.flatnonzero(decided):
            before, direction = self._action[robot], self._permitted(int(robot), int(action[robot]))
            self._action[robot] = direction
            if direction == WAIT:
                commands[robot, MODE] = HOLD
                decided[robot] = False
                continue
            column, row = (cells[robot] + DIRECTIONS[direction]).tolist()
            commands[robot, GOAL_X : GOAL_Y + 1] = self.scenario.centre_m((column, row))
            commands[robot, DIRECTION] = direction * 2.0 * math.pi / DIRECTION_COUNT
            on = commands[robot, MODE] == PAST and direction == before
            commands[robot, MODE] = DRIVE if on else START
            self._moving_since[robot] = self._tick
            self._squared_at_decision[robot] = squared[robot]
        self._action[self._arrived] = -1
        return decided

    def _at_end(self) -> np.ndarray:
        """Which robots wait for a decision, (N,) bool."""
        mode = self._commands[:, MODE]
        return (mode == HOLD) | (mode == PAST)

    def _permitted(self, robot: int, direction: int) -> int:
        """Return the direction that the shield permits instead of one; WAIT to stand."""
        if not self.config.shield:
            return direction
        goals = self._commands[:, GOAL_X : GOAL_Y + 1].copy()
        goals[self._commands[:, MODE] == HOLD] = np.nan
        goals[robot] = np.nan
        margin_m = plan_margin(self._estimates, self.config.shield)
        asked = self._board, self._positions_m(), goals, robot, direction, margin_m
        allowed = permitted(*asked, NEAREST_FIRST)
        self.conflicts += allowed != direction
        if allowed not in (direction, WAIT) and self._detours.random() < 0.5:
            # Robots that only ever yield to the nearest side may do so to each other endlessly.
            others = NEAREST_FIRST[1:][self._detours.random(len(NEAREST_FIRST) - 1).argsort()]
            allowed = permitted(*asked, np.concatenate([NEAREST_FIRST[:1], others]))
        return allowed

    def _positions_m(self) -> np.ndarray:
        """Return the estimated positions of the robots, (N, 2)."""
        positions_m = self._estimates[:, POSE : POSE + 2].copy()
        if self.config.world.camera.rate_hz:
            # No robot that is asked estimates itself off the board.
            positions_m = positions_m.clip(0.0, np.nextafter(self.scenario.size_m, 0.0))
        return positions_m

    def _observe(self) -> Observation:
        seen = observe(
            self._positions_m(),
            self._estimates[:, POSE + 2].copy(),
            self._board.cell_m,
            self._thresholds,
            self._squared_at_decision,
            self._targets,
        )
        goals = cells_of(self._commands[:, GOAL_X : GOAL_Y + 1].copy(), self._board.cell_m)
        return seen._replace(goals=np.where(self._at_end()[:, None], seen.cells, goals))

    def _judge(self, event: int) -> Outcome:
        if event == RUNNING and all(self._arrived.tolist()):
            return Outcome.SUCCESS
        if event == RUNNING and self._tick >= self._episode_limit:
            return Outcome.TIMEOUT
        return BY_RANK[event]

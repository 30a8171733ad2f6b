"""One episode in RL steps, on top of the master: observe, act, terminate.

An action aims at the centre of the neighbouring cell and stays in force until the robot gets there
or a time limit passes; policies are asked every RL step, and a robot under way ignores the answer.
RL steps last 2 s, or so little that robots are asked when their moves end.
A cell belongs to the robot with its centre in it; distance class and gradient sign are those of
the cells. Nothing here advances time (that is `cosim.simulation.batch`), learns or records.
"""

from typing import Any

import numpy as np

from cosim.base.arguments import numbers
from cosim.base.errors import UserError, shorten
from cosim.coupling.assembly import SpeedNoise, robot_properties
from cosim.coupling.rl_step import POSES_S, SAMPLED, Decision, Step, decide, sampled_of
from cosim.coupling.signals import RawSamples, Samples, State
from cosim.model.config import CoSimConfig
from cosim.model.outcome import BY_RANK, Outcome
from cosim.model.params import motors_of
from cosim.model.scenario import Cell, Scenario
from cosim.onboard.camera import camera_of, draw_sight
from cosim.onboard.estimation import POSE
from cosim.onboard.features import DIRECTION_COUNT, Observation
from cosim.onboard.state import STOPS
from cosim.onboard.steering import THROUGH
from cosim.physics.body_state import PLANE
from cosim.physics.draws import CAMERA_CHILD, DETOUR_CHILD, draw_world, generator
from cosim.physics.properties import gravity, write_own
from cosim.simulation import rules
from cosim.simulation.measures import Measures


class RunningEpisode:
    """One episode in its columns of a co-simulation's state."""

    _driven = False  # whether robots arrive wherever they are at the end of an RL step

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
        down = gravity(config.world.floor_tilt_deg, self.drawn.tilt_direction_deg, config.motor.g)
        state.bodies.properties[:, columns] = robot_properties(config)[:, None]
        for column, motors in enumerate(self.drawn.motors, columns.start):
            write_own(state.bodies.properties, column, down, np.array([(m.r, m.J) for m in motors]))
        self.rules = rules.rules_of(scenario, config)
        self.moves = rules.new_moves(np.array(scenario.targets))
        self._columns = columns
        self.bind(state)
        onboard, period_s = state.onboard, config.timing.control_period_s
        onboard.cameras[columns] = camera_of(config.world.camera, period_s)
        onboard.estimates[columns] = onboard.commands[columns] = onboard.shields[columns] = 0.0
        onboard.commands[columns, THROUGH] = config.through
        rules.put_down(self.rules, self._robots, self.moves, np.array(starts))
        self._detours = generator(seed, DETOUR_CHILD)
        self.noise = SpeedNoise(config, seed, n)
        self._cameras = [generator(seed, CAMERA_CHILD + robot) for robot in range(n)]
        self._step = 0
        headings_rad = onboard.estimates[columns, POSE + 2].copy()
        self.measures = Measures(self.positions_m, headings_rad, period_s)
        self.outcome = Outcome.RUNNING
        self.observation = self._observation()

    def bind(self, state: State) -> None:
        """Take the episode's columns of a co-simulation's state for its own."""
        self._robots = rules.robots_of(state, self._columns.start)
        motors = len(self.config.robot.motors)
        self._speeds = state.motors.outputs[motors : 2 * motors, self._columns].T

    def __getstate__(self) -> dict[str, Any]:
        """Everything but the columns, which `bind` gives to a copy."""
        return {n: value for n, value in vars(self).items() if n not in ("_robots", "_speeds")}

    @property
    def time_s(self) -> float:
        """Simulated time in s."""
        return self._tick * self.config.timing.dt_s

    @property
    def positions_m(self) -> np.ndarray:
        """True centres of the robots, (N, 2)."""
        return self._robots.bodies[PLANE, self._columns].T.copy()

    @property
    def arrived(self) -> np.ndarray:
        """Which robots have reached their targets, shape (N,), bool."""
        return self.moves.arrived.copy()

    @property
    def shield_stops(self) -> int:
        """Moves that the shield has ended."""
        return int(self._robots.shields[self._columns, STOPS].sum())

    @property
    def awaiting(self) -> np.ndarray:
        """(N,) bool, robots that adopt an action next: they wait for one, or are late."""
        return self.moves.awaiting.copy()

    @property
    def conflicts(self) -> int:
        """Moves that the shield has changed."""
        return int(self.moves.counts[rules.CONFLICTS])

    @property
    def _tick(self) -> int:
        return int(self.moves.counts[rules.TICK])

    def ask(self, policy: Any) -> Decision:
        """Return what a policy decides on what it sees now."""
        return decide(policy, self.observation)

    def begin_step(self, action: Any) -> None:
        """Adopt (N,) directions, as a policy returned them; a robot under way keeps its own."""
        self._first_tick = self._tick
        self._adopt(self._directions(action))

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
        self.moves.counts[rules.TICK] += periods * self.config.ticks_per_period

    def end_step(self) -> Step:
        """Determine the outcome of the simulation since the step began."""
        before, moves = self.observation, self.moves
        samples, raw, poses, first_m, _ = self._taken[0]
        if len(self._taken) > 1:
            of_all = list(zip(*self._taken, strict=True))
            samples = Samples(*map(np.concatenate, zip(*of_all[0], strict=True)))
            raw = RawSamples(*map(np.concatenate, zip(*of_all[1], strict=True)))
            poses = np.concatenate(of_all[2])
        moved = self._taken[-1][4] - first_m
        self._taken.clear()
        self.outcome = BY_RANK[rules.conclude(self.rules, self._robots, moves, self._driven)]
        self.observation = self._observation()
        step = Step(
            number=self._step,
            first_tick=self._first_tick,
            before=before,
            after=self.observation,
            action=moves.action.copy(),
            decided=moves.decided.copy(),
            completed=moves.completed.copy(),
            samples=samples,
            raw=raw,
            events=self._robots.events[self._columns].copy(),
            outcome=self.outcome,
            duration_s=(self._tick - self._first_tick) * self.config.timing.dt_s,
            moved_m=np.linalg.norm(moved, axis=1),
            sampled=self.sampled,
            poses=poses,
        )
        self._step += 1
        return step

    def _directions(self, action: Any) -> np.ndarray:
        n = self.scenario.robots
        directions = numbers(action, (n,), "iu")
        if directions is None or not 0 <= directions.min() <= directions.max() < DIRECTION_COUNT:
            raise UserError(
                f"the policy returned {shorten(action)}; expected {n} integers from 0 to "
                f"{DIRECTION_COUNT - 1}, the direction of each robot"
            )
        return directions

    def _adopt(self, action: np.ndarray) -> None:
        """Give fresh commands to the robots that wait or are late."""
        moves, wanted = self.moves, np.ascontiguousarray(action, dtype=np.int64)
        if self.config.shield and (used := int(moves.counts[rules.USED])):
            left = len(moves.detours) - used
            moves.detours[:left] = moves.detours[used:]
            self._detours.random(out=moves.detours[left:])
            moves.counts[rules.USED] = 0
        rules.adopt(self.rules, self._robots, moves, wanted, self.config.shield)

    def _observation(self) -> Observation:
        return Observation(*(array.copy() for array in self.moves.seen))

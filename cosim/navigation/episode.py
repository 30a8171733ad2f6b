"""RL steps of 2 s on top of the master: observe, act, terminate.

An action aims at the centre of the neighbouring cell and stays in force until the robot gets there
or a time limit passes; policies are asked every RL step, and a robot under way ignores the answer.
A cell belongs to the robot whose centre is in it; distance class and gradient sign are those of
the cells. Nothing here learns or records.
"""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np

from cosim.base.config import ConfigError, CoSimConfig
from cosim.base.outcome import BY_RANK, RUNNING, Outcome
from cosim.base.params import SAFETY_MARGIN_M
from cosim.base.scenario import Cell, Scenario
from cosim.coupling.adaptive import AdaptiveDriver
from cosim.coupling.assembly import (
    MOTOR_NAMES,
    check_motors,
    draw_noise,
    new_motors,
    new_plant,
    noise_generators,
)
from cosim.coupling.fmu import Motor, MotorFmu
from cosim.coupling.master import CompiledDriver, Driver, ReferenceDriver
from cosim.coupling.signals import RawSamples, Samples, new_raw_samples, new_samples, new_state
from cosim.coupling.steering import DIRECTION, GOAL_X, GOAL_Y, HOLD, MODE, START
from cosim.navigation.features import (
    DIRECTION_COUNT,
    DIRECTIONS,
    Observation,
    distance_thresholds,
)
from cosim.navigation.measures import Measures
from cosim.navigation.observing import cells_of, nearest_squared, observe
from cosim.navigation.safety import WAIT, board_of, permitted
from cosim.physics.body import POSITION, QUATERNION, standing_state

DRIVERS: dict[str, Callable[[list[Motor]], Driver]] = {
    "compiled": CompiledDriver,
    "reference": ReferenceDriver,
    "adaptive": AdaptiveDriver,
}


class SupportsAct(Protocol):
    """What the co-simulation needs of an agent."""

    def act(self, observation: Observation) -> np.ndarray:
        """Direction index of each robot, shape (N,)."""
        ...


class Step(NamedTuple):
    """One RL step of the co-simulation.

    Attributes:
        number: of the step, from 0.
        first_tick: ticks of dt before the step.
        before, after: observations at its start and end.
        action: (N,) direction index in force during the step, −1 for a robot that arrived before
            or that the safety layer lets wait.
        decided: (N,) whether the action was adopted at the start of this step.
        completed: (N,) whether the robot ended its move within this step.
        samples: signals at every control period that was simulated.
        raw: signals at every tick of the burst at the start of the step.
        events: (N,) what became of each robot: RUNNING, COLLISION or OUT_OF_BOARD of
            `cosim.base.outcome`.
        outcome: of the episode, RUNNING while it goes on.
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


class CoSimulation:
    """Robots, motors and floor of one scenario, advanced in RL steps.

    Attributes:
        scenario, config: as given; by default the default parameters, uncalibrated, with robots of
            the scenario's diameter.
        outcome: of the episode, RUNNING before its end.
        time_s: simulated time.
        measures: of the episode so far.
        conflicts: decisions that the safety layer changed, or would have changed.

    Raises:
        ConfigError: the robot's diameter is not the scenario's.
        FmuError: the FMU cannot be loaded, lacks a part of the motor interface, or a capability
            that the driver needs.
    """

    def __init__(
        self,
        scenario: Scenario,
        motor_fmu: Path,
        config: CoSimConfig | None = None,
        driver: str = "compiled",
    ) -> None:
        self.scenario = scenario
        self.config = config or CoSimConfig().sized(scenario.robot_diameter_m)
        if self.config.robot.diameter_m != scenario.robot_diameter_m:
            raise ConfigError(
                f"diameter_m = {self.config.robot.diameter_m:g} of the configuration is not "
                f"robot_diameter_m = {scenario.robot_diameter_m:g} of scenario {scenario.name}; "
                "use config.sized(scenario.robot_diameter_m)"
            )
        self._fmu = MotorFmu(motor_fmu)
        check_motors(self._fmu, self.config, scenario.robots, adaptive=driver == "adaptive")
        self._driver_class = DRIVERS[driver]
        self._driver: Any = None
        self._board = board_of(scenario)
        self._thresholds = distance_thresholds(scenario)
        self._targets = np.array(scenario.targets)
        self._plant = new_plant(
            self.config,
            scenario.size_m,
            end_on_collision=self.config.on_collision == "end",
        )

    def compile(self) -> None:
        """Compile the kernels, or load them from the cache, by simulating nothing."""
        starts = tuple(cells[0] for cells in self.scenario.starts)
        self.reset(starts, np.random.SeedSequence(0))
        n = self.scenario.robots
        samples = new_samples(2, n)
        self._driver.advance(
            self._plant,
            self._state,
            np.zeros((0, n, len(MOTOR_NAMES))),
            samples,
            new_raw_samples(0, n),
            0,
        )
        self._permitted(0, 0)
        self.measures.add(samples)
        self.close()

    def reset(self, starts: tuple[Cell, ...], seed: np.random.SeedSequence) -> Observation:
        """Put the robots on their start cells, facing the board's centre row, motors at rest.

        Args:
            starts: start cell of each robot.
            seed: of the speed noise; every motor gets a child of its own.
        """
        n = self.scenario.robots
        self.close()
        self._state = new_state(n, self._board.obstacles)
        for robot, cell in enumerate(starts):
            x, y = self.scenario.centre_m(cell)
            # Assumed: robots are set down facing the middle of the board.
            facing = math.copysign(math.pi / 2.0, self.scenario.size_m[1] / 2.0 - y)
            self._state.bodies[robot] = standing_state(self.config.robot, x, y, facing)
        self._driver = self._driver_class(new_motors(self._fmu, self.config, n))
        self._noise = noise_generators(seed, n)
        self._step = self._tick = 0
        self.conflicts = 0
        self._arrived = np.zeros(n, dtype=bool)
        self._moving_since = np.zeros(n)
        self._action = np.full(n, -1)
        positions_m = self._positions_m()
        self._squared_at_decision = nearest_squared(cells_of(positions_m, self._board.cell_m))
        self.measures = Measures(positions_m, self.config.timing.control_period_s)
        self.outcome = Outcome.RUNNING
        self._observation = self._observe()
        return self._observation

    @property
    def time_s(self) -> float:
        """Simulated time in s."""
        return self._tick * self.config.timing.dt_s

    @property
    def arrived(self) -> np.ndarray:
        """Which robots have reached their targets, shape (N,), bool."""
        return self._arrived.copy()

    def advance(self, action: np.ndarray) -> Step:
        """Simulate one RL step.

        Args:
            action: (N,) direction index of each robot; a robot under way keeps its own.

        Raises:
            FmuError: an FMU failed; names the instance and the time.
        """
        before, state = self._observation, self._state
        decided = self._adopt(action)
        in_force = self._action.copy()
        periods = self.config.periods_per_step
        samples = new_samples(periods, self.scenario.robots)
        burst = round(self.config.timing.burst_s / self.config.timing.dt_s)
        raw = new_raw_samples(
            min(burst, periods * self.config.ticks_per_period), self.scenario.robots
        )
        was_moving = state.commands[:, MODE] != HOLD
        first_tick = self._tick
        done, event = self._driver.advance(
            self._plant, state, self._draw_noise(periods), samples, raw, first_tick
        )
        self._tick += done * self.config.ticks_per_period
        samples = Samples(*(signal[:done] for signal in samples))
        raw = RawSamples(*(signal[: done * self.config.ticks_per_period] for signal in raw))
        self.measures.add(samples)

        completed = was_moving & (state.commands[:, MODE] == HOLD)
        self._observation = self._observe()
        self._arrived |= completed & (self._observation.cells == self._targets).all(axis=1)
        self.outcome = self._judge(event)
        step = Step(
            self._step,
            first_tick,
            before,
            self._observation,
            in_force,
            decided,
            completed,
            samples,
            raw,
            state.events.copy(),
            self.outcome,
        )
        self._step += 1
        return step

    def close(self) -> None:
        """Free the FMU instances."""
        if self._driver is not None:
            for motor in self._driver.motors:
                motor.close()
            self._driver = None

    def _adopt(self, action: np.ndarray) -> np.ndarray:
        """Give fresh commands to the robots that wait or are late; returns which, (N,) bool."""
        commands, cells = self._state.commands, self._observation.cells
        late = self.time_s - self._moving_since >= self.config.timing.move_limit_s
        decided = ~self._arrived & ((commands[:, MODE] == HOLD) | late)
        squared = nearest_squared(cells)
        for robot in np.flatnonzero(decided):
            direction = self._permitted(int(robot), int(action[robot]))
            self._action[robot] = direction
            if direction == WAIT:
                commands[robot, MODE] = HOLD
                decided[robot] = False
                continue
            column, row = (cells[robot] + DIRECTIONS[direction]).tolist()
            commands[robot, GOAL_X : GOAL_Y + 1] = self.scenario.centre_m((column, row))
            commands[robot, DIRECTION] = direction * 2.0 * math.pi / DIRECTION_COUNT
            commands[robot, MODE] = START
            self._moving_since[robot] = self.time_s
            self._squared_at_decision[robot] = squared[robot]
        self._action[self._arrived] = -1
        return decided

    def _permitted(self, robot: int, direction: int) -> int:
        """What the safety layer makes of a direction; without the layer it is only counted."""
        commands, margin_m = self._state.commands, self.config.safety_margin_m
        goals = commands[:, GOAL_X : GOAL_Y + 1].copy()
        goals[commands[:, MODE] == HOLD] = np.nan
        goals[robot] = np.nan
        allowed = permitted(
            self._board,
            self._positions_m(),
            goals,
            robot,
            direction,
            margin_m or SAFETY_MARGIN_M,
        )
        self.conflicts += allowed != direction
        return allowed if margin_m else direction

    def _draw_noise(self, periods: int) -> np.ndarray:
        nominal_rad_s = self.config.steering.forward_speed_rad_s
        return draw_noise(self.config, self._noise, nominal_rad_s, periods)

    def _positions_m(self) -> np.ndarray:
        return self._state.bodies[:, POSITION][:, :2].copy()

    def _observe(self) -> Observation:
        return observe(
            self._positions_m(),
            self._state.bodies[:, QUATERNION].copy(),
            self._board.cell_m,
            self._thresholds,
            self._squared_at_decision,
        )

    def _judge(self, event: int) -> Outcome:
        if event == RUNNING and self._arrived.all():
            return Outcome.SUCCESS
        if event == RUNNING and self.time_s >= self.config.timing.episode_limit_s:
            return Outcome.TIMEOUT
        return BY_RANK[event]


def run_episode(
    system: CoSimulation,
    policy: SupportsAct,
    starts: tuple[Cell, ...],
    seed: np.random.SeedSequence,
    observe_step: Callable[[Step], None],
) -> Outcome:
    """Run one episode and return its outcome; `observe_step` sees every RL step."""
    observation = system.reset(starts, seed)
    while not system.outcome:
        step = system.advance(policy.act(observation))
        observation = step.after
        observe_step(step)
    return system.outcome

"""A co-simulation's parts made from its parameters: plant, motors, speed noise.

What episodes on a board and trials of single robots have in common; nothing here advances time.
"""

import copy
import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from cosim.base.jit import kernel
from cosim.coupling.plant import Plant
from cosim.fmi.calls import FMI_ERROR, Addresses, Calls
from cosim.fmi.fmu import FmuError
from cosim.fmi.motor import INPUTS, PHASE, SAMPLED, Motor, MotorFmu
from cosim.model.config import CoSimConfig, whole_ratio
from cosim.model.params import (
    SHIELD,
    TABLE_II,
    MotorParams,
    level_share,
    motor_names,
    motors_of,
    open_loop_voltage,
)
from cosim.physics.collision import FASTEST_M_S, PairParams
from cosim.physics.contact import paired
from cosim.physics.draws import generator
from cosim.physics.forces import motor_mounts
from cosim.physics.properties import body_params, properties_of
from cosim.physics.rotation import Vector


def new_plant(
    config: CoSimConfig,
    robots: int,
    *,
    end_on_collision: bool,
    motors: Sequence[MotorParams] | None = None,
) -> Plant:
    """Constants of the coupled system for episodes of some robots each.

    Args:
        motors: of a robot, by default those of the configuration.
    """
    steering = config.steering
    if "heading" in config.open_loop:
        steering = steering._replace(max_difference_rad_s=0.0, turn_again_rad=math.inf)
    robot = config.robot
    each = motors or motors_of(robot, config.motor)
    mounts = motor_mounts(robot._replace(com_height_m=0.0), each)
    pairing = paired([mount.place_m[:2] for mount in robot.motors])
    return Plant(
        robots=robots,
        body=body_params(config.robot, config.motor, config.timing.dt_s),
        motors=pairing,
        mounts=tuple(mounts[k] for k in pairing.order),
        steering=steering,
        estimator=config.estimator,
        shield=config.shield or SHIELD,
        shielded=config.shield is not None,
        pair=PairParams(
            config.robot.diameter_m,
            config.robot.mu_robots,
            near=2.0 * FASTEST_M_S * config.timing.control_period_s,
        ),
        end_on_collision=end_on_collision,
        ticks_per_period=config.ticks_per_period,
        ticks_per_step=config.ticks_per_step,
        reaction=config.reaction,
        open_loop=config.voltage_driven,
        voltages=tuple(map(open_loop_voltage, each)),
    )


def robot_properties(
    config: CoSimConfig,
    gravity: Vector | None = None,
    motors: Sequence[MotorParams] | None = None,
) -> np.ndarray:
    """Return a robot's column of `State.properties`; gravity (m/s²) in the frame of the floor."""
    robot, dt_s = config.robot, config.timing.dt_s
    motors = motors or motors_of(robot, config.motor)
    return properties_of(
        body_params(robot, config.motor, dt_s, gravity=gravity, world=config.world),
        motor_mounts(robot, motors),
    )


def check_motors(fmu: MotorFmu, config: CoSimConfig, robots: int) -> None:
    """Refuse an FMU without a capability that a run of some robots needs."""
    motors, can = robots * len(config.robot.motors), fmu.interface
    if motors > 1 and can.canBeInstantiatedOnlyOncePerProcess:
        raise fmu.refusal(
            f"has canBeInstantiatedOnlyOncePerProcess, and {motors} motors are needed at once; "
            "export it without"
        )
    if can.fixedInternalStepSize is not None:
        internal_s, name = float(can.fixedInternalStepSize), "fixedInternalStepSize"
        if not internal_s > 0.0:
            raise fmu.refusal(f"has {name} = {internal_s:g}; export it with a positive one")
        step_s = config.timing.communication_step_s
        whole_ratio("communication_step_s", step_s, f"{name} of motor FMU {fmu.path}", internal_s)


def why_not_fmpy(fmu: MotorFmu, config: CoSimConfig) -> str | None:
    """Return why motors cannot be stepped once per control period; None if they can."""
    if config.reaction:
        return "with --reaction motors and bodies act on each other in every communication step"
    if not fmu.samples:
        return f"motor FMU {fmu.path} has no {', '.join(SAMPLED)} for it"
    step_s, internal_s = config.timing.communication_step_s, fmu.internal_step_s or math.inf
    if step_s > internal_s and abs(math.remainder(step_s / internal_s, 1.0)) > 1e-6:
        return (
            f"its communication step {step_s:g} s is not a multiple of step_size = {internal_s:g} s"
        )
    return None


def _differences(motor: MotorParams, usual: MotorParams) -> dict[str, float]:
    return {name: value for name, value in motor._asdict().items() if value != getattr(usual, name)}


class Motors:
    """The motors of all robots: an FMU instance each, or one instance with all of them as arrays.

    Signals are arrays (3 M, B), or (4 M, B), of M motors of each robot, see
    `cosim.coupling.signals.State`. No motor is there before its robot's first `restart`. An FMU
    that fails raises an FmuError with instance and time.
    """

    def __init__(
        self, fmu: MotorFmu, config: CoSimConfig, columns: int, *, sampled: bool = False
    ) -> None:
        """Prepare the motors of some columns, with the parameters of a configuration.

        Args:
            sampled: whether the FMU is stepped by whole control periods, and returns samples
                at the ends of the communication steps in them.
        """
        if config.voltage_driven:
            fmu = MotorFmu(fmu.path, open_loop=True)
        self._fmu = fmu
        self._usual = config.motor
        own = config.motor if config.motor_fmu else TABLE_II  # what the FMU has without a word
        self._parameters = _differences(config.motor, own) | dict(config.motor_parameters)
        count = config.ticks_per_period // config.ticks_per_step
        self._sampling = (count, config.timing.communication_step_s) if sampled else None
        self._motors = motors = len(config.robot.motors)
        self._level = [level_share(mount.axis) for mount in config.robot.motors]
        self._instances: list[Motor | None] = [None] * (1 if fmu.arrays else motors * columns)
        self._runs = np.zeros(motors * columns, dtype=np.int64)  # of all first motors, and so on
        # Usual and present values (M, B) of the parameters that some motor of the arrays has had
        # for itself.
        self._own: dict[str, tuple[np.ndarray, np.ndarray]] = {}
        self._start = np.zeros(0)  # of an instance of arrays, see `restart`
        self.calls = Calls(
            motors,
            np.zeros(len(self._instances), dtype=np.int64),
            np.zeros(len(self._instances), dtype=np.int64),
            np.zeros(max(len(INPUTS), len(fmu.electrical))),
            Addresses(0, 0, 0),
            fmu.inputs,
            fmu.outputs,
            fmu.electrical,
            step_period=0,
            sampled=np.zeros((0, columns)),
            sampled_references=fmu.sampled if sampled else np.zeros(0, dtype=np.uint32),
        )

    @property
    def array(self) -> Motor | None:
        """The instance of all motors; None before the first `restart`."""
        return self._instances[0]

    def restart(
        self,
        columns: Sequence[int],
        parameters: Sequence[tuple[MotorParams, ...]],
        phases: np.ndarray | None = None,
    ) -> np.ndarray:
        """Bring the motors of an episode's robots to their start, in the order of the robots.

        Returns theta and omega there, (2 M, robots).

        Args:
            parameters: of each robot's motors. One that is the configuration's leaves an FMU what
                it began with.
            phases: (robots, M) rad at which motors begin; NaN, and by default all, as the
                FMU says.
        """
        if phases is None:
            phases = np.full((len(columns), self._motors), np.nan)
        start = np.zeros((2, self._motors, len(columns)))
        felt = [
            [own._replace(g=level * own.g) for level, own in zip(self._level, motors, strict=True)]
            for motors in parameters
        ]
        if self._fmu.arrays:
            instance = self._instances[0] or self._put(0, "motors", {}, len(self._runs))
            start[:] = self._start[:, :, columns]
            for name in MotorParams._fields:
                values = np.array([[getattr(p, name) for p in motors] for motors in felt]).T
                self._tune(instance, columns, name, values, values == getattr(self._usual, name))
            self._tune(instance, columns, PHASE, phases.T, np.isnan(phases.T))
            self._runs.reshape(self._motors, -1)[:, columns] += 1
            instance.restart(self._runs)
            start[0] = np.where(np.isnan(phases.T), start[0], phases.T)
            return start.reshape(-1, len(columns))
        names = motor_names(self._motors)
        for robot, (column, motors) in enumerate(zip(columns, felt, strict=True)):
            for motor, (name, own) in enumerate(zip(names, motors, strict=True)):
                values = _differences(own, self._usual)
                if not math.isnan(phase := float(phases[robot, motor])):
                    values[PHASE] = phase
                instance = self._put(self._motors * column + motor, f"r{robot + 1}.{name}", values)
                start[:, motor, robot] = instance.get(self._fmu.outputs)[:2]
        return start.reshape(-1, len(columns))

    def _tune(
        self,
        motors: Motor,
        columns: Sequence[int],
        name: str,
        values: np.ndarray,
        at_usual: np.ndarray,
    ) -> None:
        """Give some columns' motors their values (M, columns) of a parameter, or the usual ones."""
        if name not in self._own:
            if at_usual.all():
                return
            found = motors.get([self._fmu.parameter(name, tunable=True)])
            usual = np.reshape(found, (self._motors, -1))
            self._own[name] = usual, usual.copy()
        usual, present = self._own[name]
        values = np.where(at_usual, usual[:, columns], values)
        if (present[:, columns] != values).any():
            present[:, columns] = values
            motors.set([self._fmu.parameter(name, tunable=True)], present.reshape(-1))

    def _put(
        self, place: int, name: str, parameters: Mapping[str, float], motors: int = 1
    ) -> Motor:
        """Put a new instance in a place, after what was there has ended."""
        self._end(place)
        values = {**self._parameters, **parameters}
        motor = Motor(self._fmu, name, values, motors, self._sampling)
        self._instances[place] = motor
        self.calls.instances[place], self.calls.ticks[place] = motor.address, 0
        self.calls = self.calls._replace(functions=motor.functions)
        if self._fmu.arrays:
            self._start = np.reshape(motor.get(self._fmu.outputs), (3, self._motors, -1))[:2]
        return motor

    def set_inputs(self, signals: np.ndarray, dt_s: float) -> None:
        """Set INPUTS from (3 M, B) values."""
        for motor, values, time_s in self._each(signals, len(INPUTS), dt_s):
            motor.set(self._fmu.inputs, values.reshape(-1), time_s)

    def get_outputs(self, signals: np.ndarray, dt_s: float) -> None:
        """Write OUTPUTS to (3 M, B)."""
        self._get(self._fmu.outputs, signals, dt_s)

    def get_electrical(self, signals: np.ndarray, dt_s: float) -> None:
        """Write ELECTRICAL and LOOP to (4 M, B)."""
        self._get(self._fmu.electrical, signals, dt_s)

    def _get(self, references: np.ndarray, signals: np.ndarray, dt_s: float) -> None:
        count = len(references)
        for motor, values, time_s in self._each(signals[: self._motors * count], count, dt_s):
            values[:] = np.reshape(motor.get(references, time_s), values.shape)

    def _each(
        self, signals: np.ndarray, count: int, dt_s: float
    ) -> Iterator[tuple[Motor, np.ndarray, float]]:
        """Every instance with its part (count, motors of it) of the signals, and its time in s."""
        by_motor, motors = signals.reshape(count, self._motors, -1), self._motors
        for place, motor in self._running():
            own = by_motor[:, place % motors, place // motors, None]
            mine = by_motor if self._fmu.arrays else own
            yield motor, mine, int(self.calls.ticks[place]) * dt_s

    def _running(self) -> Iterator[tuple[int, Motor]]:
        return ((k, motor) for k, motor in enumerate(self._instances) if motor is not None)

    def step(self, count: int, dt_s: float) -> None:
        """Step over `count` ticks."""
        for place, motor in self._running():
            motor.step(int(self.calls.ticks[place]) * dt_s, count * dt_s)
            self.calls.ticks[place] += count

    def get_state(self) -> tuple[Any, ...]:
        """Return what `set_state` restores the motors from, here or in another process."""
        states = [motor and motor.get_state() for motor in self._instances]
        return states, self.calls.ticks.copy(), self._runs.copy(), copy.deepcopy(self._own)

    def set_state(self, saved: tuple[Any, ...]) -> None:
        """Restore the motors."""
        states, ticks, runs, own = saved
        for place, state in enumerate(states):
            if state is None:
                self._end(place)
                continue
            name, count = ("motors", len(runs)) if self._fmu.arrays else (f"motor {place}", 1)
            motor = self._instances[place] or self._put(place, name, {}, count)
            motor.set_state(state)
        self.calls.ticks[:], self._runs[:], self._own = ticks, runs, copy.deepcopy(own)

    def error(self, place: int, what: str, dt_s: float, status: int = FMI_ERROR) -> FmuError:
        """The error with the failed instance, the time, and the last message of the FMU."""
        motor = self._instances[place]
        assert motor is not None
        return motor.error(self.calls.ticks[place] * dt_s, what, status)

    def close(self) -> None:
        """Free the instances."""
        for place, _ in self._running():
            self._end(place)

    def _end(self, place: int) -> None:
        if (motor := self._instances[place]) is not None:
            motor.close()
            self._instances[place], self.calls.instances[place] = None, 0


class SpeedNoise:
    """Speed noise of N robots over their motors' set points (Section V), drawn as time passes."""

    def __init__(self, config: CoSimConfig, seed: np.random.SeedSequence, robots: int) -> None:
        """Give every motor a generator with a child of the seed."""
        self._motors = len(config.robot.motors)
        children = range(robots * self._motors)
        self._generators = [generator(seed, child) for child in children]
        self.amplitude = config.noise.relative_amplitude
        self.hold = round(config.noise.hold_s / config.timing.control_period_s)
        self._values, self._left = np.zeros(len(children)), np.zeros(1, dtype=np.int64)

    def draw(self, periods: int) -> np.ndarray:
        """Return the noise of the next control periods, shape (periods, N, M)."""
        draws = max(0, math.ceil((periods - self._left[0]) / self.hold))
        uniforms = np.empty((len(self._values), draws))
        for rng, row in zip(self._generators, uniforms, strict=True):
            rng.random(out=row)
        noise = np.empty((periods, len(self._values) // self._motors, self._motors))
        write_noise(noise, uniforms, self.amplitude, self.hold, self._values, self._left)
        return noise


@kernel
def write_noise(
    noise: np.ndarray,
    uniforms: np.ndarray,
    amplitude: float,
    hold: int,
    values: np.ndarray,
    left: np.ndarray,
) -> None:
    """Write the speed noise of the next control periods.

    Args:
        noise: (periods, N or more, M).
        uniforms: (N M, draws) in [0, 1), as many as are needed.
        hold: control periods that a value lasts.
        values: (N M,) in force; updated.
        left: (1,) int64, control periods that they have left; updated.
    """
    periods, motors = noise.shape[0], noise.shape[2]
    rest = left[0]
    for k in range(len(values)):
        value, rest, drawn = values[k], left[0], 0
        for period in range(periods):
            if rest == 0:
                value, rest = (2.0 * uniforms[k, drawn] - 1.0) * amplitude, hold
                drawn += 1
            noise[period, k // motors, k % motors] = value
            rest -= 1
        values[k] = value
    left[0] = rest

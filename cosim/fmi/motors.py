"""The motors of all robots of a batch: FMU instances, started, tuned, stepped and kept together.

Nothing here knows bodies.
"""

import copy
import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from cosim.fmi.calls import FMI_ERROR, Addresses, Calls
from cosim.fmi.fmu import FmuError
from cosim.fmi.motor import INPUTS, PHASE, Motor, MotorFmu
from cosim.model.config import CoSimConfig
from cosim.model.params import TABLE_II, MotorParams, level_share, motor_names


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

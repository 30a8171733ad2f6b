"""A co-simulation's parts made from its parameters: plant, motors, speed noise.

What episodes on a board and trials of single robots have in common; nothing here advances time.
"""

import contextlib
import math
from collections.abc import Iterator, Sequence

import numpy as np

from cosim.base.config import CoSimConfig
from cosim.base.params import TABLE_II
from cosim.coupling.calls import Calls
from cosim.coupling.fmu import FmuError, Motor, MotorFmu
from cosim.coupling.interface import ELECTRICAL, INPUTS, OUTPUTS, check_use
from cosim.coupling.plant import Plant
from cosim.physics.body import body_params
from cosim.physics.collision import PairParams
from cosim.physics.forces import motor_mounts

MOTOR_NAMES = ("D", "E")


def new_plant(config: CoSimConfig, robots: int, *, end_on_collision: bool) -> Plant:
    """Constants of the coupled system for episodes of some robots each."""
    return Plant(
        robots,
        body_params(config.robot, config.motor, config.timing.dt_s),
        *motor_mounts(config.robot, config.motor),
        config.steering,
        PairParams(config.robot.diameter_m, config.robot.mu_robots),
        end_on_collision,
        config.ticks_per_period,
        config.ticks_per_step,
        config.order == "jacobi",
        config.reaction,
        config.timing.exchange_tolerance_rad,
    )


def check_motors(
    fmu: MotorFmu, config: CoSimConfig, robots: int, *, adaptive: bool = False
) -> None:
    """Refuse an FMU that cannot do what a run asks of it.

    Args:
        fmu: of every motor.
        config: all parameters.
        robots: their number.
        adaptive: whether communication steps vary, from dt upwards, and are taken back.

    Raises:
        FmuError: it lacks a capability.
        ConfigError: its internal step does not divide the communication step.
    """
    timing = config.timing
    least_step_s = timing.dt_s if adaptive else timing.communication_step_s
    instances = 1 if fmu.arrays else robots * len(MOTOR_NAMES)
    check_use(fmu.path, fmu.interface, instances, least_step_s, adaptive=adaptive)


class Motors:
    """The motors of all robots: an FMU instance each, or one instance with all of them as arrays.

    Signals are arrays (6, B), or (4, B), see `cosim.coupling.signals.State`. No motor is there
    before its robot's first `restart`.
    """

    def __init__(self, fmu: MotorFmu, config: CoSimConfig, columns: int) -> None:
        """Prepare the motors of robots in so many columns, with the parameters of a configuration.

        Raises:
            FmuError: the FMU refuses to load, a parameter, or initialisation.
        """
        self._fmu = fmu
        self._parameters = {
            name: value
            for name, value in config.motor._asdict().items()
            if value != getattr(TABLE_II, name)
        }
        self._columns = columns
        self._instances: dict[int, Motor] = {}  # by the place of their first motor
        self._runs = np.zeros(len(MOTOR_NAMES) * columns, dtype=np.int64)  # of each motor
        self._prepare({})

    def _prepare(self, ticks: dict[int, int]) -> None:
        """Say how compiled code reaches the instances; `ticks` that each has done, if not none."""
        fmu, places = self._fmu, list(self._instances)
        # the addresses of functions are those of the binary, the same for every instance
        some = next(iter(self._instances.values()), None)
        self.calls = Calls(
            np.array([motor.instance for motor in self._instances.values()], dtype=np.int64),
            np.array([ticks.get(place, 0) for place in places], dtype=np.int64),
            np.array(places, dtype=np.int64),
            len(self._runs) if fmu.arrays else 1,
            np.zeros(len(INPUTS)),
            *(some.addresses if some else (0, 0, 0)),
            fmu.inputs,
            fmu.outputs,
            fmu.electrical,
        )

    def restart(self, columns: Sequence[int]) -> None:
        """Bring the motors of an episode's robots to their start, in the order of the robots.

        Raises:
            FmuError: the FMU refuses to load, a parameter, or initialisation.
        """
        places = {
            motor * self._columns + column: f"r{robot + 1}.{name}"
            for robot, column in enumerate(columns)
            for motor, name in enumerate(MOTOR_NAMES)
        }
        if self._fmu.arrays:
            if not self._instances:
                motors = len(self._runs)
                self._instances[0] = self._fmu.instantiate("motors", self._parameters, motors)
                self._prepare({})
            self._runs[list(places)] += 1
            self._instances[0].restart(self._runs)
            return
        ticks = dict(zip(self._instances, self.calls.ticks.tolist(), strict=True))
        for place, name in places.items():
            if place in self._instances:
                self._instances.pop(place).close()
            ticks[place] = 0
            self._instances[place] = self._fmu.instantiate(name, self._parameters)
        self._prepare(ticks)

    def set_inputs(self, signals: np.ndarray, dt_s: float) -> None:
        """Set INPUTS from (6, B) values; raises FmuError naming instance and time."""
        for motor, values, tick in self._each(signals, len(INPUTS)):
            motor.set_inputs(values.reshape(-1), tick, dt_s)

    def get_outputs(self, signals: np.ndarray, dt_s: float) -> None:
        """Write OUTPUTS to (6, B); raises FmuError naming instance and time."""
        for motor, values, tick in self._each(signals, len(OUTPUTS)):
            values[:] = np.reshape(motor.outputs(tick, dt_s), values.shape)

    def get_electrical(self, signals: np.ndarray, dt_s: float) -> None:
        """Write ELECTRICAL to (4, B); raises FmuError naming instance and time."""
        for motor, values, tick in self._each(signals, len(ELECTRICAL)):
            values[:] = np.reshape(motor.electrical(tick, dt_s), values.shape)

    def step(self, count: int, dt_s: float) -> None:
        """Step over `count` ticks; raises FmuError naming instance and time."""
        for k, motor in enumerate(self._instances.values()):
            motor.step(int(self.calls.ticks[k]), count, dt_s)
            self.calls.ticks[k] += count

    def _each(self, signals: np.ndarray, count: int) -> Iterator[tuple[Motor, np.ndarray, int]]:
        """Every instance with its part (count, motors of it) of the signals, and its ticks."""
        rows = signals.reshape(count, -1)
        for motor, place, tick in zip(
            self._instances.values(), self.calls.motors, self.calls.ticks, strict=True
        ):
            yield motor, rows[:, place : place + self.calls.each], int(tick)

    @contextlib.contextmanager
    def rolled_back(self) -> Iterator[None]:
        """On leaving, every instance is where it was on entering; steps in between say so."""
        ticks = self.calls.ticks.copy()
        with contextlib.ExitStack() as stack:
            for motor in self._instances.values():
                stack.enter_context(motor.rolled_back())
            yield
        self.calls.ticks[:] = ticks

    def error(self, instance: int, what: str, dt_s: float) -> FmuError:
        """The error that tells which instance failed, when, and what the FMU said last."""
        motor = list(self._instances.values())[instance]
        return motor.error(self.calls.ticks[instance] * dt_s, what)

    def close(self) -> None:
        """Free the instances."""
        for motor in self._instances.values():
            motor.close()
        self._instances.clear()
        self._prepare({})


def noise_generators(seed: np.random.SeedSequence, robots: int) -> list[np.random.Generator]:
    """One generator of speed noise for every motor, each with a child of the seed."""
    return [np.random.default_rng(child) for child in seed.spawn(robots * len(MOTOR_NAMES))]


def draw_noise(
    config: CoSimConfig,
    generators: list[np.random.Generator],
    nominal_rad_s: np.ndarray | float,
    periods: int,
) -> np.ndarray:
    """Speed noise of N robots (Section V), shape (periods, N, 2), rad/s.

    Args:
        config: amplitude, and time for which a value holds.
        generators: 2 N, see `noise_generators`; each is drawn from.
        nominal_rad_s: nominal motor speed, of all or (N,) of each robot.
        periods: control periods.
    """
    hold = config.periods_per_noise_value
    draws, motors = math.ceil(periods / hold), len(MOTOR_NAMES)
    values = np.empty((len(generators), draws))
    for generator, row in zip(generators, values, strict=True):
        generator.random(out=row)
    values *= 2.0
    values -= 1.0
    amplitude = config.noise.relative_amplitude * np.asarray(nominal_rad_s)
    noise = np.empty((draws, hold, len(generators) // motors, motors))
    np.multiply(values.T.reshape(draws, 1, -1, motors), amplitude.reshape(-1, 1), out=noise)
    return noise.reshape(-1, *noise.shape[2:])[:periods]

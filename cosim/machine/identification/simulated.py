"""Identified parameters, and simulations of a drive with any: what the camera would see."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from cosim.coupling.assembly import Motors, SpeedNoise
from cosim.coupling.signals import MOTORS
from cosim.fmi.motor import MotorFmu
from cosim.machine.identification.motion import Machine, tracks
from cosim.model.config import CoSimConfig
from cosim.model.params import TABLE_I, TABLE_II, MotorParams, RobotParams

LOOKS_S = 0.005  # between simulated poses, which are interpolated
REPEATS, WINDOW_S = 8, 5.0  # of simulations with other noise, and over which they drift apart


class RobotParameter(NamedTuple):
    """A parameter that is identified.

    Attributes:
        name: of a field of `RobotParams`, or as below.
        description: as text.
        unit: for people, and how many of it are one of the SI unit.
        scale: that number.
        spread: standard deviation around the usual value before anything is measured (assumed), in
            SI units as what follows.
        step: of its difference quotients.
        low, high: bounds; the circle of the feet is within the robot too.
    """

    name: str
    description: str
    unit: str
    scale: float
    spread: float
    step: float
    low: float
    high: float


PARAMETERS = (
    RobotParameter("mu", "friction of the feet", "", 1.0, 0.15, 0.004, 0.02, 1.0),
    RobotParameter(
        "com_height_m", "height of the centre of mass", "mm", 1e3, 0.01, 4e-4, 0.004, 0.04
    ),
    RobotParameter(
        "com_x_m", "centre of mass before the axis", "mm", 1e3, 0.003, 2e-4, -0.006, 0.006
    ),
    RobotParameter("com_y_m", "centre of mass to the left", "mm", 1e3, 0.003, 2e-4, -0.006, 0.006),
    RobotParameter("foot_radius_m", "circle of the feet", "mm", 1e3, 0.003, 3e-4, 0.005, 0.1),
    RobotParameter(
        "motor_d", "unbalance of motor 1 (D) over its usual one", "", 1.0, 0.3, 0.01, 0.4, 2
    ),
    RobotParameter(
        "motor_e", "unbalance of motor 2 (E) over its usual one", "", 1.0, 0.3, 0.01, 0.4, 2
    ),
    RobotParameter("camera_delay_s", "delay of the camera", "ms", 1e3, 0.1, 0.03, 0.0, 1.0),
)
NAMES = tuple(parameter.name for parameter in PARAMETERS)
SPREADS, STEPS, _LOW, _HIGH = np.array([p[4:] for p in PARAMETERS], dtype=float).T
_FACTORS = slice(NAMES.index("motor_d"), NAMES.index("camera_delay_s"))
DELAY = NAMES.index("camera_delay_s")


def usual_values(robot: RobotParams = TABLE_I) -> np.ndarray:
    """Values before anything is measured, shape (8,), SI units; a camera's delay is 30 ms."""
    return np.array([*(getattr(robot, name) for name in NAMES[: _FACTORS.start]), 1.0, 1.0, 0.03])


def limits(robot: RobotParams = TABLE_I) -> tuple[np.ndarray, np.ndarray]:
    """Least and largest values, shape (8,) each, SI units."""
    high = _HIGH.copy()
    high[NAMES.index("foot_radius_m")] = 0.499 * robot.diameter_m
    return _LOW, high


def machine(
    values: Sequence[float] | np.ndarray,
    robot: RobotParams = TABLE_I,
    motor: MotorParams = TABLE_II,
) -> Machine:
    """The machine that has some values.

    Args:
        values: in the order of `PARAMETERS`, SI units.
        robot, motor: what is not identified.
    """
    numbers = [float(value) for value in values]
    fields = dict(zip(NAMES[: _FACTORS.start], numbers, strict=False))
    d, e = numbers[_FACTORS]
    return Machine(
        robot._replace(**fields), motor._replace(r=d * motor.r), motor._replace(r=e * motor.r)
    )


@dataclass(frozen=True)
class Simulated:
    """Simulations of one drive.

    Their motors have speed noise of their own: without any, robots near the speed at which they
    begin to move would seem to stand on a more slippery floor.

    Attributes:
        speeds: (P + 1, 2) of the motors in rad/s, with noise.
        smooth: (P + 1, 2) the same without.
        times: (n,) of the frames in s.
        config: clock, and what of robot and motors is not identified.
    """

    speeds: np.ndarray
    smooth: np.ndarray
    times: np.ndarray
    config: CoSimConfig

    def frames(self, values: np.ndarray) -> np.ndarray:
        """Return what the camera would see, from the origin, heading along +x.

        Args:
            values: (C, 8) in the order of `PARAMETERS`, SI units.

        Returns:
            (n, C, 3) x and y in m, heading in rad.
        """
        config = self.config
        machines = [machine(row, config.robot, config.motor) for row in values]
        distinct = list(dict.fromkeys(machines))  # another delay asks for no simulation of its own
        seen = self._tracks(distinct, self.speeds)
        looks = LOOKS_S * np.arange(len(seen))
        found = np.empty((len(self.times), len(values), 3))
        for column, (own, row) in enumerate(zip(machines, values, strict=True)):
            for k, signal in enumerate(seen[:, distinct.index(own)].T):
                found[:, column, k] = np.interp(self.times - row[DELAY], looks, signal)
        return found

    def drifts(self, values: np.ndarray) -> np.ndarray:
        """Estimate how a robot's noise makes its tracks differ, by simulations with other noise.

        Args:
            values: (8,) parameters.

        Returns:
            Growth of the variance of the robot's distance from a simulation: of its place, x and y
            each, in m²/s, and of its heading, in rad²/s. Both stray: twice that of one of them.
        """
        own, noise = (
            machine(values, self.config.robot, self.config.motor),
            self.speeds - self.smooth,
        )
        shifts = len(noise) * np.arange(REPEATS) // REPEATS
        others = np.stack([np.roll(noise, shift, axis=0) for shift in shifts], axis=2)
        seen = self._tracks([own] * REPEATS, self.smooth[..., None] + others)
        steps = np.diff(seen[..., 0] + 1j * seen[..., 1], axis=0)
        driven = np.cumsum(steps * np.exp(-1j * seen[:-1, :, 2]), axis=0)  # as the robot sees it
        window = min(round(WINDOW_S / LOOKS_S), len(driven) // 2)
        moved = np.diff(driven[::window], axis=0)
        turned = np.diff(seen[::window, :, 2], axis=0)
        of_place = 0.5 * (moved.real.var(axis=1, ddof=1) + moved.imag.var(axis=1, ddof=1))
        of_heading = turned.var(axis=1, ddof=1)
        return 2.0 * np.array([of_place.mean(), of_heading.mean()]) / (window * LOOKS_S)

    def _tracks(self, machines: list, speeds: np.ndarray) -> np.ndarray:
        config = self.config
        every = round(LOOKS_S / config.timing.control_period_s)
        return tracks(machines, speeds, config.ticks_per_period, config.timing.dt_s, every)


def motor_speeds(
    set_points: np.ndarray, fmu: MotorFmu, config: CoSimConfig, seed: np.random.SeedSequence | None
) -> np.ndarray:
    """Speeds of motors D and E in rad/s at the ends of control periods.

    Args:
        set_points: (P, 2) in rad/s, of every control period.
        fmu: of both motors.
        config: their parameters, noise and clock.
        seed: of the noise; None for none.

    Returns:
        (P + 1, 2), from the start of the motors.

    Raises:
        FmuError: the FMU failed.
    """
    ticks, dt_s = config.ticks_per_period, config.timing.dt_s
    noise = np.zeros((len(set_points), 1, 2))
    if seed is not None:
        noise = SpeedNoise(config, seed, 1).draw(len(set_points))
    speeds = np.zeros((len(set_points) + 1, 2))
    inputs, outputs = np.zeros((3 * MOTORS, 1)), np.zeros((3 * MOTORS, 1))
    motors = Motors(fmu, config, 1)
    speeds[0] = motors.restart([0], ((config.motor, config.motor),))[MOTORS:, 0]
    try:
        for period, wanted in enumerate(set_points):
            inputs[: 2 * MOTORS, 0] = *wanted, *(noise[period, 0] * abs(wanted))
            motors.set_inputs(inputs, dt_s)
            motors.step(ticks, dt_s)
            motors.get_outputs(outputs, dt_s)
            speeds[period + 1] = outputs[MOTORS : 2 * MOTORS, 0]
    finally:
        motors.close()
    return speeds

"""Simulations of one drive with any parameters: what the camera would see without noise."""

from dataclasses import dataclass

import numpy as np

from cosim.coupling.assembly import Motors, SpeedNoise
from cosim.coupling.fmu import MotorFmu
from cosim.coupling.signals import MOTORS
from cosim.machine.identification.motion import tracks
from cosim.machine.identification.parameters import DELAY, machine
from cosim.model.config import CoSimConfig

LOOKS_S = 0.005  # between simulated poses, which are interpolated
REPEATS, WINDOW_S = 8, 5.0  # of simulations with other noise, and over which they drift apart


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
            values: (C, 8) parameters, see `cosim.machine.identification.parameters`.

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

"""Measure how well turns and short pulses repeat: the spread of where robots come to rest.

Robots do the same, each with noise of its own, on an endless floor: from the same motor angles and
from any, below and within the speeds at which they move without hopping. Their turn ends when the
steering faces the commanded direction, or after the mean time of these turns ("by the clock");
pulses end by the clock. Without speed control, motors get the voltage of their speed.
"""

import itertools
import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Annotated, Any

import numpy as np
import tyro
from scipy.stats import chi2

from cosim.calibration.trial import Trial, heading_angles
from cosim.coupling.fmu import MotorFmu
from cosim.model.config import CoSimConfig
from cosim.onboard.steering import (
    DIRECT,
    DIRECTION,
    GOAL_X,
    GOAL_Y,
    HOLD,
    MODE,
    OMEGA_D,
    OMEGA_E,
    START,
    TURN,
)
from fmus.build import cached_fmu
from minirobots.options import CommandOptions, Seed

LIMIT_S = 40.0  # of a turn; slower robots do not turn
REST_S = {True: 0.2, False: 1.0}  # with speed control, and without, where motors run down
WARM_UP_S, WARM_UP_RAD_S = 0.15, (300.0, 1000.0)
FORWARDS, LEFT = (-1.0, 1.0), (1.0, 1.0)
SPEEDS_RAD_S = (500.0, 700.0, 900.0, 1050.0)


class Options(CommandOptions):
    robots: int = 100
    """Repetitions, each with a noise of its own."""
    omega: Annotated[tuple[float, ...], tyro.conf.arg(metavar="RAD_S")] = SPEEDS_RAD_S
    """Motor speeds in rad/s, below lift-off."""
    pulses: Annotated[tuple[float, ...], tyro.conf.arg(metavar="S")] = (0.02, 0.05, 0.2)
    """Lengths of the pulses in s."""
    angles: Annotated[tuple[float, ...], tyro.conf.arg(metavar="DEG")] = (45.0, 85.0)
    """Angles of the turns in degrees, below 90, beyond which robots drive backwards instead."""
    seed: Seed = 0


class Robots:
    """Robots of a trial at rest, their motors all at the same angle or at any.

    Args:
        trial: the robots, just put down.
        config: of the trial.
        seed: of the motor angles.
        any_start: whether motors first run for a time at speeds that are drawn, and rest.
    """

    def __init__(self, trial: Trial, config: CoSimConfig, seed: int, any_start: bool) -> None:
        self._trial, self._period_s = trial, config.timing.control_period_s
        self._rest_s = REST_S["motors" not in config.open_loop]
        if any_start:
            rng = np.random.default_rng(seed)
            self.pulse(rng.uniform(*WARM_UP_RAD_S, (len(trial.commands), 2)), WARM_UP_S)
        self._first = self._pose()

    def pulse(self, omega_rad_s: np.ndarray | Sequence[float], time_s: float) -> None:
        """Run the motors at set points for a time, and wait until all is at rest."""
        self._trial.commands[:, MODE] = DIRECT
        self._trial.commands[:, [OMEGA_D, OMEGA_E]] = omega_rad_s
        self._trial.advance(round(time_s / self._period_s))
        self._rest()

    def turn(self, angle_rad: float) -> float:
        """Let the steering turn, and hold at its end.

        Returns:
            Mean time in s, infinite if a robot does not turn.
        """
        commands = self._trial.commands
        place, direction = self._first[:2], self._first[2] + angle_rad
        commands[:, [GOAL_X, GOAL_Y]] = (place + np.array([np.cos(direction), np.sin(direction)])).T
        commands[:, DIRECTION], commands[:, MODE] = direction, START
        times = np.zeros(len(commands))
        for period in range(1, round(LIMIT_S / self._period_s) + 1):
            self._trial.advance(1)
            turning = commands[:, MODE] == TURN
            commands[~turning, MODE] = HOLD
            times[turning] = period
            if not turning.any():
                self._rest()
                return float(times.mean()) * self._period_s
        return math.inf

    def spread(self) -> dict[str, Any]:
        """Return how far the robots are from where they began, in the frames of their headings.

        Means; standard deviations, each with the ends of its 95 % interval, which assumes a normal
        distribution; and the largest distance of a robot from the mean place.
        """
        dx, dy, turned = self._pose() - self._first
        c, s = np.cos(self._first[2]), np.sin(self._first[2])
        place = 1e6 * np.array([c * dx + s * dy, c * dy - s * dx])
        off = place - place.mean(axis=1, keepdims=True)
        turned_deg = np.rad2deg(np.arctan2(np.sin(turned), np.cos(turned)))
        return {
            "ahead_um": float(place[0].mean()),
            "left_um": float(place[1].mean()),
            "turned_deg": float(turned_deg.mean()),
            "ahead_sd_um": _deviation(place[0]),
            "left_sd_um": _deviation(place[1]),
            "turned_sd_deg": _deviation(turned_deg),
            "largest_um": float(np.hypot(*off).max()),
        }

    def _rest(self) -> None:
        self._trial.commands[:, MODE] = HOLD
        self._trial.advance(round(self._rest_s / self._period_s))

    def _pose(self) -> np.ndarray:
        bodies = self._trial.bodies
        return np.array([*bodies[:2], heading_angles(bodies[3:7].T[None])[0]])


def _deviation(values: np.ndarray) -> tuple[float, float, float]:
    """Return the standard deviation and its 95 % interval."""
    deviation, free = float(values.std(ddof=1)), len(values) - 1
    low, high = (math.sqrt(free / chi2.ppf(q, free)) for q in (0.975, 0.025))
    return deviation, low * deviation, high * deviation


def measure(options: Options) -> list[dict[str, Any]]:
    fmu, rows = MotorFmu(cached_fmu("VibrationMotor")), list[dict[str, Any]]()
    noise = np.random.SeedSequence(options.seed)

    def run(what: str, amount: float, speed: float, closed: str, start: str, time_s: float):
        config = CoSimConfig(open_loop=("motors",) if closed == "none" else ())
        config = replace(config, steering=config.steering._replace(turn_speed_rad_s=speed))
        with Trial(fmu, config, np.zeros(options.robots), noise) as trial:
            group = Robots(trial, config, options.seed, start == "any")
            if closed == "heading":
                time_s = group.turn(math.radians(amount))
            else:
                group.pulse(speed * np.array(LEFT if what == "turn" else FORWARDS), time_s)
            found = group.spread() if math.isfinite(time_s) else None
        rows.append(
            {"what": what, "amount": amount, "omega_rad_s": speed, "closed": closed, "start": start}
            | ({"time_s": time_s} | found if found else {})
        )
        return time_s

    for speed, start in itertools.product(options.omega, ("same", "any")):
        for angle in options.angles:
            time_s = run("turn", angle, speed, "heading", start, 0.0)
            for closed in ("speed", "none") if math.isfinite(time_s) else ():
                run("turn", angle, speed, closed, start, time_s)
        for pulse_s, closed in itertools.product(options.pulses, ("speed", "none")):
            run("pulse", pulse_s, speed, closed, start, pulse_s)
    return rows

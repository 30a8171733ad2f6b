"""Parameters of a robot from a track: nonlinear least squares over simulations, and intervals."""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares

from cosim.base.config import CoSimConfig
from cosim.base.progress import Progress, silent
from cosim.identification.motion import tracks
from cosim.identification.noise import FIRST_NOISE, Noise, likeliest_noise, residuals
from cosim.identification.parameters import (
    DELAY,
    HIGH,
    LOW,
    PARAMETERS,
    SPREADS,
    STEPS,
    machine,
    usual_values,
)
from cosim.identification.track import Track

LOOKS_S = 0.005  # between simulated poses, which are interpolated
ROUNDS = 3  # of parameters with the noise fixed, and noise with the parameters fixed
QUANTILE = 1.959964  # of the normal distribution, for intervals of 95 %
UNKNOWN = 0.5  # share of the spread before from which on data are said to tell nothing


@dataclass(frozen=True)
class Simulated:
    """Simulations of one drive with any parameters.

    Attributes:
        speeds: (P + 1, 2) of the motors, see `cosim.identification.excitation.motor_speeds`.
        times: (n,) of the frames in s.
        config: clock, and what of robot and motors is not identified.
    """

    speeds: np.ndarray
    times: np.ndarray
    config: CoSimConfig

    def frames(self, values: np.ndarray) -> np.ndarray:
        """What the camera would see without noise, from the origin, heading along +x.

        Args:
            values: (C, 8) parameters, see `cosim.identification.parameters`.

        Returns:
            (n, C, 3) x and y in m, heading in rad.
        """
        config = self.config
        machines = [machine(row, config.robot, config.motor) for row in values]
        # the delay alone asks for no simulation of its own
        distinct = list(dict.fromkeys(machines))
        every = round(LOOKS_S / config.timing.control_period_s)
        seen = tracks(
            distinct, self.speeds, config.ticks_per_period, config.timing.dt_s, every
        )
        looks = LOOKS_S * np.arange(len(seen))
        return np.stack(
            [
                np.column_stack(
                    [
                        np.interp(self.times - row[DELAY], looks, signal)
                        for signal in seen[:, distinct.index(own)].T
                    ]
                )
                for own, row in zip(machines, values, strict=True)
            ],
            axis=1,
        )


class Fit(NamedTuple):
    """Parameters that fit a track best.

    Attributes:
        values: (8,) in SI units, see `cosim.identification.parameters`.
        covariance: (8, 8) of them.
        noise: of the track.
        residuals: (n − 1, 3) of x, y and heading, of variance 1.
        evaluations: batches of simulations.
    """

    values: np.ndarray
    covariance: np.ndarray
    noise: Noise
    residuals: np.ndarray
    evaluations: int


def fit(track: Track, simulated: Simulated, progress: Progress = silent) -> Fit:
    """Fit all parameters.

    What is known before is a further residual for each of them, its distance from the usual value
    over its spread: where the track says nothing, the usual value stays.

    Args:
        track: seen.
        simulated: simulations of its drive.
        progress: is told the rounds done.
    """
    usual = usual_values(simulated.config.robot)
    noise, scaled, evaluations = FIRST_NOISE, np.zeros(len(PARAMETERS)), 0
    for done in range(ROUNDS):
        progress("identifying", done, ROUNDS)
        linear = _Linearised(track, simulated, usual, noise)
        found = least_squares(
            linear.residuals, scaled, linear.jacobian,
            bounds=((LOW - usual) / SPREADS, (HIGH - usual) / SPREADS),
            xtol=1e-3, ftol=1e-4, gtol=None, max_nfev=12,
        )  # fmt: skip
        scaled = found.x
        evaluations += found.nfev
        noise = likeliest_noise(track.times, track.poses, linear.frames[:, 0])
    progress("identifying", ROUNDS, ROUNDS)
    linear = _Linearised(track, simulated, usual, noise)
    jacobian, errors = linear.jacobian(scaled), linear.residuals(scaled)
    covariance = np.linalg.inv(jacobian.T @ jacobian) * np.outer(SPREADS, SPREADS)
    own = errors[len(PARAMETERS) :].reshape(-1, 3)
    return Fit(usual + SPREADS * scaled, covariance, noise, own, evaluations + 1)


class _Linearised:
    """Residuals and their derivatives with respect to scaled values, of one batch together."""

    def __init__(
        self, track: Track, simulated: Simulated, usual: np.ndarray, noise: Noise
    ) -> None:
        self._track, self._simulated, self._usual, self._noise = track, simulated, usual, noise
        self._at = np.full(len(usual), math.nan)
        self._errors = self._slopes = self.frames = np.empty(0)

    def residuals(self, scaled: np.ndarray) -> np.ndarray:
        """Of the prior, shape (8,), and then of the track."""
        self._move(scaled)
        return self._errors

    def jacobian(self, scaled: np.ndarray) -> np.ndarray:
        """Derivatives of `residuals`."""
        self._move(scaled)
        return self._slopes

    def _move(self, scaled: np.ndarray) -> None:
        if np.array_equal(scaled, self._at):
            return
        self._at = scaled.copy()
        values = self._usual + SPREADS * scaled
        # towards the inside of the bounds
        steps = np.where(values + STEPS > HIGH, -STEPS, STEPS)
        self.frames = self._simulated.frames(np.vstack([values, values + np.diag(steps)]))
        errors = residuals(self._track.times, self._track.poses, self.frames, self._noise)
        errors = errors.reshape(-1, errors.shape[2])
        slopes = (errors[:, 1:] - errors[:, :1]) / (steps / SPREADS)
        self._errors = np.concatenate([scaled, errors[:, 0]])
        self._slopes = np.vstack([np.eye(len(scaled)), slopes])

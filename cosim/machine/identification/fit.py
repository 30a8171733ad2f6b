"""Parameters of a robot from a track: nonlinear least squares over simulations, and intervals."""

import math
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares

from cosim.base.progress import Progress, silent
from cosim.machine.identification.noise import (
    FIRST_NOISE,
    Noise,
    deviance,
    likeliest_noise,
    residuals,
)
from cosim.machine.identification.simulated import (
    NAMES,
    PARAMETERS,
    SPREADS,
    STEPS,
    Simulated,
    limits,
    usual_values,
)
from cosim.machine.identification.track import SeenTrack

ROUNDS = 8  # at most, of parameters with the noise fixed, and noise with the parameters fixed
STILL = 0.02  # of a parameter's spread: a smaller change ends the rounds
LARGE = 1.5  # times the simulated drifts: from there on drifts seem to have another reason
QUANTILE = 1.959964  # of the normal distribution, for intervals of 95 %
UNKNOWN = 0.5  # share of the spread before from which on data are said to tell nothing


class Fit(NamedTuple):
    """Parameters that fit a track best.

    Attributes:
        values: (8,) in SI units, see `cosim.machine.identification.simulated`.
        covariance: (8, 8) of them, of Gauss and Newton: the inverse of JᵀJ.
        noise: of the track.
        residuals: (n − 1, 3) of x, y and heading, of variance 1.
        frames: (n, 3) the simulated track, from the origin.
        evaluations: batches of simulations.
    """

    values: np.ndarray
    covariance: np.ndarray
    noise: Noise
    residuals: np.ndarray
    frames: np.ndarray
    evaluations: int

    @property
    def deviations(self) -> np.ndarray:
        """Standard deviations of the values, shape (8,)."""
        return np.sqrt(np.diag(self.covariance))


def fit(track: SeenTrack, simulated: Simulated, progress: Progress = silent) -> Fit:
    """Fit all parameters.

    What is known before is a further residual for each of them, its distance from the usual value
    over its spread: where the track says nothing, the usual value stays.

    Args:
        track: seen.
        simulated: simulations of its drive.
        progress: receives the rounds done.
    """
    found = _fit_from(np.zeros(len(PARAMETERS)), track, simulated, progress)
    place, turn = LARGE * simulated.drifts(found.values)
    if found.noise.position_drift_m2_s < place and found.noise.heading_drift_rad2_s < turn:
        return found
    # The robot seems to stray more than its noise explains: perhaps a local minimum.
    rougher = np.eye(len(PARAMETERS))[NAMES.index("mu")]
    other = _fit_from(rougher, track, simulated, progress)
    usual, _ = _before(simulated)

    def unlikeliness(one: Fit) -> float:
        before = (((one.values - usual) / SPREADS) ** 2).sum()
        return deviance(track.times, one.residuals, one.noise) + before

    return min((found, other), key=unlikeliness)


def _fit_from(
    scaled: np.ndarray, track: SeenTrack, simulated: Simulated, progress: Progress
) -> Fit:
    """Fit from a start, (8,) distances from the usual values over their spreads."""
    usual, (low, high) = _before(simulated)
    noise, evaluations = FIRST_NOISE, 0
    for done in range(ROUNDS):
        progress("identifying", done, ROUNDS)
        linear = _Linearised(track, simulated, noise)
        found = least_squares(
            linear.residuals,
            scaled,
            linear.jacobian,  # pyright: ignore[reportArgumentType]
            bounds=((low - usual) / SPREADS, (high - usual) / SPREADS),
            xtol=5e-3,
            ftol=5e-4,
            gtol=1e-12,
            max_nfev=8,
        )
        moved, scaled = np.abs(found.x - scaled).max(), found.x
        evaluations += found.nfev
        linear.residuals(scaled)  # the last trial may have been another one
        noise = likeliest_noise(track.times, track.poses, linear.frames[:, 0])
        # A track of a minute tells little of its drifts: they are not smaller than simulated ones.
        place, turn = simulated.drifts(usual + SPREADS * scaled)
        noise = noise._replace(
            position_drift_m2_s=max(noise.position_drift_m2_s, float(place)),
            heading_drift_rad2_s=max(noise.heading_drift_rad2_s, float(turn)),
        )
        if moved < STILL:
            break
    progress("identifying", ROUNDS, ROUNDS)
    linear = _Linearised(track, simulated, noise)
    jacobian, errors = linear.jacobian(scaled), linear.residuals(scaled)
    covariance = np.linalg.inv(jacobian.T @ jacobian) * np.outer(SPREADS, SPREADS)
    own = errors[len(PARAMETERS) :].reshape(-1, 3)
    values = usual + SPREADS * scaled
    return Fit(values, covariance, noise, own, linear.frames[:, 0], evaluations + 1)


def _before(simulated: Simulated) -> tuple[np.ndarray, tuple[np.ndarray, np.ndarray]]:
    """Usual values, and limits."""
    robot = simulated.config.robot
    return usual_values(robot), limits(robot)


def rises(track: SeenTrack, simulated: Simulated, found: Fit) -> np.ndarray:
    """Profile likelihood at the ends of the intervals: what the sum of squares rises by there.

    At each end of each interval the other values are those that fit best by the linear model; the
    sum is simulated. If the model were linear, every rise would be `QUANTILE`² = 3.84.

    Args:
        track: seen.
        simulated: simulations of its drive.
        found: for the track.

    Returns:
        (8, 2) at the lower and upper ends; NaN where an end is out of bounds.
    """
    usual, (low, high) = _before(simulated)
    along = found.covariance / found.deviations  # a column for each parameter
    ends = found.values + QUANTILE * np.concatenate([-along.T, along.T])
    points = np.vstack([found.values, np.clip(ends, low, high)])
    frames = simulated.frames(points)
    errors = residuals(track.times, track.poses, frames, found.noise)
    squares = (errors**2).sum(axis=(0, 1)) + (((points - usual) / SPREADS) ** 2).sum(axis=1)
    rise = np.where((ends == points[1:]).all(axis=1), squares[1:] - squares[0], math.nan)
    return rise.reshape(2, -1).T


def unidentifiable(found: Fit) -> list[str]:
    """Name directions that are not identifiable: the track hardly improves on the prior."""
    shares, directions = np.linalg.eigh(found.covariance / np.outer(SPREADS, SPREADS))
    said = []
    for share, direction in zip(np.sqrt(shares), directions.T, strict=True):
        if share > UNKNOWN:
            names = [
                p.name for p, part in zip(PARAMETERS, direction, strict=True) if abs(part) > 0.4
            ]
            together = " and ".join(names) + (" together" if len(names) > 1 else "")
            said.append(f"{together}: still {share:.0%} of the spread assumed before")
    return said


class _Linearised:
    """Residuals and their derivatives with respect to scaled values, of one batch together."""

    def __init__(self, track: SeenTrack, simulated: Simulated, noise: Noise) -> None:
        self._track, self._simulated, self._noise = track, simulated, noise
        self._usual, (_, self._high) = _before(simulated)
        self._at = np.full(len(PARAMETERS), math.nan)
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
        steps = np.where(values + STEPS > self._high, -STEPS, STEPS)
        self.frames = self._simulated.frames(np.vstack([values, values + np.diag(steps)]))
        errors = residuals(self._track.times, self._track.poses, self.frames, self._noise)
        errors = errors.reshape(-1, errors.shape[2])
        slopes = (errors[:, 1:] - errors[:, :1]) / (steps / SPREADS)
        self._errors = np.concatenate([scaled, errors[:, 0]])
        self._slopes = np.vstack([np.eye(len(scaled)), slopes])

"""Parameters of a robot from a track: nonlinear least squares over simulations, and intervals."""

import functools
import math
from collections.abc import Callable, Sequence
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
from cosim.machine.identification.simulated import RobotParameter, Simulated
from cosim.machine.identification.track import SeenTrack

ROUNDS = 8  # at most, of parameters with the noise fixed, and noise with the parameters fixed
STILL = 0.02  # of a parameter's spread: a smaller change ends the rounds
LARGE = 1.5  # times the simulated drifts: from there on drifts seem to have another reason
QUANTILE = 1.959964  # of the normal distribution, for intervals of 95 %
UNKNOWN = 0.5  # share of the spread before from which on data are said to tell nothing


class Fit(NamedTuple):
    """Parameters that fit a track best."""

    values: np.ndarray  # (K,) in SI units, see `cosim.machine.identification.simulated`
    covariance: np.ndarray  # (K, K) of them, of Gauss and Newton: the inverse of JᵀJ
    noise: Noise
    residuals: np.ndarray  # (n − 1, 3) of x, y and heading, of variance 1
    frames: np.ndarray  # (n, 3) the simulated track, from the origin
    evaluations: int

    @property
    def deviations(self) -> np.ndarray:
        """Standard deviations of the values, shape (K,)."""
        return np.sqrt(np.diag(self.covariance))


def fit(track: SeenTrack, simulated: Simulated, progress: Progress = silent) -> Fit:
    """Fit all parameters to a track by simulations of its drive.

    What is known before is a further residual for each of them, its distance from the usual value
    over its spread: where the track says nothing, the usual value stays.
    """
    names = [p.name for p in simulated.parameters]
    rougher = np.array([float(name == "mu") for name in names])
    stronger = np.array([float(name.startswith("motor_")) for name in names])
    starts = [rougher]
    if simulated.config.robot.own_layout:
        starts += [-rougher, stronger, -stronger]
    found = [_fit_from(np.zeros(len(names)), track, simulated, progress)]
    place, turn = LARGE * simulated.drifts(found[0].values)

    def strays(one: Fit) -> bool:
        # where motors have no noise, more than what the camera would not see
        most_place = place or one.noise.position_m**2 / track.times[-1]
        most_turn = turn or one.noise.heading_rad**2 / track.times[-1]
        drift, turning = one.noise.position_drift_m2_s, one.noise.heading_drift_rad2_s
        return bool(drift >= most_place or turning >= most_turn)

    def unlikeliness(one: Fit) -> float:
        before = (((one.values - simulated.usual) / simulated.spreads) ** 2).sum()
        return deviance(track.times, one.residuals, one.noise) + before

    for start in starts:
        best = min(found, key=unlikeliness)
        if not strays(best):
            return best
        # The robot seems to stray more than its noise explains: perhaps a local minimum.
        found.append(_fit_from(start, track, simulated, progress))
    return min(found, key=unlikeliness)


def _fit_from(
    scaled: np.ndarray, track: SeenTrack, simulated: Simulated, progress: Progress
) -> Fit:
    """Fit from a start, (K,) distances from the usual values over their spreads."""
    usual, spreads, (low, high) = simulated.usual, simulated.spreads, simulated.limits
    scaled = np.clip(scaled, (low - usual) / spreads, (high - usual) / spreads)
    noise, evaluations = FIRST_NOISE, 0
    for done in range(ROUNDS):
        progress("identifying", done, ROUNDS)
        at = _linearised(track, simulated, noise)
        found = least_squares(
            lambda x, at=at: at(tuple(x))[0],
            scaled,
            lambda x, at=at: at(tuple(x))[1],  # pyright: ignore[reportArgumentType]
            bounds=((low - usual) / spreads, (high - usual) / spreads),
            xtol=5e-3,
            ftol=5e-4,
            gtol=1e-12,
            max_nfev=8,
        )
        moved, scaled = np.abs(found.x - scaled).max(), found.x
        evaluations += found.nfev
        _, _, frames = at(tuple(scaled))
        noise = likeliest_noise(track.times, track.poses, frames)
        # A track of a minute tells little of its drifts: they are not smaller than simulated ones.
        place, turn = simulated.drifts(usual + spreads * scaled)
        noise = noise._replace(
            position_drift_m2_s=max(noise.position_drift_m2_s, float(place)),
            heading_drift_rad2_s=max(noise.heading_drift_rad2_s, float(turn)),
        )
        if moved < STILL:
            break
    progress("identifying", ROUNDS, ROUNDS)
    errors, jacobian, frames = _linearised(track, simulated, noise)(tuple(scaled))
    covariance = np.linalg.inv(jacobian.T @ jacobian) * np.outer(spreads, spreads)
    own = errors[len(usual) :].reshape(-1, 3)
    return Fit(usual + spreads * scaled, covariance, noise, own, frames, evaluations + 1)


def _linearised(
    track: SeenTrack, simulated: Simulated, noise: Noise
) -> Callable[[tuple[float, ...]], tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """A function of scaled values, which simulates one batch.

    It returns residuals, of the prior (K,) and then of the track, their slopes, and the simulated
    track (n, 3).
    """
    spreads, own = simulated.spreads, np.array([p.step for p in simulated.parameters])

    @functools.lru_cache(maxsize=1)  # least squares ask for residuals, and then for their slopes
    def at(scaled: tuple[float, ...]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        values = simulated.usual + spreads * scaled
        # towards the inside of the bounds
        steps = np.where(values + own > simulated.limits[1], -own, own)
        frames = simulated.frames(np.vstack([values, values + np.diag(steps)]))
        errors = residuals(track.times, track.poses, frames, noise)
        errors = errors.reshape(-1, errors.shape[2])
        slopes = (errors[:, 1:] - errors[:, :1]) / (steps / spreads)
        return (
            np.concatenate([scaled, errors[:, 0]]),
            np.vstack([np.eye(len(scaled)), slopes]),
            frames[:, 0],
        )

    return at


def rises(track: SeenTrack, simulated: Simulated, found: Fit) -> np.ndarray:
    """Profile likelihood: what the sum of squares rises by at the ends of the intervals, (K, 2).

    At each end of each interval the other values are those that fit best by the linear model; the
    sum is simulated. If the model were linear, every rise would be `QUANTILE`² = 3.84. NaN where an
    end is out of bounds.
    """
    along = found.covariance / found.deviations  # a column for each parameter
    ends = found.values + QUANTILE * np.concatenate([-along.T, along.T])
    points = np.vstack([found.values, np.clip(ends, *simulated.limits)])
    errors = residuals(track.times, track.poses, simulated.frames(points), found.noise)
    before = ((points - simulated.usual) / simulated.spreads) ** 2
    squares = (errors**2).sum(axis=(0, 1)) + before.sum(axis=1)
    rise = np.where((ends == points[1:]).all(axis=1), squares[1:] - squares[0], math.nan)
    return rise.reshape(2, -1).T


def unidentifiable(found: Fit, parameters: Sequence[RobotParameter]) -> list[str]:
    """Name directions that are not identifiable: the track hardly improves on the prior."""
    spreads = [p.spread for p in parameters]
    shares, directions = np.linalg.eigh(found.covariance / np.outer(spreads, spreads))
    texts = []
    for share, direction in zip(np.sqrt(shares), directions.T, strict=True):
        if share > UNKNOWN:
            weights = zip(parameters, direction, strict=True)
            least = min(0.4, np.abs(direction).max())
            names = [p.name for p, weight in weights if abs(weight) >= least]
            together = " and ".join(names) + (" together" if len(names) > 1 else "")
            texts.append(f"{together}: still {share:.0%} of the spread assumed before")
    return texts

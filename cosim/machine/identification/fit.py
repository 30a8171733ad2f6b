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
DELAYS = 201  # of the camera, that are tried before each round
SECANTS = 2  # times that slopes are taken over the intervals that the last ones gave
MOST_WIDENING = 8.0  # of an interval where the model is not linear
MOST_ERROR = 3.5  # of half of all intervals: beyond it fits may be local minima
STILL = 0.02  # of a parameter's spread: a smaller change ends the rounds
LARGE = 1.5  # times the simulated drifts: from there on drifts seem to have another reason
OUTLIER = 6.0  # standard deviations of a frame that no track of a minute has by chance
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
    doubts: tuple[str, ...] = ()  # why the intervals are not to be trusted, as text

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
    starts = [rougher, -rougher, stronger, -stronger]
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
        if not strays(min(found, key=unlikeliness)):
            break
        # The robot seems to stray more than its noise explains: perhaps a local minimum.
        found.append(_fit_from(start, track, simulated, progress))
    best = min(found, key=unlikeliness)
    simulated.require_standing(best.frames)
    best = _by_secants(best, track, simulated)
    before = best.deviations
    best, doubts = _widened(best, rises(track, simulated, best)), []
    if np.median(best.deviations / before) > MOST_ERROR:
        doubts.append("tracks depend too roughly on the parameters, so that other fits are as good")
    if strays(best):
        doubts.append("the robot strays more than the noise of its motors explains")
    if outliers := int((np.abs(best.residuals).max(axis=1) > OUTLIER).sum()):
        doubts.append(f"{outliers} frames are more than {OUTLIER:g} standard deviations off")
    return best._replace(doubts=tuple(doubts))


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
        scaled[-1] = _likeliest_delay(scaled, track, simulated, noise)
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


def _likeliest_delay(
    scaled: np.ndarray, track: SeenTrack, simulated: Simulated, noise: Noise
) -> float:
    """Return the camera's delay of least squares, scaled, all else being equal, of many minima."""
    (low, high), usual, spreads = simulated.limits[:, -1], simulated.usual, simulated.spreads
    points = np.tile(usual + spreads * scaled, (DELAYS, 1))
    points[:, -1] = np.linspace(low, high, DELAYS)
    delays = (points[:, -1] - usual[-1]) / spreads[-1]
    errors = residuals(track.times, track.poses, simulated.frames(points), noise)
    return float(delays[np.argmin((errors**2).sum(axis=(0, 1)) + delays**2)])


def _by_secants(found: Fit, track: SeenTrack, simulated: Simulated) -> Fit:
    """Return a fit whose covariance is of slopes over its intervals, where they are flatter.

    Where feet land depends on phases, and tracks on parameters so roughly: tangents are too steep.
    """
    spreads, (low, high), count = simulated.spreads, simulated.limits, len(simulated.spreads)
    deviations, covariance = found.deviations, found.covariance
    for _ in range(SECANTS):
        half = np.diag(QUANTILE * deviations)
        ends = np.clip([found.values + half, found.values - half], low, high)
        frames = simulated.frames(ends.reshape(-1, count))
        errors = residuals(track.times, track.poses, frames, found.noise).reshape(-1, 2 * count)
        slopes = (errors[:, :count] - errors[:, count:]) / np.diag(ends[0] - ends[1]) * spreads
        covariance = np.linalg.inv(np.eye(count) + slopes.T @ slopes) * np.outer(spreads, spreads)
        deviations = np.maximum(found.deviations, np.sqrt(np.diag(covariance)))
    widened = deviations / np.sqrt(np.diag(covariance))
    return found._replace(
        covariance=covariance * np.outer(widened, widened), evaluations=found.evaluations + SECANTS
    )


def _widened(found: Fit, risen: np.ndarray) -> Fit:
    """Return a fit with intervals as much wider as the linear model errs at their ends.

    Where the sum of squares rises less, an interval ends too early; where it rises more, the valley
    of good fits is curved, and other fits are as good further along it.
    """
    errors = np.abs(np.log(np.maximum(risen, 1e-3) / QUANTILE**2))
    factor = np.exp(0.5 * np.nan_to_num(errors).max(axis=1)).clip(max=MOST_WIDENING)
    return found._replace(covariance=found.covariance * np.outer(factor, factor))


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

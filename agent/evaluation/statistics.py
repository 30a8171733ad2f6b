"""Intervals of rates and of means over runs, and the interquartile mean.

The interquartile mean is recommended for reinforcement learning by Agarwal et al., "Deep
Reinforcement Learning at the Edge of the Statistical Precipice" (2021).
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import msgspec
import numpy as np
from scipy.stats import binomtest, t

CONFIDENCE = 0.95
_RESAMPLES = 10_000  # of a bootstrap
_OTHERS = 10  # runs that differ from the most frequent value, after which intervals cover


class Statistics(msgspec.Struct, frozen=True):
    """Statistics over runs; None where no run has a value."""

    mean: float | None
    iqm: float | None  # mean of the middle half of the runs
    low: float | None  # ends of the 95 % interval of the mean, see `mean_intervals`
    high: float | None
    runs: int  # that have a value


class Interval(NamedTuple):
    """A mean, or a share of episodes, with its 95 % interval; None where it has none."""

    mean: float | None
    low: float | None
    high: float | None


def rate(count: int, episodes: int) -> Interval:
    """Return the share of `count` among `episodes` independent ones, with its Wilson interval."""
    if not episodes:
        return Interval(None, None, None)
    interval = binomtest(count, episodes).proportion_ci(CONFIDENCE, method="wilson")
    return Interval(count / episodes, float(interval.low), float(interval.high))


def rate_over_trainings(hits: np.ndarray) -> Interval:
    """Return the share of episodes that count, over trainings that are driven from the same starts.

    Its interval is that of a bootstrap that draws trainings and starts again, and at least Wilson's
    of all episodes: where all are alike a bootstrap has no spread.

    Args:
        hits: (trainings, starts) bool, which episodes count.
    """
    of_all, rng = rate(int(hits.sum()), hits.size), np.random.default_rng(0)
    low, high = _ends(_shares(rng, hits, _drawn(rng, hits.shape[1])))
    return Interval(of_all.mean, min(low, of_all.low or 0.0), max(high, of_all.high or 0.0))


def paired_difference(first: np.ndarray, second: np.ndarray) -> Interval:
    """Return how much larger the first of two methods' shares is, driven from the same starts.

    Its interval is that of a bootstrap that draws starts for both together, and trainings for each.

    Args:
        first, second: (trainings, starts) bool, which episodes count.
    """
    rng = np.random.default_rng(0)
    starts = _drawn(rng, first.shape[1])
    ends = _ends(_shares(rng, first, starts) - _shares(rng, second, starts))
    return Interval(float(first.mean() - second.mean()), *ends)


def paired_test(first: np.ndarray, second: np.ndarray) -> float:
    """Return the p-value of the exact McNemar test of two policies; (starts,) bool each."""
    more, less = int((first & ~second).sum()), int((~first & second).sum())
    return float(binomtest(more, more + less).pvalue) if more + less else 1.0


def _drawn(rng: np.random.Generator, count: int) -> np.ndarray:
    """(resamples, count) int64, how often each of `count` is drawn."""
    return rng.multinomial(count, np.full(count, 1.0 / count), _RESAMPLES)


def _shares(rng: np.random.Generator, hits: np.ndarray, starts: np.ndarray) -> np.ndarray:
    """(resamples,) share of episodes that count, of drawn trainings and starts as given."""
    of_starts = _drawn(rng, len(hits)) @ hits.astype(np.int64)  # exact
    return (of_starts * starts).sum(axis=1) / hits.size


def _ends(values: np.ndarray) -> tuple[float, float]:
    tail = 0.5 * (1.0 - CONFIDENCE)
    low, high = np.quantile(values, (tail, 1.0 - tail))
    return float(low), float(high)


def interval_text(
    of: Interval | Statistics, digits: int = 2, factor: float = 1.0, unit: str = ""
) -> str:
    """Return mean and interval as text; [–] where the runs are too few for an interval."""
    if of.mean is None:
        return "–"
    ends = "–"
    if of.low is not None and of.high is not None:
        ends = f"{factor * of.low:.{digits}f}, {factor * of.high:.{digits}f}"
    return f"{factor * of.mean:.{digits}f}{unit} [{ends}]".replace("-", "−")


def interquartile_mean(values: np.ndarray) -> float:
    """Return the mean of the middle half of a sample, values at its ends by their share."""
    ordered = np.sort(np.asarray(values, dtype=float))
    n = len(ordered)
    # value k covers ranks [k, k + 1); the middle half is [n/4, 3n/4)
    ranks = np.arange(n)
    weights = np.clip(np.minimum(ranks + 1, 0.75 * n) - np.maximum(ranks, 0.25 * n), 0.0, 1.0)
    return float((weights * ordered).sum() / weights.sum())


def summarise(
    values: Sequence[float | None] | np.ndarray, least: float = -math.inf, most: float = math.inf
) -> Statistics:
    """Return the statistics of one value per run.

    Args:
        values: (runs,), NaN or None for a run without a value.
        least, most: possible values, to which the interval is limited.
    """
    runs = np.asarray(values, dtype=float)
    runs = runs[np.isfinite(runs)]
    if not len(runs):
        return Statistics(None, None, None, None, runs=0)
    ends = mean_intervals(runs[:, None])[:, 0].clip(least, most)
    low, high = (None if math.isnan(end) else float(end) for end in ends)
    return Statistics(float(runs.mean()), interquartile_mean(runs), low, high, len(runs))


def mean_intervals(values: np.ndarray) -> np.ndarray:
    """Return the 95 % Student intervals of the means over runs.

    There is none for a single run, nor where most runs agree (as those that succeed from every
    start) and fewer than ten others are left to estimate the spread from.

    Args:
        values: (runs, points) float64; NaNs are left out of a point's mean.

    Returns:
        (2, points) float64, lower and upper ends; NaN where there is no interval.
    """
    ends = np.full((2, values.shape[1]), np.nan)
    for point, column in enumerate(values.T):
        known = column[np.isfinite(column)]
        n = len(known)
        others = n - max(np.unique(known, return_counts=True)[1], default=0)
        if n > 1 and others >= min(n / 2, _OTHERS):
            half = t.isf(0.5 * (1.0 - CONFIDENCE), n - 1) * known.std(ddof=1) / math.sqrt(n)
            ends[:, point] = known.mean() - half, known.mean() + half
    return ends

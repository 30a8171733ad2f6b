"""Intervals of rates; mean, interquartile mean and bootstrap interval over runs.

The latter are recommended for reinforcement learning by Agarwal et al., "Deep Reinforcement
Learning at the Edge of the Statistical Precipice" (2021).
"""

from collections.abc import Sequence
from typing import NamedTuple

import msgspec
import numpy as np
from scipy.stats import binomtest

RESAMPLES = 10_000
CONFIDENCE = 0.95


class Statistics(msgspec.Struct, frozen=True):
    """Statistics over runs; None where no run has a value.

    Attributes:
        mean: mean over the runs.
        iqm: mean of the middle half of the runs.
        low, high: ends of the 95 % percentile bootstrap interval of the mean.
        runs: runs counted; runs without a value (NaN) are not.
    """

    mean: float | None
    iqm: float | None
    low: float | None
    high: float | None
    runs: int


class Rate(NamedTuple):
    """Share of episodes.

    Attributes:
        share: of the episodes counted.
        low, high: ends of its 95 % Wilson score interval.
    """

    share: float
    low: float
    high: float


def rate(count: int, episodes: int) -> Rate:
    """Share of `count` among `episodes` (at least one) independent episodes."""
    interval = binomtest(count, episodes).proportion_ci(CONFIDENCE, method="wilson")
    return Rate(count / episodes, float(interval.low), float(interval.high))


def interquartile_mean(values: np.ndarray) -> float:
    """Mean of the middle half of a sample, weighting the values at its ends by their share."""
    ordered = np.sort(np.asarray(values, dtype=float))
    n = len(ordered)
    # value k covers ranks [k, k + 1); the middle half is [n/4, 3n/4)
    ranks = np.arange(n)
    weights = np.clip(np.minimum(ranks + 1, 0.75 * n) - np.maximum(ranks, 0.25 * n), 0.0, 1.0)
    return float((weights * ordered).sum() / weights.sum())


def summarise(values: Sequence[float | None] | np.ndarray, seed: int = 0) -> Statistics:
    """Statistics of one value per run.

    Args:
        values: (runs,), NaN or None for a run without a value.
        seed: of the bootstrap.
    """
    given = np.asarray(values, dtype=float)
    known = given[np.isfinite(given)]
    if not len(known):
        return Statistics(None, None, None, None, runs=0)
    low, high = bootstrap_interval(known[:, None], seed)[:, 0]
    return Statistics(
        float(known.mean()), interquartile_mean(known), float(low), float(high), len(known)
    )


def bootstrap_interval(values: np.ndarray, seed: int = 0) -> np.ndarray:
    """95 % percentile bootstrap interval of the mean over runs.

    Args:
        values: (runs, points) float64; NaNs are left out of a point's mean.
        seed: of the resampling.

    Returns:
        (2, points) float64, lower and upper ends.
    """
    if not values.size:
        return np.empty((2, values.shape[1]))
    random = np.random.default_rng(seed)
    n = len(values)
    # resampling n runs with replacement is a multinomial count of each
    counts = random.multinomial(n, np.full(n, 1.0 / n), size=RESAMPLES).astype(float)
    known = np.isfinite(values)
    with np.errstate(invalid="ignore"):
        means = counts @ np.where(known, values, 0.0) / (counts @ known)
    tails = 100.0 * np.array([(1.0 - CONFIDENCE) / 2.0, (1.0 + CONFIDENCE) / 2.0])
    return np.nanpercentile(means, tails, axis=0)

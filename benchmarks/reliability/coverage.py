"""Measure how often intervals of 95 % contain the mean, or the rate, that samples are drawn from.

Student intervals as `agent.evaluation.statistics.mean_intervals` gives them, percentile and BCa
bootstrap intervals (`scipy.stats.bootstrap`) of the same samples, and Wilson intervals of rates.
"""

import warnings
from collections.abc import Callable
from typing import Annotated, Any

import numpy as np
from scipy.stats import binom, bootstrap

from agent.evaluation.statistics import CONFIDENCE, mean_intervals, rate, rate_of_weights
from minirobots.options import CommandOptions, Count, Seed, at_least

Draw = Callable[[np.random.Generator, tuple[int, int]], np.ndarray]


class Options(CommandOptions):
    samples: Count = 2000
    """Samples of every distribution and number of runs."""
    runs: tuple[Annotated[int, at_least(2)], ...] = (2, 5, 20, 100)
    """Runs in a sample."""
    seed: Seed = 0


def _successes(rng: np.random.Generator, shape: tuple[int, int]) -> np.ndarray:
    """Half of the runs succeed from every start, the others from 90 to 100 % of them."""
    return 1.0 - 0.1 * rng.random(shape) * (rng.random(shape) < 0.5)


# Distributions of one value per run, with their means.
DISTRIBUTIONS: dict[str, tuple[Draw, float]] = {
    "normal": (lambda rng, shape: rng.normal(size=shape), 0.0),
    "uniform": (lambda rng, shape: rng.random(shape), 0.5),
    "exponential": (lambda rng, shape: rng.exponential(size=shape), 1.0),
    "success, half at 100 %": (_successes, 0.975),
}
_RESAMPLES = 999


def of_means(name: str, runs: int, samples: int, seed: int) -> dict[str, Any]:
    """Shares of a distribution's samples with intervals that contain the mean.

    A Student interval may be wrong, and samples have none where `mean_intervals` gives none.
    """
    draw, mean = DISTRIBUTIONS[name]
    values = draw(np.random.default_rng([seed, runs]), (runs, samples))
    low, high = mean_intervals(values)
    shown = np.isfinite(low)
    holds = (low <= mean) & (mean <= high)
    found = {
        "distribution": name,
        "runs": runs,
        "student": float(holds.mean()),
        "wrong": float((shown & ~holds).mean()),
        "none": float((~shown).mean()),
    }
    for method in ("percentile", "BCa"):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # samples of equal values
            ends = bootstrap(
                (values,),
                np.mean,
                axis=0,
                n_resamples=_RESAMPLES,
                confidence_level=CONFIDENCE,
                method=method,
                batch=100,
                rng=np.random.default_rng(seed),
            ).confidence_interval
        found[method.lower()] = float(((ends.low <= mean) & (mean <= ends.high)).mean())
    return found


def of_rates(episodes: int) -> dict[str, Any]:
    """Mean and least probability that Wilson intervals hold a rate, of 999 between 0 and 1."""
    counts = np.arange(episodes + 1)
    ends = np.array([rate(int(count), episodes)[1:] for count in counts])
    truth = np.arange(1, 1000) / 1000.0
    holds = (ends[:, 0] <= truth[:, None]) & (truth[:, None] <= ends[:, 1])
    found = (binom.pmf(counts, episodes, truth[:, None]) * holds).sum(axis=1)
    return {"episodes": episodes, "mean": float(found.mean()), "least": float(found.min())}


def of_splitting(roots: int, samples: int, seed: int) -> dict[str, Any]:
    """Share of samples with an interval of `--splitting` that contains the rate of collisions.

    3 of 10 roots have four branches, which collide with a chance of their own.
    """
    rng, shape = np.random.default_rng([seed, roots]), (samples, roots)
    chance = rng.beta(0.2, 1.8, shape)
    values = (rng.random(shape) < 0.3) * rng.binomial(4, chance) / 4.0
    held = 0
    for sample in values:
        share, variance = float(sample.mean()), float(sample.var(ddof=1)) / roots
        worth = share * (1.0 - share) / variance if variance else float(roots)
        _, low, high = rate_of_weights(share, worth)
        held += low <= 0.03 <= high
    return {"roots": roots, "rate": 0.03, "wilson": held / samples}


def measure(options: Options) -> dict[str, list[dict[str, Any]]]:
    samples, seed = options.samples, options.seed
    return {
        "means": [of_means(name, n, samples, seed) for name in DISTRIBUTIONS for n in options.runs],
        "rates": [of_rates(episodes) for episodes in (8, 40, 200)],
        "splitting": [of_splitting(roots, samples, seed) for roots in (40, 100)],
    }

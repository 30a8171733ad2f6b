"""Statistics over episodes of one case: rates with intervals, paths, closeness, energy.

Only numbers, with None where there is none; tables of them are drawn by the command lines.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from scipy.stats import binomtest

from agent.evaluation.cases import Case
from agent.evaluation.rollout import EpisodeResult
from agent.evaluation.statistics import CONFIDENCE, summarise
from agent.process.exact import evaluate
from cosim.base.outcome import ENDS, SUCCESS, Outcome


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


def summary(case: Case, results: Mapping[int, EpisodeResult]) -> dict[str, Any]:
    """What `--json` lists of a case.

    Rates are over all episodes, and so is `min_distance_cm`, the smallest distance between two
    robots' centres in any of them. Path, time and energy are means over successful episodes, the
    path also over the robots, the energy summed over them. `path_ratio_to_grid` is the mean over
    the episodes that succeed here and on the grid of the path over that of the same policy's exact
    grid episode from the same start, with its bootstrap interval.

    Args:
        case: policy and configuration.
        results: by index of the start.
    """
    episodes = len(results)
    values: dict[str, Any] = {"episodes": episodes}
    for outcome in ENDS:
        share = low = high = None
        if episodes:
            share, low, high = rate(sum(r.outcome == outcome for r in results.values()), episodes)
        values |= {outcome: share, f"{outcome}_low": low, f"{outcome}_high": high}
    successes = {index: r for index, r in results.items() if r.outcome == Outcome.SUCCESS}
    distances = [r.min_distance_cm for r in results.values() if r.min_distance_cm is not None]
    ratio = summarise(_ratios_to_grid(case, successes))
    return values | {
        "path_length_cm": _mean([r.path_length_cm for r in successes.values()]),
        "path_ratio_to_grid": ratio.mean if ratio.runs else None,
        "path_ratio_to_grid_low": ratio.low if ratio.runs else None,
        "path_ratio_to_grid_high": ratio.high if ratio.runs else None,
        "min_distance_cm": min(distances, default=None),
        "sim_time_s": _mean([r.sim_time_s for r in successes.values()]),
        "energy_j": _mean([r.energy_j for r in successes.values()]),
    }


def _mean(values: list[float]) -> float | None:
    return float(np.mean(values)) if values else None


def _ratios_to_grid(case: Case, successes: Mapping[int, EpisodeResult]) -> np.ndarray:
    """(episodes,) float64, NaN where the policy fails on the grid."""
    if not successes:
        return np.empty(0)
    policy = case.policy
    grid = evaluate(policy.process, policy.values, case.starts[list(successes)])
    cell_cm = 100.0 * policy.config.scenario.cell_m
    expected = cell_cm * grid.path_cells.mean(axis=1)
    expected[grid.outcome != SUCCESS] = np.nan
    return np.array([r.path_length_cm for r in successes.values()]) / expected


def failures(results: Mapping[int, EpisodeResult]) -> list[dict[str, Any]]:
    """Starts that did not end in success, with their outcomes."""
    return [
        {"index": index, "starts": r.starts, "outcome": r.outcome, "recording": r.recording}
        for index, r in sorted(results.items())
        if r.outcome != Outcome.SUCCESS
    ]

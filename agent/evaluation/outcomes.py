"""Statistics over episodes of one case: rates with intervals, paths, closeness, energy.

Only numbers, with None where there is none; tables of them are drawn by the command lines.
"""

from collections.abc import Mapping

import msgspec
import numpy as np

from agent.evaluation.cases import Case
from agent.evaluation.statistics import rate, summarise
from agent.mdp.greedy import GreedyPolicy
from cosim.model.outcome import ENDS, SUCCESS, Outcome
from cosim.model.scenario import Cell
from cosim.simulation.result import EpisodeResult


class Measured(msgspec.Struct, frozen=True, kw_only=True):
    """Statistics over the episodes of a case; None where there is none.

    Every outcome has the share of the episodes that ended so, and its 95 % Wilson interval.

    Rates are over all episodes, and so is `min_distance_cm`, the smallest distance between two
    robots' centres in any of them. Path, rotation, time and energy are means over successful
    episodes, path and rotation also over the robots, the energy summed over them.
    `path_ratio_to_grid` is the mean over the episodes that succeed here and on the grid of the path
    over that of the same policy's exact grid episode from the same start, with its 95 % Student
    interval.
    """

    episodes: int
    success: float | None
    success_low: float | None
    success_high: float | None
    collision: float | None
    collision_low: float | None
    collision_high: float | None
    out_of_board: float | None
    out_of_board_low: float | None
    out_of_board_high: float | None
    timeout: float | None
    timeout_low: float | None
    timeout_high: float | None
    path_length_cm: float | None
    rotation_deg: float | None
    path_ratio_to_grid: float | None
    path_ratio_to_grid_low: float | None
    path_ratio_to_grid_high: float | None
    min_distance_cm: float | None
    sim_time_s: float | None
    energy_j: float | None


class Failure(msgspec.Struct, frozen=True):
    """A start that did not end in success: its index and cells, the outcome, its recording."""

    index: int
    starts: tuple[Cell, ...]
    outcome: Outcome
    recording: str | None


def summary(case: Case, results: Mapping[int, EpisodeResult]) -> Measured:
    """Statistics over episodes.

    Args:
        case: policy and configuration.
        results: by index of the start.
    """
    episodes = len(results)
    shares: dict[str, float | None] = {}
    for outcome in ENDS:
        share = low = high = None
        if episodes:
            share, low, high = rate(sum(r.outcome == outcome for r in results.values()), episodes)
        shares |= {outcome: share, f"{outcome}_low": low, f"{outcome}_high": high}
    successes = {index: r for index, r in results.items() if r.outcome == Outcome.SUCCESS}
    distances = [r.min_distance_cm for r in results.values() if r.min_distance_cm is not None]
    ratio = summarise(_ratios_to_grid(case, successes), 0.0)
    return Measured(
        episodes=episodes,
        **shares,
        path_length_cm=_mean([r.path_length_cm for r in successes.values()]),
        rotation_deg=_mean([r.rotation_deg for r in successes.values()]),
        path_ratio_to_grid=ratio.mean,
        path_ratio_to_grid_low=ratio.low,
        path_ratio_to_grid_high=ratio.high,
        min_distance_cm=min(distances, default=None),
        sim_time_s=_mean([r.sim_time_s for r in successes.values()]),
        energy_j=_mean([r.energy_j for r in successes.values()]),
    )


def _mean(values: list[float]) -> float | None:
    return float(np.mean(values)) if values else None


def _ratios_to_grid(case: Case, successes: Mapping[int, EpisodeResult]) -> np.ndarray:
    """(episodes,) float64, NaN where the policy fails on the grid."""
    if not successes:
        return np.empty(0)
    policy = case.policy
    if not isinstance(policy, GreedyPolicy):
        return np.full(len(successes), np.nan)
    grid = policy.evaluate(case.starts[[index % len(case.starts) for index in successes]])
    cell_cm = 100.0 * policy.config.scenario.cell_m
    expected = cell_cm * grid.path_cells.mean(axis=1)
    expected[grid.outcome != SUCCESS] = np.nan
    return np.array([r.path_length_cm for r in successes.values()]) / expected


def failures(results: Mapping[int, EpisodeResult]) -> tuple[Failure, ...]:
    """Starts that did not end in success, by index."""
    return tuple(
        Failure(index, r.starts, r.outcome, r.recording)
        for index, r in sorted(results.items())
        if r.outcome != Outcome.SUCCESS
    )

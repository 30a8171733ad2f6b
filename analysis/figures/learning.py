"""Result folders of `agent.experiments`: their content, learning curves as arrays and panels."""

from dataclasses import dataclass
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from agent.evaluation.statistics import mean_intervals
from agent.experiments.results import ExperimentResult
from agent.training.loop import TrainingLog
from agent.training.runs import policy_paths
from agent.training.store import LOG_FILE
from analysis.figures.style import WIDTH_IN, FigureError

POINTS = 200  # drawn per curve; a point is the mean of the learning curve's points that it covers


@dataclass(frozen=True)
class VariantCurves:
    """Learning curves of one variant of an experiment.

    Attributes:
        label: for people.
        scenario: name.
        logs: one per run.
    """

    label: str
    scenario: str
    logs: tuple[TrainingLog, ...]

    def curves(self, name: str) -> np.ndarray:
        """(runs, points) float64, a curve of `TrainingLog` over all runs."""
        return np.stack([getattr(log, name) for log in self.logs])


def load_variants(folder: Path, content: ExperimentResult) -> dict[str, VariantCurves]:
    """Learning curves of a result folder's variants by name.

    Raises:
        FigureError: runs are missing.
    """
    variants = {}
    for name, variant in content.variants.items():
        policies = policy_paths(folder / name)
        if len(policies) != len(variant.runs):
            raise FigureError(
                f"{folder / name}: runs are missing; run `python -m agent.experiments "
                f"{content.experiment} --out {folder}`"
            )
        logs = tuple(TrainingLog.load(path.with_name(LOG_FILE)) for path in policies)
        variants[name] = VariantCurves(variant.label, variant.scenario, logs)
    return variants


def settled_after(variant: VariantCurves, success: float) -> int | None:
    """Training episodes after which the mean greedy success stays above a rate; None if never."""
    rates, episodes = variant.curves("greedy_success").mean(axis=0), variant.logs[0].greedy_episode
    low = np.flatnonzero(rates < success)
    if not len(low):
        return int(episodes[0])
    return int(episodes[low[-1] + 1]) if low[-1] + 1 < len(episodes) else None


def thinned(episodes: np.ndarray, curves: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Curves (runs, points) with at most `POINTS` points, means over neighbours without NaN."""
    size = -(-curves.shape[1] // POINTS)
    whole = curves.shape[1] // size * size
    blocks = curves[:, :whole].reshape(len(curves), -1, size)
    known = np.isfinite(blocks)
    with np.errstate(invalid="ignore"):
        means = np.where(known, blocks, 0.0).sum(axis=2) / known.sum(axis=2)
    return episodes[:whole].reshape(-1, size).mean(axis=1), means


def plot_band(axes: Axes, episodes: np.ndarray, curves: np.ndarray, label: str) -> None:
    """Mean over runs with its 95 % Student interval, where there is one."""
    episodes, curves = thinned(episodes, curves)
    known = np.isfinite(curves).any(axis=0)
    episodes, curves = episodes[known] / 1e6, curves[:, known]
    (line,) = axes.plot(episodes, np.nanmean(curves, axis=0), label=label)
    low, high = mean_intervals(curves)
    axes.fill_between(episodes, low, high, color=line.get_color(), alpha=0.25, linewidth=0)


def draw_by_scenario(variants: dict[str, VariantCurves]) -> Figure:
    """Success rate and path length of the greedy policy over episodes, a scenario per column."""
    scenarios = list(dict.fromkeys(v.scenario for v in variants.values()))
    rows = (("greedy_success", 100.0, "success in %"), ("greedy_path_length_cm", 1.0, "path in cm"))
    figure, grid = plt.subplots(
        2, len(scenarios), figsize=(WIDTH_IN, 4.0), sharex=True, sharey="row", squeeze=False
    )
    for axes, (curve, factor, label) in zip(grid, rows, strict=True):
        for variant in variants.values():
            place = axes[scenarios.index(variant.scenario)]
            episodes, curves = variant.logs[0].greedy_episode, factor * variant.curves(curve)
            plot_band(place, episodes, curves, variant.label.removeprefix(f"{variant.scenario}, "))
        axes[0].set_ylabel(label)
    for axes, name in zip(grid.T, scenarios, strict=True):
        axes[0].set_title(f"scenario {name}", loc="left")
        axes[1].set_xlabel("episodes in millions")
    grid[0, 0].legend(loc="upper left")
    return figure


def draw_learning_curves(variants: dict[str, VariantCurves]) -> Figure:
    """Success rate and path length over episodes: while exploring, and of the greedy policy."""
    figure, grid = plt.subplots(2, 2, figsize=(WIDTH_IN, 4.6), sharex=True)
    rows = (("episode", "", "while learning"), ("greedy_episode", "greedy_", "greedy, all starts"))
    for axes, (episode, prefix, title) in zip(grid, rows, strict=True):
        for variant in variants.values():
            episodes = getattr(variant.logs[0], episode)
            success = 100.0 * variant.curves(f"{prefix}success")
            path_length_cm = variant.curves(f"{prefix}path_length_cm")
            plot_band(axes[0], episodes, success, variant.label)
            plot_band(axes[1], episodes, path_length_cm, variant.label)
        axes[0].set_title(title, loc="left")
        axes[0].set(ylabel="success in %", ylim=(-3, 103))
        axes[1].set_ylabel("path length in cm")
    for axes in grid[1]:
        axes.set_xlabel("episodes in millions")
    runs = len(next(iter(variants.values())).logs)
    grid[0, 1].set_title(f"mean of {runs} runs, 95 % interval", loc="right")
    grid[0, 0].legend(loc="lower right")
    return figure

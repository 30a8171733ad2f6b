"""Result folders of `agent.experiments` as arrays, and the panels of figures 8, 10 and 11."""

import json
from dataclasses import dataclass
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from agent.experiments import RESULTS_FILE
from agent.policy import Policy
from agent.runs import policy_paths
from agent.statistics import bootstrap_interval, summarise
from agent.store import LOG_FILE
from agent.training import TrainingLog
from analysis.style import WIDTH_IN, FigureError

POINTS = 200  # drawn per curve; a point is the mean of the learning curve's points that it covers


@dataclass(frozen=True)
class Variant:
    """Learning curves of one variant of an experiment.

    Attributes:
        label: for people.
        logs: one per run.
        policies: paths of the runs' policies.
    """

    label: str
    logs: tuple[TrainingLog, ...]
    policies: tuple[Path, ...]

    def curves(self, name: str) -> np.ndarray:
        """(runs, points) float64, a curve of `TrainingLog` over all runs."""
        return np.stack([getattr(log, name) for log in self.logs])


def load_experiment(folder: Path, experiment: str) -> dict[str, Variant]:
    """Variants of a result folder by name.

    Raises:
        FigureError: it is no result folder of that experiment.
    """
    command = f"python -m agent.experiments {experiment} --out {folder}"
    try:
        content = json.loads((folder / RESULTS_FILE).read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise FigureError(f"{folder}: no results; run `{command}` first") from None
    except ValueError:
        content = {}
    if content.get("experiment") != experiment:
        raise FigureError(f"{folder}: not results of {experiment}; run `{command}`")
    variants = {}
    for name, variant in content["variants"].items():
        policies = policy_paths(folder / name)
        if len(policies) != len(variant["runs"]):
            raise FigureError(f"{folder / name}: runs are missing; run `{command} --resume`")
        logs = tuple(TrainingLog.load(path.with_name(LOG_FILE)) for path in policies)
        variants[name] = Variant(variant["label"], logs, tuple(policies))
    return variants


def first_policy(variant: Variant) -> Policy:
    """Policy of the first run."""
    return Policy.load(variant.policies[0])


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
    """Mean over runs with its 95 % bootstrap interval."""
    episodes, curves = thinned(episodes, curves)
    known = np.isfinite(curves).any(axis=0)
    episodes, curves = episodes[known] / 1e6, curves[:, known]
    (line,) = axes.plot(episodes, np.nanmean(curves, axis=0), label=label)
    low, high = bootstrap_interval(curves)
    axes.fill_between(episodes, low, high, color=line.get_color(), alpha=0.25, linewidth=0)


def draw_learning_curves(variants: dict[str, Variant]) -> Figure:
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


def summary(variants: dict[str, Variant]) -> list[str]:
    """Where the curves end, and when success first stays above 99 %."""
    lines = []
    for variant in variants.values():
        success = variant.curves("greedy_success")
        path = summarise(variant.curves("greedy_path_length_cm")[:, -1])
        low = np.flatnonzero(success.mean(axis=0) < 0.99)
        episodes = variant.logs[0].greedy_episode
        if not len(low):
            since = "from the first evaluation on"
        elif low[-1] + 1 < len(episodes):
            since = f"from {episodes[low[-1] + 1]:,} episodes on"
        else:
            since = "not reached"
        lines.append(
            f"{variant.label}: success {success[:, -1].mean():.2%}, path {path.mean:.2f} cm; "
            f"greedy success above 99 % {since}"
        )
    return lines

"""Figures 8, 10, 11 and `sequel`: learning curves of experiments; path lengths next to bounds."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.stats import binomtest

from agent.evaluation.statistics import interval_text, mean_intervals
from agent.experiments.results import ExperimentResult, VariantResult
from agent.training.loop import TrainingLog
from agent.training.runs import policy_paths
from agent.training.store import LOG_FILE
from analysis.figures.style import WIDTH_IN, Drawing, figure, verdict, verdicts
from analysis.reading.results import RESULTS, read_experiment
from cosim.base.colours import BLUE, GREY, VERMILION
from cosim.base.errors import UserError

POINTS = 200  # drawn per curve; a point is the mean of the learning curve's points that it covers
# Success rate that counts as learnt.
LEARNT = 0.99
OPTIMAL = 1.002  # over the optimum, to be called optimal
_PAPERS_C = "c1.5"  # the variant of Fig. 10 to which others are compared
_LONGER_CM = 2.0  # largest difference of paths that is drawn
LEAST_RUNS = 5  # with fewer, runs are drawn themselves: their interval says nothing
_SPREAD = "bands: 95 % intervals of the mean over runs; of fewer than five runs: each run, thin"
_CURVES = (
    "Upper row: mean over the last 100 episodes, exploring; lower row: the greedy policy at that "
    f"time from every start; {_SPREAD}"
)


@dataclass(frozen=True)
class VariantCurves:
    """Learning curves of one variant of an experiment, a log per run."""

    label: str
    scenario: str
    logs: tuple[TrainingLog, ...]

    def curves(self, name: str) -> np.ndarray:
        """(runs, points) float64, a curve of `TrainingLog` over all runs."""
        return np.stack([getattr(log, name) for log in self.logs])


def load_variants(folder: Path, content: ExperimentResult) -> dict[str, VariantCurves]:
    """Learning curves of a result folder's variants by name; refuse if runs are missing."""
    variants = {}
    for name, variant in content.variants.items():
        policies = policy_paths(folder / name)
        if len(policies) != len(variant.runs):
            raise UserError(
                f"{folder / name}: runs are missing; run `minirobots experiments "
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


def plot_band(
    axes: Axes,
    episodes: np.ndarray,
    curves: np.ndarray,
    label: str,
    limits: tuple[float, float] = (0.0, np.inf),
) -> None:
    """Mean over runs with its 95 % Student interval, where there is one; few runs as they are.

    Args:
        curves: (runs, points), NaN where a run has no value.
        limits: least and largest possible value.
    """
    episodes, curves = thinned(episodes, curves)
    known = np.isfinite(curves).any(axis=0)
    episodes, curves = episodes[known] / 1e6, curves[:, known]
    (line,) = axes.plot(episodes, np.nanmean(curves, axis=0), label=label)
    colour = line.get_color()
    if len(curves) < LEAST_RUNS:
        axes.plot(episodes, curves.T, color=colour, alpha=0.5, linewidth=0.5)
        return
    low, high = mean_intervals(curves).clip(*limits)
    axes.fill_between(episodes, low, high, color=colour, alpha=0.25, linewidth=0)


def _draw_pair(pair: Any, variant: VariantCurves, prefix: str, label: str) -> None:
    """Draw success and path length over episodes on two axes; prefix is "" or "greedy_"."""
    episodes = getattr(variant.logs[0], f"{prefix}episode")
    success = 100.0 * variant.curves(f"{prefix}success")
    plot_band(pair[0], episodes, success, label, (0.0, 100.0))
    plot_band(pair[1], episodes, variant.curves(f"{prefix}path_length_cm"), label)


def draw_by_scenario(variants: dict[str, VariantCurves]) -> Figure:
    """Success rate and path length of the greedy policy over episodes, a scenario per column."""
    scenarios = list(dict.fromkeys(v.scenario for v in variants.values()))
    figure, grid = plt.subplots(
        2, len(scenarios), figsize=(WIDTH_IN, 4.0), sharex=True, sharey="row", squeeze=False
    )
    for variant in variants.values():
        label = variant.label.removeprefix(f"{variant.scenario}, ")
        _draw_pair(grid[:, scenarios.index(variant.scenario)], variant, "greedy_", label)
    grid[0, 0].set(ylabel="success in %", ylim=(-3, 103))
    grid[1, 0].set_ylabel("path in cm")
    for axes, name in zip(grid.T, scenarios, strict=True):
        axes[0].set_title(f"scenario {name}", loc="left")
        axes[1].set_xlabel("episodes in millions")
    grid[0, 0].legend(loc="upper left")
    return figure


def draw_learning_curves(
    variants: dict[str, VariantCurves], reference: str | None = None
) -> Figure:
    """Success rate and path length over episodes: while exploring, and of the greedy policy.

    With a reference, below them: how much longer greedy paths are than those of that variant.
    """
    figure = plt.figure(figsize=(WIDTH_IN, 6.4 if reference else 4.6))
    places: list[Any] = [["", " path"], ["greedy_", "greedy_ path"]]
    places += [["difference", "difference"]] if reference else []
    axes = figure.subplot_mosaic(places, sharex=True)
    for prefix, title in (("", "while learning"), ("greedy_", "greedy, all starts")):
        pair = axes[prefix], axes[f"{prefix} path"]
        for variant in variants.values():
            _draw_pair(pair, variant, prefix, variant.label)
        pair[0].set_title(title, loc="left")
        pair[0].set(ylabel="success in %", ylim=(-3, 103))
        means = np.concatenate([np.array(line.get_ydata()) for line in pair[1].lines])
        longest = float(np.nanmax(means, initial=1.0))  # none where no run has arrived yet
        pair[1].set(ylabel="path length in cm", ylim=(0.0, 1.2 * longest))
    if reference:
        _draw_differences(axes["difference"], variants, reference)
    for name in places[1]:  # narrower than what may be below: their ticks are elsewhere
        axes[name].tick_params(labelbottom=True)
    for name in places[-1]:
        axes[name].set_xlabel("episodes in millions")
    runs = len(next(iter(variants.values())).logs)
    spread = "thin: each" if runs < LEAST_RUNS else "95 % interval"
    axes[" path"].set_title(f"mean of {runs} runs, {spread}", loc="right")
    axes[""].legend(loc="lower right")
    return figure


def _draw_differences(axes: Axes, variants: dict[str, VariantCurves], reference: str) -> None:
    """Draw by how much greedy paths of variants are longer, run by run, where both arrive."""
    name, base = "greedy_path_length_cm", variants[reference]
    for variant in variants.values():
        longer = variant.curves(name) - base.curves(name)
        plot_band(axes, base.logs[0].greedy_episode, longer, variant.label, (-np.inf, np.inf))
    axes.set_ylim(-_LONGER_CM, _LONGER_CM)
    axes.set_ylabel(f"cm more than {base.label}")
    axes.set_title("greedy paths, same seeds", loc="left")


@figure(
    "fig10",
    "Success rate and path length of a pair for values of c in Eq. (12), scenario 4. {curves};"
    " lowest row: how much longer greedy paths are than with c = 1.5",
    claim="better results are obtained when c = 1.5.",
    claims=("Fig. 10: “better results are obtained when c = 1.5”",),
    inputs=("fig10",),
)
def fig10(results: Path) -> Drawing:
    """Draw the effect of the coefficient c of Eq. (12)."""
    content = read_experiment("fig10", results)
    found, better = _compared(content, "path_length_cm", 1.0, " cm")
    judged = f"difference of paths to those of c = 1.5: {found}", verdict(better)
    draw = partial(draw_learning_curves, reference=_PAPERS_C)
    return _learning_figure(content, results, judged, ("path_length_cm", found), draw)


@figure(
    "sequel",
    "Success rate and path length of groups of robots over episodes: the greedy policy at that"
    " time from drawn starts; {spread}",
    claim=(
        "double Q-learning offers a more stable and reliable learning process (the sequel, doi "
        "10.1080/01691864.2020.1757507)."
    ),
    claims=("The sequel: “efficient” learning of four robots; double Q “more stable”",),
    inputs=("sequel",),
)
def sequel(results: Path) -> Drawing:
    """Learning curves of groups of four and six robots, by both algorithms of the sequel."""
    content = read_experiment("sequel", results)
    found, stable = _compared(content, "success", 100.0, " %")
    rates = [v.over_runs["success"].mean or 0.0 for v in content.variants.values()]
    ours = (
        f"{100.0 * min(rates):.0f} to {100.0 * max(rates):.0f} % of starts after "
        f"{content.episodes:,} episodes; differences: {found}"
    )
    judged = ours, verdict(stable and min(rates) >= LEARNT)
    return _learning_figure(content, results, judged, ("success", found), draw_by_scenario)


def _learned(name: str, results: Path, *, single: bool = False) -> Drawing:
    """Draw the learning curves of one robot, or of pairs."""
    content, ours, learnt = read_experiment(name, results), [], True
    for variant in content.variants.values():
        succeeded, runs = sum(run.success == 1.0 for run in variant.runs), len(variant.runs)
        low, high = binomtest(succeeded, runs).proportion_ci()
        learnt &= succeeded == runs
        text = f"{variant.scenario}: 100 % of all starts in {succeeded} of {runs} runs"
        text += f" [{100.0 * low:.1f}, {100.0 * high:.1f}]"
        if single:
            text += f", {interval_text(variant.over_runs['steps'])} moves, path "
            text += f"{interval_text(variant.over_runs['ratio_to_bound'], 3)} of the shortest"
        ours.append(text)
    found = f"{verdict(learnt)} on the grid"
    if single:
        measures = {"in moves": "steps_ratio_to_bound", "in centimetres": "ratio_to_bound"}
        over_runs = [variant.over_runs for variant in content.variants.values()]
        found = verdicts(
            {
                where: learnt and all((over[name].mean or np.inf) < OPTIMAL for over in over_runs)
                for where, name in measures.items()
            }
        )
    return _learning_figure(content, results, ("; ".join(ours), found))


@figure(
    "fig08",
    "Success rate and path length of one robot over episodes, scenarios 1a and 1b. {curves}",
    claim="in both scenarios the optimal policy is achieved quickly.",
    claims=("Fig. 8: one robot, “the optimal policy is achieved quickly”",),
    inputs=("fig08",),
)
def fig08(results: Path) -> Drawing:
    """Draw the learning curves of one robot."""
    return _learned("fig08", results, single=True)


@figure(
    "fig11",
    "Success rate and path length of pairs over episodes, scenarios 2, 3 and 4. {curves}",
    claim=(
        "both robots learn to reach their targets without colliding, also where the targets make "
        "the scenario harder."
    ),
    claims=("Fig. 11: pairs learn to reach their targets",),
    inputs=("fig11",),
)
def fig11(results: Path) -> Drawing:
    """Draw the learning curves of pairs."""
    return _learned("fig11", results)


def _compared(
    content: ExperimentResult, measure: str, factor: float, unit: str
) -> tuple[str, bool | None]:
    """Return how variants differ from their references, and whether all are above them.

    The second is None if a difference has no interval.
    """
    found = {name: measures[measure] for name, measures in content.differences.items()}
    text = "; ".join(
        f"{content.variants[name].label} {interval_text(difference, 2, factor, unit)}"
        for name, difference in found.items()
    )
    lows = [difference.low for difference in found.values()]
    return text, None if None in lows else all(low > 0.0 for low in lows if low is not None)


def _learning_figure(
    content: ExperimentResult,
    results: Path,
    judged: tuple[str, str],
    compared: tuple[str, str] | None = None,
    draw: Callable[[dict[str, VariantCurves]], Figure] = draw_learning_curves,
) -> Drawing:
    """Return the learning curves of an experiment, with a sentence for each variant.

    `compared` is the measure in which variants differ from their references, and how.
    """
    variants = load_variants(RESULTS[content.experiment].location(results), content)
    numbers: dict[str, Any] = {"episodes": content.episodes}
    ours = []
    for name, variant in variants.items():
        over_runs = content.variants[name].over_runs
        numbers[name] = {key: over_runs[key] for key in ("success", "path_length_cm", "steps")}
        numbers[name]["learnt_after_episodes"] = settled_after(variant, LEARNT)
        ours.append(_sentence(variant, numbers[name]))
    if compared:
        measure, found = compared
        of = measure.removesuffix("_cm").replace("_", " ")
        ours.append(f"Difference in {of} from the reference, run by run: {found}.")
        for name, measures in content.differences.items():
            numbers[f"{name}_{measure}_difference"] = measures[measure]
    words = {"curves": _CURVES, "spread": _SPREAD}
    return Drawing(draw(variants), tuple(ours), numbers, (judged,), words)


def _sentence(variant: VariantCurves, numbers: dict[str, Any]) -> str:
    after = numbers["learnt_after_episodes"]
    since = f"above 99 % from {after:,} episodes on" if after else "not above 99 % at the end"
    success = interval_text(numbers["success"], 1, 100.0, " %")
    path = interval_text(numbers["path_length_cm"], unit=" cm")
    runs = numbers["success"].runs
    return f"{variant.label}: success {success} ({since}), path {path}, {runs} runs."


@figure(
    "path_ratio",
    "Path length (left) and moves (right) of the greedy policies over those of the shortest "
    "collision-free joint paths; dots: runs; bars: mean and 95 % interval over five runs or "
    "more",
    claim=(
        "“optimal” is the shortest path; the paths found are called optimal for one robot and "
        "sub-optimal for pairs, without a measure."
    ),
    inputs=("fig08", "fig11"),
)
def path_ratio(results: Path) -> Drawing:
    """Path length and moves of every run over those of the exact optimum."""
    variants: dict[str, VariantResult] = {}
    for name in ("fig08", "fig11"):
        variants |= read_experiment(name, results).variants
    numbers, ours = {}, []
    for name, variant in variants.items():
        path, moves = (variant.over_runs[key] for key in _RATIOS)
        numbers[name] = {"path_length": path, "moves": moves}
        texts = interval_text(path, 3), interval_text(moves, 3)
        ours.append(f"{variant.label}: path {texts[0]}, moves {texts[1]}.")
    return Drawing(draw_ratios(variants), tuple(ours), numbers)


_RATIOS = {"ratio_to_bound": ("path length", BLUE), "steps_ratio_to_bound": ("moves", VERMILION)}


def draw_ratios(variants: dict[str, VariantResult]) -> Figure:
    """Path length and moves over the optimum: a dot for each run, means with intervals."""
    figure, grid = plt.subplots(1, 2, figsize=(WIDTH_IN, 2.8), sharey=True)
    random = np.random.default_rng(0)  # spreads dots that would hide each other
    for axes, (key, (title, colour)) in zip(grid, _RATIOS.items(), strict=True):
        for place, variant in enumerate(variants.values()):
            values = [v for run in variant.runs if (v := getattr(run, key)) is not None]
            spread = random.uniform(-0.15, 0.15, len(values))
            axes.plot(place + spread, values, ".", color=GREY, markersize=4, alpha=0.6)
            s = variant.over_runs[key]
            mean, low, high = (np.nan if v is None else v for v in (s.mean, s.low, s.high))
            if s.runs >= LEAST_RUNS and np.isfinite(high - low):
                bars = np.maximum([[mean - low], [high - mean]], 0.0)
                axes.errorbar(place, mean, bars, fmt="o", color=colour, capsize=4)
        axes.axhline(1.0, color=GREY, linewidth=0.8)
        axes.set_xticks(range(len(variants)), [v.scenario for v in variants.values()])
        axes.set_xlabel("scenario")
        axes.set_title(title, loc="left")
    grid[0].set_ylabel("ratio to the exact optimum")
    return figure

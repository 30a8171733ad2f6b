"""Result files of trained runs, and an experiment's result as tables."""

from collections import defaultdict
from collections.abc import Mapping

import msgspec
import numpy as np

from agent.evaluation.rows import Row
from agent.evaluation.statistics import Statistics, interval_text, summarise
from agent.experiments.variants import Name
from agent.study.grid import GridReport
from agent.training.loop import Learnt
from agent.training.runs import run_name
from cosim.base.table import show_texts

RESULTS_FILE = "results.json"
SUMMARY_FILE = "summary.json"

_COMPARED = ("success", "path_length_cm", "steps")


class TrainingSummary(GridReport, frozen=True, kw_only=True):
    """Content of `summary.json`: runs of one configuration; `seconds` is the time of training."""

    seconds: float
    out: str
    training: tuple[Learnt, ...] = ()  # of the runs, in their order

    def show(self) -> None:
        """Print the tables, and what training has achieved."""
        super().show()
        for run, achieved in enumerate(self.training):
            print(f"training of {run_name(run)}: {achieved}")


class VariantResult(msgspec.Struct, frozen=True):
    """Runs of a variant, in their order, and statistics of each measure over them."""

    label: str
    scenario: str
    reference: str | None
    runs: tuple[Row, ...]
    over_runs: dict[str, Statistics]


class ExperimentResult(msgspec.Struct, frozen=True, kw_only=True):
    """Content of `results.json` for an experiment."""

    schema_version: int = 2
    experiment: Name
    seed: int
    episodes: int  # of training, of each run
    seconds: float  # that training took, without what was there already
    out: str
    variants: dict[str, VariantResult]
    differences: dict[str, dict[str, Statistics]]  # of each variant from its reference, by measure
    effects: dict[str, dict[str, Statistics]] = {}  # of a factorial's differences, see `effects`


def differences(variants: Mapping[str, VariantResult]) -> dict[str, dict[str, Statistics]]:
    """Return statistics of variants' runs minus the runs of the same seeds of their references."""

    def values(name: str) -> np.ndarray:
        runs = variants[name].runs
        return np.array([[getattr(run, measure) for measure in _COMPARED] for run in runs], float)

    return {
        name: _by_measure(values(name) - values(variant.reference))
        for name, variant in variants.items()
        if variant.reference is not None
    }


def effects(
    variants: Mapping[str, VariantResult], found: Mapping[str, Mapping[str, Statistics]]
) -> dict[str, dict[str, Statistics]]:
    """Return statistics of differences over all combinations of a factorial that share a level.

    Args:
        variants: by name, with the words of their levels as labels.
        found: their differences; each combination counts once, with the mean over its runs.

    Returns:
        By level and value of c, as "all c2" and "zone c2", and measure.
    """
    groups = defaultdict[str, list[Mapping[str, Statistics]]](list)
    for name, difference in found.items():
        *levels, c = variants[name].label.split()
        for level in ("all", *levels):
            groups[f"{level} {c}"].append(difference)
    return {
        group: _by_measure(np.array([[d[m].mean for m in _COMPARED] for d in members], float))
        for group, members in groups.items()
    }


def _by_measure(differences: np.ndarray) -> dict[str, Statistics]:
    """Return statistics of differences (n, measures), NaN where there is none, by measure."""
    limits = {"success": (-1.0, 1.0)}
    return {
        measure: summarise(column, *limits.get(measure, ()))
        for measure, column in zip(_COMPARED, differences.T, strict=True)
    }


def show(result: ExperimentResult) -> None:
    """Print the statistics of every variant on stdout: mean and 95 % interval over runs."""
    header = ("variant", "success", "path length in cm", "moves", "path over optimum")
    measures = (*_COMPARED, "ratio_to_bound")
    variants = result.variants
    rows = [(v.label, *_intervals(v.over_runs, measures)) for v in variants.values()]
    show_texts(header, rows)
    if result.differences:
        header = ("difference, run by run", *header[1:4])
        rows = [
            (
                f"{variants[name].label} minus {variants[variants[name].reference or ''].label}",
                *_intervals(statistics, _COMPARED),
            )
            for name, statistics in result.differences.items()
        ]
        show_texts(header, rows)
    if result.effects:
        header = ("mean difference, over combinations", *header[1:4])
        effects = result.effects.items()
        show_texts(header, [(name, *_intervals(of, _COMPARED)) for name, of in effects])
    print(f"{result.seconds:.0f} s; results in {result.out}/: {RESULTS_FILE}, runs by variant")


def _intervals(statistics: Mapping[str, Statistics], measures: tuple[str, ...]) -> list[str]:
    forms = {"success": (2, 100.0, " %"), "ratio_to_bound": (3,)}
    return [interval_text(statistics[name], *forms.get(name, (2,))) for name in measures]

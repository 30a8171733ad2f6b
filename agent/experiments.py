"""`python -m agent.experiments`: learning experiments of Section V, and on what it leaves open.

An experiment is a set of variants; each variant is a folder of runs as `agent.train` makes it, and
all variants share their seeds. Figures are drawn from the results by `analysis`.
"""

import json
import math
import time
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import tyro
from rich.console import Console

from agent.evaluation.grid import report_of, statistics_of
from agent.process.config import Feature, ProcessConfig
from agent.train import progress_bar
from agent.training.runs import Experiment, RunResult, train_runs
from agent.training.settings import LearningConfig
from agent.training.sweep import Backend
from cosim.base.errors import UserError, run_command
from cosim.base.scenario import find_scenario
from cosim.base.storage import replacing
from cosim.base.tables import show_table

RESULTS_FILE = "results.json"

Name = Literal["fig08", "fig10", "fig11", "features", "readings"]


class Variant(NamedTuple):
    """One line of a figure or table.

    Attributes:
        label: for people.
        scenario: name of a built-in scenario.
        process: readings of the decision process.
        learning: learning configuration, whose number of episodes the command may change.
    """

    label: str
    scenario: str
    process: ProcessConfig = ProcessConfig()
    learning: LearningConfig = LearningConfig()


def _scenarios(*names: str) -> dict[str, Variant]:
    return {name: Variant(f"scenario {name}", name) for name in names}


# The paper does not say on which scenario Fig. 10 was made; 4 has the most encounters (assumed).
_HARDEST = "4"
_FEATURES: tuple[tuple[Feature, ...], ...] = (
    ("x", "y"),
    ("x", "y", "d"),
    ("x", "y", "g"),
    ("x", "y", "d", "g"),
    ("x", "y", "d", "g", "b"),
)

EXPERIMENTS: dict[Name, dict[str, Variant]] = {
    "fig08": _scenarios("1a", "1b"),
    "fig10": {
        f"c{c:g}": Variant(f"c = {c:g}", _HARDEST, ProcessConfig(approach_coefficient=c))
        for c in (1.0, 1.5, 2.0, 5.0)
    },
    "fig11": _scenarios("2", "3", "4"),
    "features": {
        "".join(features): Variant(
            f"features {', '.join(features)}", _HARDEST, ProcessConfig(features=features)
        )
        for features in _FEATURES
    },
    "readings": {
        "as_read": Variant("as read here", _HARDEST),
        "swept": Variant("contact along the moves", _HARDEST, ProcessConfig(collision="swept")),
        "disk": Variant("targets are disks", _HARDEST, ProcessConfig(target_obstacle="disk")),
        "zone": Variant("zone is an obstacle", _HARDEST, ProcessConfig(zone_is_obstacle=True)),
        "penalty": Variant(
            "both pay for a failure", _HARDEST, ProcessConfig(partner_of_failed="penalty")
        ),
        "no_update": Variant(
            "partner of a failed robot not updated",
            _HARDEST,
            ProcessConfig(partner_of_failed="none"),
        ),
        "diagonal": Variant("diagonals cost √2", _HARDEST, ProcessConfig(diagonal_cost=2.0**0.5)),
        "slip": Variant("slip 0.2", _HARDEST, ProcessConfig(slip_probability=0.2)),
        "limit200": Variant("step limit 200", _HARDEST, ProcessConfig(step_limit=200)),
        "limit60": Variant("step limit 60", _HARDEST, ProcessConfig(step_limit=60)),
        "eta": Variant("η = 0.001", _HARDEST, learning=LearningConfig(eta=0.001)),
        "linear": Variant("ε linear", _HARDEST, learning=LearningConfig(schedule="linear")),
        "double_q": Variant(
            "double Q-learning", _HARDEST, learning=LearningConfig(algorithm="double_q")
        ),
    },
}

# The variant that the others are compared with, run by run (same seed, same run).
REFERENCES: dict[Name, str] = {"fig10": "c1.5", "features": "xydg", "readings": "as_read"}


@dataclass(frozen=True)
class Experiments:
    """Run a learning experiment of the paper over many seeds and evaluate every run exactly.

    fig08: one robot, scenarios 1a and 1b. fig10: the coefficient c. fig11: pairs, scenarios 2, 3
    and 4. features: which of x, y, d, g (and the bearing b) a robot needs. readings: what each
    assumed reading of the paper changes. Draw the figures with python -m analysis.figures.
    """

    experiment: Annotated[Name, tyro.conf.Positional]
    """Experiment to run."""
    runs: int = 20
    """Independent runs of each variant (the paper: 20)."""
    seed: int = 0
    """Seed that the runs' seeds are spawned from, the same for all variants."""
    out: Path | None = None
    """Output folder; by default runs/<experiment>-<time>."""
    episodes: int = LearningConfig().episodes
    """Training episodes of a run (Section V: 5 000 000)."""
    jobs: int = -1
    """Runs at once; -1 for one per core."""
    backend: Backend = "loky"
    """Where runs are computed: processes or threads here, or a Ray or Dask cluster (extras)."""
    address: str | None = None
    """Address of the cluster's head; without it Ray and Dask start on this machine."""
    resume: bool = False
    """Go on with the runs of --out, from their checkpoints."""
    json: bool = False
    """Print a JSON object as the last line of output."""

    def __post_init__(self) -> None:
        if self.runs < 1 or self.episodes < 1 or self.jobs == 0:
            raise UserError("--runs, --episodes and --jobs must be at least 1 (or --jobs -1)")


def run_experiment(options: Experiments, console: Console) -> dict[str, Any]:
    """Train and evaluate all variants; writes `results.json` and returns its content.

    Raises:
        UserError: see its message.
    """
    name = f"{options.experiment}-{datetime.now():%Y%m%d-%H%M%S}"
    out = options.out or Path("runs") / name
    began = time.perf_counter()
    variants: dict[str, Any] = {}
    for key, variant in EXPERIMENTS[options.experiment].items():
        experiment = Experiment(
            find_scenario(variant.scenario),
            variant.process,
            replace(variant.learning, episodes=options.episodes),
            options.seed,
            options.runs,
        )
        results: list[RunResult] = []
        with progress_bar(out / key, experiment, results, console, label=variant.label):
            for result in train_runs(
                experiment,
                out / key,
                jobs=options.jobs,
                backend=options.backend,
                address=options.address,
                resume=options.resume,
            ):
                results.append(result)  # noqa: PERF402 - the bar looks at the list meanwhile
        results.sort(key=lambda result: result.run)
        report = report_of((f"{key}/run_{r.run:03d}", r.policy) for r in results)
        (statistics,) = report["over_policies"].values()
        variants[key] = {
            "label": variant.label,
            "scenario": variant.scenario,
            "runs": [{k: v for k, v in r.items() if k != "failures"} for r in report["policies"]],
            "over_runs": statistics,
        }
    content = {
        "schema_version": 1,
        "experiment": options.experiment,
        "seed": options.seed,
        "episodes": options.episodes,
        "seconds": time.perf_counter() - began,
        "out": str(out),
        "variants": variants,
        "differences": _differences(variants, REFERENCES.get(options.experiment)),
    }
    with replacing(out / RESULTS_FILE) as temporary:
        temporary.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    return content


def _differences(variants: dict[str, Any], reference: str | None) -> dict[str, Any]:
    """Statistics of each variant's runs minus the reference's runs of the same seeds."""
    if reference is None:
        return {}
    base = variants[reference]["runs"]
    return {
        name: {
            measure: statistics_of(
                _minus(run[measure], other[measure])
                for run, other in zip(variant["runs"], base, strict=True)
            )
            for measure in ("success", "path_length_cm", "steps")
        }
        for name, variant in variants.items()
        if name != reference
    }


def _minus(a: float | None, b: float | None) -> float:
    return math.nan if a is None or b is None else a - b


def show(content: dict[str, Any], console: Console) -> None:
    """Print the statistics of every variant: mean and 95 % interval over runs."""
    rows = []
    for variant in content["variants"].values():
        cells = [
            _interval(variant["over_runs"][name], factor, digits, unit)
            for name, factor, digits, unit in (
                ("success", 100.0, 2, " %"),
                ("path_length_cm", 1.0, 2, ""),
                ("steps", 1.0, 2, ""),
                ("ratio_to_bound", 1.0, 3, ""),
            )
        ]
        rows.append((variant["label"], *cells))
    header = ("variant", "success", "path length in cm", "moves", "path over optimum")
    show_table(console, header, rows)
    if content["differences"]:
        reference = content["variants"][REFERENCES[content["experiment"]]]["label"]
        rows = []
        for name, measures in content["differences"].items():
            cells = [
                _interval(measures["success"], 100.0, 2, " %"),
                _interval(measures["path_length_cm"], 1.0, 2, ""),
                _interval(measures["steps"], 1.0, 2, ""),
            ]
            rows.append((content["variants"][name]["label"], *cells))
        header = (f"minus {reference}, run by run", "success", "path length in cm", "moves")
        show_table(console, header, rows)
    console.print(
        f"{content['seconds']:.0f} s; results in {content['out']}/: {RESULTS_FILE}, runs by variant"
    )


def _interval(s: dict[str, float | None], factor: float, digits: int, unit: str) -> str:
    values = [s[name] for name in ("mean", "low", "high")]
    if None in values:
        return "–"
    mean, low, high = (f"{factor * (v or 0.0):.{digits}f}" for v in values)
    return f"{mean}{unit} [{low}, {high}]"


def main() -> None:
    """Command line; see `Experiments`."""
    options = tyro.cli(
        Experiments, prog="python -m agent.experiments", config=(tyro.conf.FlagCreatePairsOff,)
    )
    content = run_experiment(options, Console(stderr=True))
    show(content, Console())
    if options.json:
        print(json.dumps(content))


if __name__ == "__main__":
    run_command(main)

"""Train runs and evaluate them: of one configuration, or of all variants of an experiment."""

import time
from dataclasses import replace
from pathlib import Path

import msgspec

from agent.evaluation.grid import PolicyMeasures, report_of
from agent.experiments.results import (
    RESULTS_FILE,
    SUMMARY_FILE,
    ExperimentResult,
    TrainingSummary,
    VariantResult,
    differences,
    effects,
)
from agent.experiments.variants import EXPERIMENTS, REFERENCES, Name
from agent.training.recording import require_tensorboard, write_events, write_runs
from agent.training.runs import RECORDING_FILE, Experiment, make_runs, run_name
from agent.training.settings import LearningConfig
from agent.training.store import POLICY_FILE
from cosim.base.jobs import PROCESSES, Workers
from cosim.base.progress import Progress, silent
from cosim.base.storage import write_json
from cosim.model.scenario_file import find_scenario


def train_and_evaluate(
    experiment: Experiment,
    out: Path,
    *,
    where: Workers = PROCESSES,
    log: Path | None = None,
    progress: Progress = silent,
) -> TrainingSummary:
    """Train the runs of one configuration, evaluate them and write `summary.json`.

    Args:
        experiment: what to train.
        out: folder, which may have some of the runs already.
        where, progress: see `agent.training.runs.make_runs`.
        log: folder of event files for TensorBoard, one in a folder for each run.

    Raises:
        UserError: see `agent.training.runs.make_runs`; or event files cannot be written.
    """
    if log is not None:
        require_tensorboard()
    began = time.perf_counter()
    scenario = experiment.scenario.name
    results = make_runs(
        experiment, out, where=where, progress=progress, task=f"scenario {scenario}"
    )
    seconds = time.perf_counter() - began
    if log is not None:
        for number, (_, curves) in enumerate(results):
            write_events(log / run_name(number), curves)
    named = enumerate(policy for policy, _ in results)
    report = report_of((f"{run_name(k)}/{POLICY_FILE}", policy) for k, policy in named)
    if experiment.runs > 1:
        facts = {"scenario": scenario, "seed": experiment.seed}
        write_runs(out / RECORDING_FILE, [curves for _, curves in results], facts)
    summary = TrainingSummary(
        policies=report.policies,
        over_policies=report.over_policies,
        seed=experiment.seed,
        seconds=seconds,
        out=str(out),
    )
    write_json(out / SUMMARY_FILE, summary)
    return summary


def run_experiment(
    name: Name,
    out: Path,
    *,
    runs: int = 20,
    seed: int = 0,
    episodes: int = LearningConfig().episodes,
    where: Workers = PROCESSES,
    progress: Progress = silent,
) -> ExperimentResult:
    """Train and evaluate all variants of an experiment and write `results.json`.

    Args:
        name: of the experiment.
        out: folder, which may have some of the runs already.
        runs: of each variant.
        seed: that the runs' seeds are spawned from, the same for all variants.
        episodes: of training, of each run.
        where, progress: see `agent.training.runs.make_runs`.

    Raises:
        UserError: see `agent.training.runs.make_runs`.
    """
    began = time.perf_counter()
    variants: dict[str, VariantResult] = {}
    for key, variant in EXPERIMENTS[name].items():
        experiment = Experiment(
            find_scenario(variant.scenario),
            variant.process,
            replace(variant.learning, episodes=episodes),
            seed,
            runs,
        )
        results = make_runs(
            experiment, out / key, where=where, progress=progress, task=variant.label
        )
        named = enumerate(policy for policy, _ in results)
        report = report_of((f"{key}/{run_name(k)}", policy) for k, policy in named)
        # no single failures
        rows = msgspec.convert(report.policies, tuple[PolicyMeasures, ...], from_attributes=True)
        statistics = report.over_policies[variant.scenario]
        variants[key] = VariantResult(variant.label, variant.scenario, rows, statistics)
    compared = differences(variants, REFERENCES.get(name, {}))
    result = ExperimentResult(
        experiment=name,
        seed=seed,
        episodes=episodes,
        seconds=time.perf_counter() - began,
        out=str(out),
        variants=variants,
        differences=compared,
        effects=effects(variants, compared) if name == "factorial" else {},
    )
    write_json(out / RESULTS_FILE, result)
    return result

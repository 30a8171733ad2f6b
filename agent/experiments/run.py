"""Train runs and evaluate them: of one configuration, or of all variants of an experiment."""

import time
from dataclasses import replace
from pathlib import Path

import msgspec

from agent.experiments.results import (
    RESULTS_FILE,
    SUMMARY_FILE,
    ExperimentResult,
    TrainingSummary,
    VariantResult,
    differences,
    effects,
)
from agent.experiments.variants import ExperimentOptions, variants_of
from agent.study.grid import report_of
from agent.training.loop import learnt
from agent.training.recording import write_runs
from agent.training.runs import RECORDING_FILE, RunsConfig, make_runs, run_name
from agent.training.store import POLICY_FILE
from cosim.base.jobs import PROCESSES, Workers
from cosim.base.progress import Progress, silent
from cosim.base.storage import write_json
from cosim.model.scenario_file import find_scenario


def train_and_evaluate(
    config: RunsConfig,
    out: Path,
    *,
    where: Workers = PROCESSES,
    progress: Progress = silent,
) -> TrainingSummary:
    """Train the runs of one configuration, evaluate them and write `summary.json`.

    Args:
        out: folder, which may have some of the runs already.
    """
    began, scenario = time.perf_counter(), config.scenario.name
    task = f"scenario {scenario}"
    results = make_runs(config, out, where=where, progress=progress, task=task)
    seconds = time.perf_counter() - began
    if config.runs > 1:
        facts = {"scenario": scenario, "seed": config.seed}
        write_runs(out / RECORDING_FILE, [curves for _, curves in results], facts)
    named = ((f"{run_name(k)}/{POLICY_FILE}", policy) for k, (policy, _) in enumerate(results))
    achieved = tuple(learnt(policy.config, curves) for policy, curves in results)
    facts = {"seed": config.seed, "seconds": seconds, "out": str(out), "training": achieved}
    summary = report_of(named, TrainingSummary, **facts)
    write_json(out / SUMMARY_FILE, summary)
    return summary


def run_experiment(options: ExperimentOptions, progress: Progress = silent) -> ExperimentResult:
    """Train and evaluate all variants of an experiment and write `results.json`.

    Its folder may have some of the runs already; the seeds of runs are the same for all variants.
    """
    name, out, episodes = options.experiment, options.out, options.episodes
    assert out is not None
    began = time.perf_counter()
    variants: dict[str, VariantResult] = {}
    for key, variant in variants_of(name).items():
        points = options.greedy_points
        learning = replace(variant.learning, episodes=episodes, greedy_points=points)
        board = find_scenario(variant.scenario)
        settings = board, variant.process, learning, options.seed, options.runs
        config = RunsConfig(*settings, method=variant.method)
        how = {"where": options.where, "progress": progress, "task": variant.label}
        named = enumerate(policy for policy, _ in make_runs(config, out / key, **how))
        report = report_of((f"{key}/{run_name(k)}", policy) for k, policy in named)
        variants[key] = VariantResult(
            variant.label,
            variant.scenario,
            variant.reference,
            tuple(msgspec.structs.replace(row, failures=()) for row in report.rows),
            report.over_policies[variant.scenario],
        )
    compared = differences(variants)
    result = ExperimentResult(
        experiment=name,
        seed=options.seed,
        episodes=episodes,
        seconds=time.perf_counter() - began,
        out=str(out),
        variants=variants,
        differences=compared,
        effects=effects(variants, compared) if name == "factorial" else {},
    )
    write_json(out / RESULTS_FILE, result)
    return result

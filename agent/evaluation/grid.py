"""`python -m agent.evaluate`: exact rates, lengths and failing starts of trained policies.

The report is data first (`report_of`, what `--json` prints) and tables second (`show`).
"""

import json
import math
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro
from rich.console import Console

from agent.evaluation.statistics import summarise
from agent.process.bound import ratios
from agent.process.exact import Evaluation, evaluate
from agent.training.policy import Policy
from agent.training.runs import policy_paths
from cosim.base.errors import UserError, run_command
from cosim.base.outcome import BY_RANK, ENDS, SUCCESS
from cosim.base.tables import show_table

_LISTED_FAILURES = 10
MAX_FAILURES = 1000  # in the report; scenarios of four robots have some 700 000 starts
_MEASURES = (*ENDS, "path_length_cm", "steps", "ratio_to_bound", "steps_ratio_to_bound")


@dataclass(frozen=True)
class EvaluateOnGrid:
    """Evaluate policies exactly: the greedy episode from every combination of start cells.

    Nothing is sampled: scenarios 1a, 1b and 2 to 4 have 30, 116 and 900 starts. Path length and
    moves are means over robots and successful starts; their ratio to the exact optimum
    (python -m agent.process.bound) says how far a policy is from the best possible one.
    """

    policies: Annotated[tuple[Path, ...], tyro.conf.Positional]
    """Policies (policy.npz) or folders of runs made by agent.train."""
    json: bool = False
    """Print a JSON object as the last line of output."""


def measure(policy: Policy) -> tuple[dict[str, float], Evaluation]:
    """Measures of one policy by name, NaN where there is none, and the evaluation they are of."""
    result = evaluate(policy.process, policy.values)
    path_ratio, steps_ratio = ratios(policy.process, result)
    measures = {
        **{name: result.rate(name) for name in ENDS},
        "path_length_cm": 100.0 * policy.config.scenario.cell_m * result.mean_path_cells(),
        "steps": result.mean_steps(),
        "ratio_to_bound": path_ratio,
        "steps_ratio_to_bound": steps_ratio,
    }
    return measures, result


def failures(result: Evaluation) -> list[dict[str, Any]]:
    """Starts that do not end in success, with their outcomes; the first `MAX_FAILURES`."""
    failed = np.flatnonzero(result.outcome != SUCCESS)[:MAX_FAILURES]
    return [
        {"starts": result.starts[k].tolist(), "outcome": BY_RANK[result.outcome[k]]} for k in failed
    ]


def policy_files(paths: tuple[Path, ...]) -> list[Path]:
    """The policies among files and folders of runs that a user named.

    Raises:
        UserError: a folder without runs, or nothing named.
    """
    found: list[Path] = []
    for path in paths:
        inside = policy_paths(path) if path.is_dir() else [path]
        if not inside:
            raise UserError(f"{path}: no run_*/policy.npz in this folder; name a folder of runs")
        found += inside
    if not found:
        raise UserError("no policy named; give policy.npz files or folders of runs")
    return found


def report_of(policies: Iterable[tuple[str, Policy]]) -> dict[str, Any]:
    """Evaluate named policies; the object that `--json` prints, where NaN is null."""
    rows: list[dict[str, Any]] = []
    by_scenario: dict[str, list[dict[str, float]]] = {}
    for name, policy in policies:
        measures, result = measure(policy)
        scenario = policy.config.scenario.name
        by_scenario.setdefault(scenario, []).append(measures)
        rows.append(
            {
                "policy": name,
                "scenario": scenario,
                "starts": len(result.outcome),
                **_null_for_nan(measures),
                "failing_starts": int((result.outcome != SUCCESS).sum()),
                "failures": failures(result),
            }
        )
    over_policies = {
        scenario: {name: statistics_of(m[name] for m in group) for name in group[0]}
        for scenario, group in by_scenario.items()
    }
    return {"schema_version": 1, "policies": rows, "over_policies": over_policies}


def statistics_of(values: Iterable[float]) -> dict[str, float | None]:
    """`agent.evaluation.statistics.Statistics` by name, where NaN is None, as JSON has it."""
    return _null_for_nan(summarise(np.array(list(values)))._asdict())


def _null_for_nan(values: dict[str, float]) -> dict[str, float | None]:
    return {name: v if math.isfinite(v) else None for name, v in values.items()}


def show(report: dict[str, Any], console: Console) -> None:
    """Print a report as tables: each policy, the first failing starts, and statistics."""
    rows = [
        (
            row["policy"],
            row["scenario"],
            str(row["starts"]),
            *(_text(name, row[name]) for name in _MEASURES),
        )
        for row in report["policies"]
    ]
    header = ("policy", "scenario", "starts", *(name.replace("_", " ") for name in _MEASURES))
    show_table(console, header, rows, names=2)
    show_failures(report["policies"], console)
    for scenario, measures in report["over_policies"].items():
        runs = measures["success"]["runs"]
        if runs == 1:
            continue
        rows = []
        for name, s in measures.items():
            mean, iqm, low, high = (_text(name, s[k]) for k in ("mean", "iqm", "low", "high"))
            rows.append((name.replace("_", " "), mean, iqm, f"{low} to {high}"))
        header = (f"scenario {scenario}, {runs} policies", "mean", "IQM", "95 % interval")
        show_table(console, header, rows)


def show_failures(policies: list[dict[str, Any]], console: Console) -> None:
    """Print the first failing starts of each policy of a report."""
    for row in policies:
        for failure in row["failures"][:_LISTED_FAILURES]:
            starts = " ".join(f"({x}, {y})" for x, y in failure["starts"])
            console.print(f"{row['policy']}: {failure['outcome']} from {starts}", soft_wrap=True)
        more = row["failing_starts"] - _LISTED_FAILURES
        if more > 0:
            console.print(f"{row['policy']}: {more} more failing starts (--json lists more)")


def _text(name: str, value: float | None) -> str:
    if value is None:
        return "–"
    if name in ENDS:
        return f"{value:.2%}"
    return f"{value:.3f}" if "ratio" in name else f"{value:.2f}"


def main() -> None:
    """Command line; see `EvaluateOnGrid`."""
    options = tyro.cli(
        EvaluateOnGrid, prog="python -m agent.evaluate", config=(tyro.conf.FlagCreatePairsOff,)
    )
    paths = policy_files(options.policies)
    result = report_of((str(path), Policy.load(path)) for path in paths)
    show(result, Console())
    if options.json:
        print(json.dumps(result))


if __name__ == "__main__":
    run_command(main)

"""Evaluate policies on the grid: rates, lengths and failing starts.

The report is data first (`report_of`, what `--json` prints) and tables second (`show`).
"""

import math
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from agent.evaluation.statistics import Statistics, rate, summarise
from agent.mdp.exact import enumerable, joint_starts
from agent.mdp.greedy import GreedyPolicy
from agent.mdp.optimum import ratios
from agent.training.runs import policy_paths
from cosim.base.errors import UserError
from cosim.base.table import Column, field, format_value, show_texts
from cosim.base.table import show as show_rows
from cosim.model.outcome import BY_RANK, ENDS, SUCCESS, Outcome

MAX_FAILURES = 1000  # in the report

_LISTED_FAILURES = 10
# Measures of tables, with the formats of their values.
_MEASURES = {
    **{str(end): "{:.2%}" for end in ENDS},
    "path_length_cm": "{:.2f}",
    "steps": "{:.2f}",
    "ratio_to_bound": "{:.3f}",
    "steps_ratio_to_bound": "{:.3f}",
}


class PolicyMeasures(msgspec.Struct, frozen=True, kw_only=True):
    """Measures of a policy from its `agent.mdp.exact.joint_starts`.

    Attributes:
        policy: its name.
        scenario: name of its scenario.
        starts: how many there are.
        success_low, success_high: 95 % Wilson interval of `success` over a sample of the starts;
            None where it is exact.
        success, collision, out_of_board, timeout: share of the starts with that outcome.
        path_length_cm: mean over robots and successful starts; None without a success.
        steps: moves, the same mean.
        ratio_to_bound, steps_ratio_to_bound: these over the exact optimum
            (`agent.mdp.optimum.ratios`).
        failing_starts: how many do not end in success.
    """

    policy: str
    scenario: str
    starts: int
    success: float
    collision: float
    out_of_board: float
    timeout: float
    path_length_cm: float | None
    steps: float | None
    ratio_to_bound: float | None
    steps_ratio_to_bound: float | None
    failing_starts: int
    success_low: float | None = None
    success_high: float | None = None


class GridFailure(msgspec.Struct, frozen=True):
    """A start that does not end in success.

    Attributes:
        starts: cell of each robot.
        outcome: how it ends.
    """

    starts: tuple[tuple[int, int], ...]
    outcome: Outcome


class PolicyReport(PolicyMeasures, frozen=True, kw_only=True):
    """Measures of a policy, and the starts where it fails.

    Attributes:
        failures: the first `MAX_FAILURES` failing starts.
    """

    failures: tuple[GridFailure, ...]


class GridReport(msgspec.Struct, frozen=True, kw_only=True):
    """Measures of several policies.

    Attributes:
        schema_version: of the report.
        policies: one by one.
        over_policies: statistics over them, by scenario and measure.
    """

    schema_version: int = 1
    policies: tuple[PolicyReport, ...]
    over_policies: dict[str, dict[str, Statistics]]


def measure(name: str, policy: GreedyPolicy) -> PolicyReport:
    """Evaluate a policy from all starts, or a sample of them."""
    result = policy.evaluate()
    path_ratio, steps_ratio = ratios(policy.process, result)
    failing = np.flatnonzero(result.outcome != SUCCESS)
    scenario = policy.config.scenario
    low = high = None
    starts = len(joint_starts(policy.process)) if enumerable(policy.process) else None
    if len(result.outcome) != starts:  # a sample
        _, low, high = rate(len(result.outcome) - len(failing), len(result.outcome))
    return PolicyReport(
        policy=name,
        scenario=scenario.name,
        starts=len(result.outcome),
        **{str(end): result.rate(end) for end in ENDS},
        path_length_cm=_known(100.0 * scenario.cell_m * result.mean_path_cells()),
        steps=_known(result.mean_steps()),
        ratio_to_bound=_known(path_ratio),
        steps_ratio_to_bound=_known(steps_ratio),
        failing_starts=len(failing),
        success_low=low,
        success_high=high,
        failures=tuple(
            GridFailure(tuple((x, y) for x, y in starts), BY_RANK[outcome])
            for starts, outcome in zip(
                result.starts[failing[:MAX_FAILURES]].tolist(),
                result.outcome[failing[:MAX_FAILURES]],
                strict=True,
            )
        ),
    )


def _known(value: float) -> float | None:
    return None if math.isnan(value) else value


def policy_files(named: Iterable[Any]) -> list[Any]:
    """Return what a user named, with the policies of their runs in place of folders.

    Args:
        named: files and folders; what is neither stays as it is.

    Raises:
        UserError: a folder without runs, or nothing named.
    """
    found: list[Any] = []
    for path in named:
        folder = isinstance(path, str | Path) and Path(path).is_dir()
        inside = policy_paths(Path(path)) if folder else [path]
        if not inside:
            raise UserError(f"{path}: no run_*/policy.npz in this folder; name a folder of runs")
        found += inside
    if not found:
        raise UserError("no policy named; give policy.npz files or folders of runs")
    return found


def report_of(policies: Iterable[tuple[str, GreedyPolicy]]) -> GridReport:
    """Evaluate named policies."""
    rows = tuple(measure(name, policy) for name, policy in policies)
    over_policies = {}
    for scenario in dict.fromkeys(row.scenario for row in rows):
        group = [row for row in rows if row.scenario == scenario]
        over_policies[scenario] = {
            name: summarise(
                [getattr(row, name) for row in group], 0.0, 1.0 if name in ENDS else math.inf
            )
            for name in _MEASURES
        }
    return GridReport(policies=rows, over_policies=over_policies)


def show(report: GridReport) -> None:
    """Print a report as tables on stdout: each policy, the first failing starts, and statistics."""
    measured = (field(name, form) for name, form in _MEASURES.items())
    columns = (field("policy"), field("scenario"), Column("starts", _starts), *measured)
    show_rows(columns, report.policies, names=2)
    show_failures(report.policies)
    for scenario, measures in report.over_policies.items():
        runs = measures["success"].runs
        if runs == 1:
            continue
        rows = []
        for name, s in measures.items():
            values = (s.mean, s.iqm, s.low, s.high)
            mean, iqm, low, high = (format_value(value, _MEASURES[name]) for value in values)
            ends = "–" if s.low is None else f"{low} to {high}"
            rows.append((name.replace("_", " "), mean, iqm, ends))
        header = (f"scenario {scenario}, {runs} policies", "mean", "IQM", "95 % interval")
        show_texts(header, rows)


def show_failures(policies: Iterable[Any]) -> None:
    """Print the first failing starts of policies.

    Args:
        policies: their rows in a report, of this module or of `agent.study.evaluate`.
    """
    for row in policies:
        for failure in row.failures[:_LISTED_FAILURES]:
            starts = " ".join(f"({x}, {y})" for x, y in failure.starts)
            print(f"{row.policy}: {failure.outcome} from {starts}")
        more = row.failing_starts - _LISTED_FAILURES
        if more > 0:
            print(f"{row.policy}: {more} more failing starts (--json lists more)")


def _starts(row: PolicyMeasures) -> str:
    if row.success_low is None:
        return str(row.starts)
    return f"sample of {row.starts}: {row.success_low:.2%} to {row.success_high:.2%}"

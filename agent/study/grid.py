"""Evaluate policies on the grid: rates, lengths and failing starts."""

import math
from collections.abc import Iterable
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from agent.evaluation.rows import OF_POLICIES, POLICY, SCENARIO, Failure, Row
from agent.evaluation.statistics import Statistics, rate, summarise
from agent.mdp.exact import enumerable, joint_starts
from agent.mdp.greedy import GreedyPolicy
from agent.mdp.optimum import ratios
from agent.study.report import Report
from agent.training.methods import METHODS
from agent.training.runs import policy_paths
from agent.training.store import POLICY_FILE
from cosim.base.errors import UserError
from cosim.base.table import Column, field, format_value, show_texts
from cosim.model.outcome import BY_RANK, ENDS, SUCCESS

MAX_FAILURES = 1000  # in the report
_LISTED_FAILURES = 10
# Measures of tables, with the formats of their values and their headings.
_MEASURES = {
    **{str(end): ("{:.2%}", str(end).replace("_", " ")) for end in ENDS},
    "path_length_cm": ("{:.2f}", "path, cm"),
    "steps": ("{:.2f}", "moves"),
    "ratio_to_bound": ("{:.3f}", "path over bound"),
    "steps_ratio_to_bound": ("{:.3f}", "moves over bound"),
}
_COLUMNS = tuple(field(name, *how) for name, how in _MEASURES.items())


def _starts(row: Row) -> str:
    if row.success_low is None:
        return str(row.starts)
    return f"sample of {row.starts}: {row.success_low:.2%} to {row.success_high:.2%}"


class EvaluationReport(Report, frozen=True, kw_only=True):
    """What policies achieve; path, rotation, time and energy are means of successes."""

    table = OF_POLICIES
    title = "outcomes with 95 % intervals"

    def show(self) -> None:
        """Print the table, the first failing starts, and verdicts on claims."""
        super().show()
        show_failures(self.rows)
        for row in self.rows:
            if row.claim is not None:
                print(f"{row.claim.verdict} for {row.policy}: {row.claim}")


class GridReport(Report, frozen=True, kw_only=True):
    """Measures of policies on the grid, and statistics over them by scenario and measure."""

    table = POLICY, SCENARIO, Column("starts", _starts), *_COLUMNS
    brief = Column("policy", lambda row: row.policy.removesuffix(f"/{POLICY_FILE}")), *table[1:]
    over_policies: dict[str, dict[str, Statistics]]

    def show(self) -> None:
        """Print tables: each policy, the first failing starts, and statistics."""
        super().show()
        show_failures(self.rows)
        for scenario, measures in self.over_policies.items():
            runs = measures["success"].runs
            if runs == 1:
                continue
            rows = []
            for name, s in measures.items():
                values = (s.mean, s.iqm, s.low, s.high)
                form, heading = _MEASURES[name]
                mean, iqm, low, high = (format_value(value, form) for value in values)
                ends = "–" if s.low is None else f"{low} to {high}"
                rows.append((heading, mean, iqm, ends))
            header = (f"scenario {scenario}, {runs} policies", "mean", "IQM", "95 % interval")
            show_texts(header, rows)


Kind = TypeVar("Kind", bound=GridReport)


def grid_row(name: str, policy: GreedyPolicy) -> Row:
    """Evaluate a policy from all starts, or a sample of them."""
    result = policy.evaluate_on_grid()
    path_ratio, steps_ratio = ratios(policy.process, result)
    failing = np.flatnonzero(result.outcome != SUCCESS)
    scenario, starts = policy.config.scenario, len(result.outcome)
    whole = len(joint_starts(policy.process)) if enumerable(policy.process) else None
    _, low, high = rate(starts - len(failing), starts) if starts != whole else (None, None, None)
    places = result.starts[failing[:MAX_FAILURES]].tolist()
    shares: dict[str, Any] = {str(end): result.rate(end) for end in ENDS}
    lengths = {
        "path_length_cm": 100.0 * scenario.cell_m * result.mean_path_cells(),
        "steps": result.mean_steps(),
        "ratio_to_bound": path_ratio,
        "steps_ratio_to_bound": steps_ratio,
    }
    return Row(
        policy=name,
        scenario=scenario.name,
        starts=starts,
        episodes=starts,
        planned=starts,
        **shares,
        success_low=low,
        success_high=high,
        **{name: value for name, value in lengths.items() if not math.isnan(value)},
        failing_starts=len(failing),
        failures=tuple(
            Failure(starts=tuple((x, y) for x, y in cells), outcome=BY_RANK[result.outcome[k]])
            for k, cells in zip(failing, places, strict=False)
        ),
    )


def policy_files(given: Iterable[Any]) -> list[Any]:
    """Return what a user gives, with the policies of their runs in place of folders.

    The name of a method stays one, next to a folder of this name without runs.
    """
    found: list[Any] = []
    for path in given:
        folder = isinstance(path, str | Path) and Path(path).is_dir()
        inside = policy_paths(Path(path)) if folder else [path]
        if not inside and path not in METHODS:
            raise UserError(f"{path}: no run_*/policy.npz in this folder; name a folder of runs")
        found += inside or [path]
    if not found:
        raise UserError("no policy named; give policy.npz files or folders of runs")
    return found


def report_of(
    policies: Iterable[tuple[str, GreedyPolicy]], kind: type[Kind] = GridReport, **more: Any
) -> Kind:
    """Evaluate policies by name; return a report of a kind, with what `more` it has."""
    rows = tuple(grid_row(name, policy) for name, policy in policies)
    over_policies: dict[str, dict[str, Statistics]] = {}
    for scenario in dict.fromkeys(row.scenario for row in rows):
        group = [row for row in rows if row.scenario == scenario]
        over_policies[scenario] = {
            name: summarise(
                [getattr(row, name) for row in group], 0.0, 1.0 if name in ENDS else math.inf
            )
            for name in _MEASURES
        }
    return kind(rows=rows, over_policies=over_policies, **more)


def show_failures(rows: Iterable[Row]) -> None:
    """Print the first failing starts of policies."""
    for row in rows:
        for failure in row.failures[:_LISTED_FAILURES]:
            starts = " ".join(f"({x}, {y})" for x, y in failure.starts)
            print(f"{row.policy}: {failure.outcome} from {starts}")
        more = row.failing_starts - _LISTED_FAILURES
        if more > 0:
            print(f"{row.policy}: {more} more failing starts (--json lists more)")

"""Statistics of `agent.evaluation.outcomes` as text: in tables for the terminal, and one by one."""

from agent.evaluation.dynamics import EvaluationReport
from agent.evaluation.grid import show_failures
from agent.evaluation.outcomes import Measured
from agent.evaluation.statistics import Interval, interval_text
from cosim.base.command import show_table
from cosim.base.outcome import ENDS


def show(report: EvaluationReport) -> None:
    """Print a report as tables: outcomes, measures, the first failing starts."""
    outcomes = [
        (
            row.policy,
            row.scenario,
            f"{row.episodes} of {row.starts}",
            *(rate_text(row, name) for name in ENDS),
        )
        for row in report.policies
    ]
    header = ("policy", "scenario", "episodes", *(name.replace("_", " ") for name in ENDS))
    show_table(None, header, outcomes, names=2, title="outcomes with 95 % intervals")
    measures = [
        (
            row.policy,
            row.scenario,
            text(row.path_length_cm, "{:.1f} cm"),
            text(row.rotation_deg, "{:.0f}°"),
            ratio_text(row),
            text(row.min_distance_cm, "{:.2f} cm"),
            text(row.sim_time_s, "{:.0f} s"),
            text(row.energy_j, "{:.1f} J"),
        )
        for row in report.policies
    ]
    header = (
        "policy",
        "scenario",
        "path",
        "rotation",
        "× grid path",
        "min distance",
        "simulated",
        "energy",
    )
    title = "means of successes, and closest approach"
    show_table(None, header, measures, names=2, title=title)
    show_failures(report.policies)


def text(value: float | None, form: str) -> str:
    """A number in a format, a dash where there is none."""
    return "–" if value is None else form.format(value)


def rate_text(row: Measured, name: str) -> str:
    """A rate with its interval, in per cent."""
    return interval_text(_interval(row, name), 1, 100.0, "%")


def ratio_text(row: Measured) -> str:
    """The ratio to the grid's path with its interval."""
    return interval_text(_interval(row, "path_ratio_to_grid"), 3)


def _interval(row: Measured, name: str) -> Interval:
    return Interval(*(getattr(row, name + end) for end in ("", "_low", "_high")))

"""Statistics of `agent.evaluation.outcomes` as text: in tables for the terminal, and one by one."""

from typing import Any

from rich.console import Console

from agent.evaluation.grid import show_failures
from cosim.base.outcome import ENDS
from cosim.base.tables import show_table


def show(report: dict[str, Any], console: Console) -> None:
    """Print a report as tables: outcomes, measures, the first failing starts."""
    outcomes = [
        (
            row["policy"],
            row["scenario"],
            f"{row['episodes']} of {row['starts']}",
            *(rate_text(row, name) for name in ENDS),
        )
        for row in report["policies"]
    ]
    header = ("policy", "scenario", "episodes", *(name.replace("_", " ") for name in ENDS))
    show_table(console, header, outcomes, names=2, title="outcomes with 95 % intervals")
    measures = [
        (
            row["policy"],
            row["scenario"],
            text(row["path_length_cm"], "{:.1f} cm"),
            ratio_text(row),
            text(row["min_distance_cm"], "{:.2f} cm"),
            text(row["sim_time_s"], "{:.0f} s"),
            text(row["energy_j"], "{:.1f} J"),
        )
        for row in report["policies"]
    ]
    header = ("policy", "scenario", "path", "× grid path", "min distance", "simulated", "energy")
    title = "means of successes, and closest approach"
    show_table(console, header, measures, names=2, title=title)
    show_failures(report["policies"], console)


def text(value: float | None, form: str) -> str:
    """A number in a format, a dash where there is none."""
    return "–" if value is None else form.format(value)


def rate_text(row: dict[str, Any], name: str) -> str:
    """A rate of `agent.evaluation.outcomes.summary` with its interval, in per cent."""
    if row[name] is None:
        return "–"
    return f"{row[name]:.1%} [{100 * row[f'{name}_low']:.1f}, {100 * row[f'{name}_high']:.1f}]"


def ratio_text(row: dict[str, Any]) -> str:
    """The ratio to the grid's path of `agent.evaluation.outcomes.summary` with its interval."""
    name = "path_ratio_to_grid"
    if row[name] is None:
        return "–"
    return f"{row[name]:.3f} [{row[f'{name}_low']:.3f}, {row[f'{name}_high']:.3f}]"

"""The table of docs/robustness.md: its rows, their statistics, and its text."""

from dataclasses import dataclass

import msgspec

from agent.evaluation.outcomes import Failure, Measured, failures, summary
from agent.evaluation.result_file import ResultFile
from agent.evaluation.tables import rate_text, text
from agent.robustness.axes import AxisPoint
from cosim.base.command import show_table
from cosim.base.world import World

TABLE_FILE, MARKDOWN_FILE = "robustness.json", "robustness.md"


@dataclass(frozen=True)
class MeasuredRow:
    """A row: a method in a world.

    Attributes:
        point: the world.
        method: by which the policy was trained.
        indices: of the starts, see `Case.sample`.
        file: results so far.
    """

    point: AxisPoint
    method: str
    indices: list[int]
    file: ResultFile


class RobustnessRow(Measured, frozen=True, kw_only=True):
    """A row of robustness.json.

    Attributes:
        axis, value, world: what is not ideal, see `agent.robustness.axes.AxisPoint`.
        method: by which the policy was trained.
        shield: whether it was on.
        drive_speed_m_s: that the calibration allows.
        planned: episodes asked for.
        digest: of the case.
        failures: starts that did not end in success.
    """

    axis: str
    value: str
    world: World
    method: str
    shield: bool
    drive_speed_m_s: float
    planned: int
    digest: str
    failures: tuple[Failure, ...]


class RobustnessReport(msgspec.Struct, frozen=True, kw_only=True):
    """The content of robustness.json."""

    schema_version: int = 1
    scenario: str
    seed: int | None
    complete: bool
    rows: tuple[RobustnessRow, ...]


def report_of(scenario: str, rows: list[MeasuredRow]) -> RobustnessReport:
    """The content of robustness.json.

    Args:
        scenario: that is measured.
        rows: of the table, in its order.
    """
    table = tuple(_entry(row) for row in rows)
    return RobustnessReport(
        scenario=scenario,
        seed=rows[0].file.case.seed if rows else None,
        complete=all(entry.episodes == entry.planned for entry in table),
        rows=table,
    )


def _entry(row: MeasuredRow) -> RobustnessRow:
    case, results = row.file.case, row.file.beginning(row.indices)
    return RobustnessRow(
        axis=row.point.axis,
        value=row.point.value,
        world=row.point.world,
        method=row.method,
        shield=case.config.shield is not None,
        drive_speed_m_s=case.config.steering.drive_speed_m_s,
        planned=len(row.indices),
        **msgspec.structs.asdict(summary(case, results)),
        digest=case.digest,
        failures=failures(results),
    )


_HEADINGS = (
    "not ideal",
    "value",
    "method",
    "shield",
    "speed",
    "episodes",
    "success",
    "collision",
    "out of board, timeout",
    "min distance",
    "path",
    "rotation",
    "simulated",
    "energy",
)


def _cells(entry: RobustnessRow) -> list[str]:
    n = entry.episodes
    others = (round(n * (getattr(entry, name) or 0.0)) for name in ("out_of_board", "timeout"))
    return [
        entry.axis,
        entry.value,
        entry.method,
        "on" if entry.shield else "off",
        f"{1e3 * entry.drive_speed_m_s:.2f} mm/s",
        str(n) if n == entry.planned else f"{n} of {entry.planned}",
        rate_text(entry, "success"),
        rate_text(entry, "collision"),
        ", ".join(map(str, others)) if n else "–",
        text(entry.min_distance_cm, "{:.2f} cm"),
        text(entry.path_length_cm, "{:.1f} cm"),
        text(entry.rotation_deg, "{:.0f}°"),
        text(entry.sim_time_s, "{:.0f} s"),
        text(entry.energy_j, "{:.1f} J"),
    ]


def markdown(report: RobustnessReport) -> str:
    """The table as Markdown."""
    rows = [_HEADINGS, ["---"] * len(_HEADINGS), *map(_cells, report.rows)]
    return "\n".join("| " + " | ".join(row) + " |" for row in rows)


def show(report: RobustnessReport) -> None:
    """Print the table, in as many parts as the console is wide for."""
    rows = [_cells(entry) for entry in report.rows]
    show_table(None, _HEADINGS, rows, names=_HEADINGS.index("episodes"))

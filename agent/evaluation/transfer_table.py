"""The table of docs/transfer.md: its rows, their statistics, and its text.

Rows read results from files; episodes are simulated by `cosim.transfer`.
"""

import operator
from collections.abc import Iterable
from dataclasses import dataclass

import msgspec
from rich.console import Console
from rich.markdown import Markdown

from agent.evaluation.outcomes import Failure, Measured, failures, summary
from agent.evaluation.result_file import ResultFile
from agent.evaluation.statistics import Interval, interval_text
from agent.evaluation.tables import rate_text, ratio_text, text
from agent.training.settings import BEST
from cosim.base.command import show_table

# What the best method is to reach, in every scenario and for every friction coefficient.
SUCCESS_GOAL, PATH_RATIO_GOAL = 0.99, 1.25


@dataclass(frozen=True)
class Row:
    """A row of the table.

    Attributes:
        scenario, method, mu: what is measured, beside the shield.
        indices: of the starts, see `Case.sample`.
        file: results so far.
    """

    scenario: str
    method: str
    mu: float
    indices: list[int]
    file: ResultFile


class TransferRow(Measured, frozen=True, kw_only=True):
    """A row of transfer.json.

    Attributes:
        scenario, method, mu, shield: what is measured.
        planned: episodes asked for.
        wall_s: of all that are known, together.
        digest: of the case.
        failures: starts that did not end in success.
    """

    scenario: str
    method: str
    mu: float
    shield: bool
    planned: int
    wall_s: float
    digest: str
    failures: tuple[Failure, ...]


class Goal(msgspec.Struct, frozen=True, kw_only=True):
    """The worst value over the rows that a goal is about, where, and whether it holds there."""

    goal: str
    limit: float
    worst: float
    low: float | None
    high: float | None
    scenario: str
    mu: float
    holds: bool


class Session(msgspec.Struct, frozen=True, kw_only=True):
    """A run of the command that simulated something."""

    elapsed_s: float
    episodes: int
    jobs: int


class TransferReport(msgspec.Struct, frozen=True, kw_only=True):
    """The content of transfer.json."""

    schema_version: int = 1
    seed: int | None
    complete: bool
    elapsed_s: float
    sessions: tuple[Session, ...]
    episode_wall_s: float
    simulated: int
    goals: tuple[Goal, ...]
    rows: tuple[TransferRow, ...]


def report_of(rows: list[Row], sessions: list[Session]) -> TransferReport:
    """The content of transfer.json.

    Args:
        rows: of the table, in its order.
        sessions: runs that contributed.
    """
    table = [_entry(row) for row in rows]
    return TransferReport(
        seed=rows[0].file.case.seed if rows else None,
        complete=all(entry.episodes == entry.planned for entry in table),
        elapsed_s=sum(session.elapsed_s for session in sessions),
        sessions=tuple(sessions),
        episode_wall_s=sum(entry.wall_s for entry in table),
        simulated=sum(len(row.file.results) for row in rows),
        goals=tuple(goals(table)),
        rows=tuple(table),
    )


def _entry(row: Row) -> TransferRow:
    file, results = row.file, row.file.beginning(row.indices)
    return TransferRow(
        scenario=row.scenario,
        method=row.method,
        mu=row.mu,
        shield=file.case.config.shield is not None,
        planned=len(row.indices),
        **msgspec.structs.asdict(summary(file.case, results)),
        wall_s=sum(r.wall_s for r in file.results.values()),
        digest=file.case.digest,
        failures=failures(results),
    )


def goals(table: list[TransferRow]) -> list[Goal]:
    """Whether each goal holds in the worst of the rows that it is about."""
    best = [e for e in table if e.method == BEST and e.episodes > 0]
    without, shielded = ([e for e in best if e.shield == on] for on in (False, True))
    measured = [
        ("success without the shield", "success", without, min, SUCCESS_GOAL),
        ("collisions with the shield", "collision", shielded, max, 0.0),
        ("path length over the grid's", "path_ratio_to_grid", without, max, PATH_RATIO_GOAL),
    ]
    found: list[Goal] = []
    for name, measure, entries, worst, limit in measured:
        known = [e for e in entries if getattr(e, measure) is not None]
        if not known:
            continue
        entry = worst(known, key=operator.attrgetter(measure))
        value = getattr(entry, measure)
        found.append(
            Goal(
                goal=name,
                limit=limit,
                worst=value,
                low=getattr(entry, f"{measure}_low"),
                high=getattr(entry, f"{measure}_high"),
                scenario=entry.scenario,
                mu=entry.mu,
                holds=value >= limit if worst is min else value <= limit,
            )
        )
    return found


_HEADINGS = (
    "scenario",
    "method",
    "µ",
    "shield",
    "episodes",
    "success",
    "collision",
    "out of board, timeout",
    "min distance",
    "path",
    "rotation",
    "× own grid path",
    "simulated",
    "energy",
)


def markdown(report: TransferReport) -> str:
    """The table as Markdown, the goals below it, and how long it took."""
    lines = [_line(_HEADINGS), _line(["---"] * len(_HEADINGS))]
    lines += [_line(_cells(entry)) for entry in report.rows]
    return "\n".join([*lines, "", *_findings(report)])


def show(report: TransferReport) -> None:
    """Print what `markdown` has, in as many tables as the console is wide for."""
    rows = [_cells(entry) for entry in report.rows]
    show_table(None, _HEADINGS, rows, names=_HEADINGS.index("episodes"))
    Console().print(Markdown("\n".join(_findings(report))))


def _cells(entry: TransferRow) -> list[str]:
    n = entry.episodes
    others = (
        "–"
        if n == 0
        else ", ".join(str(round(n * getattr(entry, name))) for name in ("out_of_board", "timeout"))
    )
    return [
        entry.scenario,
        entry.method,
        f"{entry.mu:g}",
        "on" if entry.shield else "off",
        str(n) if n == entry.planned else f"{n} of {entry.planned}",
        rate_text(entry, "success"),
        rate_text(entry, "collision"),
        others,
        text(entry.min_distance_cm, "{:.2f} cm"),
        text(entry.path_length_cm, "{:.1f} cm"),
        text(entry.rotation_deg, "{:.0f}°"),
        ratio_text(entry),
        text(entry.sim_time_s, "{:.0f} s"),
        text(entry.energy_j, "{:.1f} J"),
    ]


def _findings(report: TransferReport) -> list[str]:
    lines = []
    for goal in report.goals:
        form = (3, 1.0, "") if goal.goal.startswith("path") else (1, 100.0, "%")
        limit = interval_text(Interval(goal.limit, None, None), *form)
        worst = interval_text(Interval(goal.worst, goal.low, goal.high), *form)
        verdict = "holds" if goal.holds else "does not hold"
        lines.append(
            f"- Goal, {goal.goal} ({limit}): {verdict}; the worst row has {worst} "
            f"(scenario {goal.scenario}, µ = {goal.mu:g})."
        )
    lines.append(
        f"- {report.simulated} episodes simulated in {report.elapsed_s / 60.0:.0f} min "
        f"(the command ran {len(report.sessions)} times); the episodes alone took "
        f"{report.episode_wall_s / 60.0:.0f} min of the threads."
    )
    return lines


def _line(cells: Iterable[str]) -> str:
    return "| " + " | ".join(cells) + " |"

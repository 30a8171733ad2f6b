"""The table of docs/transfer.md: its rows, their statistics, and its text.

Rows read results from files; episodes are simulated by `cosim.transfer`.
"""

import operator
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import takewhile

import msgspec
from rich.console import Console
from rich.markdown import Markdown

from agent.evaluation.cases import Job
from agent.evaluation.outcomes import Failure, Measured, failures, summary
from agent.evaluation.result_file import ResultFile
from agent.evaluation.tables import rate_text, ratio_text, text
from agent.training.settings import BEST
from cosim.base.command import show_table
from cosim.navigation.result import EpisodeResult

# What the best method is to reach, in every scenario and for every friction coefficient.
SUCCESS_GOAL, PATH_RATIO_GOAL = 0.99, 1.25


@dataclass(frozen=True)
class Row:
    """A row of the table, without and with the safety layer.

    Attributes:
        scenario, method, mu: what is measured.
        indices: of the starts, see `Case.sample`.
        off, on: results without and with the layer.
    """

    scenario: str
    method: str
    mu: float
    indices: list[int]
    off: ResultFile
    on: ResultFile

    def results(self, safety: bool) -> dict[int, EpisodeResult]:
        """Results so far by index of the start: the longest beginning of the sample that is known.

        Whatever else is known is left out, since what is known first is not drawn at random: short
        episodes end before long ones, and those that the layer leaves alone cost nothing. For the
        same reason a beginning that only ends before the first episode that the layer changes is
        no sample: it was chosen for having none.

        An episode without the layer in which the layer would have changed no decision is, bit for
        bit, the one with it, and stands for it.
        """
        known = list(takewhile(self.off.results.__contains__, self.indices))
        if not safety:
            return {k: self.off.results[k] for k in known}
        changed = [k for k in known if self.off.results[k].conflicts > 0]
        missing = next((k for k in changed if k not in self.on.results), None)
        if missing is not None:
            known = [] if missing == changed[0] else known[: known.index(missing)]
        same = {k: self.off.results[k] for k in known if k not in changed}
        return same | {k: self.on.results[k] for k in known if k in self.on.results}

    def missing(self, safety: bool) -> list[Job]:
        """Episodes to simulate; with the layer, those that it is known to change."""
        if not safety:
            return [Job(self.off.case, k) for k in self.indices if k not in self.off.results]
        off = {k: self.off.results[k] for k in self.indices if k in self.off.results}
        changed = [k for k, r in off.items() if r.conflicts > 0]
        return [Job(self.on.case, k) for k in changed if k not in self.on.results]


class TransferRow(Measured, frozen=True, kw_only=True):
    """A row of transfer.json.

    Attributes:
        scenario, method, mu, safety_margin_m: what is measured; a margin of 0 is without the layer.
        planned: episodes asked for.
        simulated: episodes of this row alone, without those that stand for it.
        wall_s: of those, together.
        digest: of the case.
        failures: starts that did not end in success.
    """

    scenario: str
    method: str
    mu: float
    safety_margin_m: float
    planned: int
    simulated: int
    wall_s: float
    digest: str
    failures: tuple[Failure, ...]


class Goal(msgspec.Struct, frozen=True, kw_only=True):
    """The worst value over the rows that a goal is about, where, and whether it holds there."""

    goal: str
    limit: float
    worst: float
    low: float
    high: float
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
    table = [_entry(row, safety) for row in rows for safety in (False, True)]
    return TransferReport(
        seed=rows[0].off.case.seed if rows else None,
        complete=all(entry.episodes == entry.planned for entry in table),
        elapsed_s=sum(session.elapsed_s for session in sessions),
        sessions=tuple(sessions),
        episode_wall_s=sum(entry.wall_s for entry in table),
        simulated=sum(entry.simulated for entry in table),
        goals=tuple(goals(table)),
        rows=tuple(table),
    )


def _entry(row: Row, safety: bool) -> TransferRow:
    file, results = row.on if safety else row.off, row.results(safety)
    # with the layer, only those that it has changed; whether they count already or not
    simulated = [file.results[k] for k in row.indices if k in file.results]
    return TransferRow(
        scenario=row.scenario,
        method=row.method,
        mu=row.mu,
        safety_margin_m=file.case.config.safety_margin_m,
        planned=len(row.indices),
        **msgspec.structs.asdict(summary(file.case, results)),
        simulated=len(simulated),
        wall_s=sum(r.wall_s for r in simulated),
        digest=file.case.digest,
        failures=failures(results),
    )


def goals(table: list[TransferRow]) -> list[Goal]:
    """Whether each goal holds in the worst of the rows that it is about."""
    best = [e for e in table if e.method == BEST and e.episodes > 0]
    without = [e for e in best if not e.safety_margin_m]
    with_layer = [e for e in best if e.safety_margin_m]
    measured = [
        ("success without the safety layer", "success", without, min, SUCCESS_GOAL),
        ("collisions with the safety layer", "collision", with_layer, max, 0.0),
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
    "safety layer",
    "episodes",
    "success",
    "collision",
    "out of board, timeout",
    "min distance",
    "path",
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
    margin_mm = 1e3 * entry.safety_margin_m
    return [
        entry.scenario,
        entry.method,
        f"{entry.mu:g}",
        f"{margin_mm:g} mm" if margin_mm else "off",
        str(n) if n == entry.planned else f"{n} of {entry.planned}",
        rate_text(entry, "success"),
        rate_text(entry, "collision"),
        others,
        text(entry.min_distance_cm, "{:.2f} cm"),
        text(entry.path_length_cm, "{:.1f} cm"),
        ratio_text(entry),
        text(entry.sim_time_s, "{:.0f} s"),
        text(entry.energy_j, "{:.1f} J"),
    ]


def _findings(report: TransferReport) -> list[str]:
    lines = []
    for goal in report.goals:
        form = "{:.3f}" if goal.goal.startswith("path") else "{:.1%}"
        low, high = form.format(goal.low), form.format(goal.high)
        verdict = "holds" if goal.holds else "does not hold"
        lines.append(
            f"- Goal, {goal.goal} ({form.format(goal.limit)}): {verdict}; the worst row has "
            f"{form.format(goal.worst)} [{low}, {high}] (scenario {goal.scenario}, "
            f"µ = {goal.mu:g})."
        )
    lines.append(
        f"- {report.simulated} episodes simulated in {report.elapsed_s / 60.0:.0f} min "
        f"(the command ran {len(report.sessions)} times); the episodes alone took "
        f"{report.episode_wall_s / 60.0:.0f} min of the threads."
    )
    return lines


def _line(cells: Iterable[str]) -> str:
    return "| " + " | ".join(cells) + " |"

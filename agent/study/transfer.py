"""Tables of methods in the full dynamics: see docs/methods.md.

The command lines are `minirobots transfer` and `minirobots robustness`.
"""

import operator
from collections.abc import Collection, Iterable, Sequence
from itertools import product
from pathlib import Path
from typing import Any

import msgspec
from rich.console import Console
from rich.markdown import Markdown

from agent.evaluation.statistics import Interval, interval_text
from agent.study.axes import AXES, Axis, points
from agent.study.episodes import (
    MEASURES,
    METHOD,
    MU,
    OUTCOMES,
    PATH_RATIO,
    SCENARIO,
    SHIELD,
    SPEED,
    EpisodesRow,
    Row,
    StudyLine,
    case_of,
    interval_of,
    simulate,
)
from agent.study.plot import draw_measure
from agent.study.policies import trained
from agent.study.store import EpisodeStore
from agent.training.settings import COMPARED, METHODS
from cosim.base.jobs import Workers, until
from cosim.base.progress import Progress, silent
from cosim.base.storage import replacing
from cosim.base.table import field, write_report
from cosim.base.table import markdown as table_text
from cosim.base.table import show as show_table
from cosim.model.params import TABLE_I
from cosim.model.scenario_file import PAPER, find_scenario
from cosim.model.world import World
from cosim.simulation.options import SimulationOptions

MUS = (TABLE_I.mu, 0.1, 0.2)  # most important first
_DETAILED = "moves"  # method with rows of every friction coefficient, and with goals
# Episodes of a pair in rows of that method at the default friction, and of other rows.
_MANY, _SOME, QUICK_EPISODES = 200, 50, 2
_SUCCESS, _PATH_RATIO = 0.99, 1.25  # goals of the best method
COLUMNS = (SCENARIO, METHOD, MU, SHIELD, *OUTCOMES, *MEASURES[:3], PATH_RATIO, *MEASURES[3:])
OF_WORLDS = (
    field("axis", heading="not ideal"),
    field("value"),
    METHOD,
    SHIELD,
    SPEED,
    *OUTCOMES,
    *MEASURES,
)


class TransferRow(EpisodesRow, frozen=True, kw_only=True):
    """A row of transfer.json: of a method."""

    method: str


class RobustnessRow(EpisodesRow, frozen=True, kw_only=True):
    """A row of robustness.json: a method in a world, see `agent.study.axes.AxisPoint`."""

    axis: str
    value: str
    world: World
    method: str


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

    def finding(self) -> str:
        """Return it as text."""
        form = (3, 1.0, "") if self.goal.startswith("path") else (1, 100.0, "%")
        digits, factor, unit = form
        limit = f"{factor * self.limit:.{digits}f}{unit}"
        worst = interval_text(Interval(self.worst, self.low, self.high), *form)
        verdict = "holds" if self.holds else "does not hold"
        return (
            f"- Goal, {self.goal} ({limit}): {verdict}; the worst row has {worst} "
            f"(scenario {self.scenario}, µ = {self.mu:g})."
        )


class MethodsReport(msgspec.Struct, frozen=True, kw_only=True):
    """Base of reports that compare methods."""

    schema_version: int = 1
    seed: int | None
    complete: bool


class TransferReport(MethodsReport, frozen=True, kw_only=True):
    """The content of transfer.json."""

    episode_wall_s: float
    simulated: int
    goals: tuple[Goal, ...]
    rows: tuple[TransferRow, ...]


class RobustnessReport(MethodsReport, frozen=True, kw_only=True):
    """The content of robustness.json."""

    scenario: str
    rows: tuple[RobustnessRow, ...]


def _report(
    lines: Sequence[StudyLine], form: type[Row], store: EpisodeStore, seed: int, **how: Any
) -> dict[str, Any]:
    """Return fields of a `MethodsReport`; `how` is that of `simulate`."""
    simulate(lines, store, **how)
    rows = tuple(line.row(store, form) for line in lines)
    complete = all(row.episodes == row.planned for row in rows)
    return {"rows": rows, "seed": seed if rows else None, "complete": complete}


def transfer(
    out: Path,
    *,
    scenarios: Collection[str] = tuple(PAPER),
    methods: Collection[str] = COMPARED,
    seed: int = 0,
    quick: bool = False,
    budget_minutes: float | None = None,
    where: Workers = Workers(),  # noqa: B008 - a constant
    progress: Progress = silent,
) -> TransferReport:
    """Simulate missing episodes and write the table; arguments are options of the command."""
    may_begin, store = until(budget_minutes), EpisodeStore(out / "results")
    lines: list[StudyLine] = []
    for method in (method for method in METHODS if method in methods):
        boards = [find_scenario(name, ideal=True) for name in scenarios]
        policies = [trained(method, board, out, seed, progress) for board in boards]
        mus = MUS if method == _DETAILED else MUS[:1]
        for mu, policy, shield in product(mus, policies, (False, True)):
            options = SimulationOptions(mu=mu, shield=shield)
            case = case_of(policy, options, seed, progress=progress)
            wanted = QUICK_EPISODES if quick else _SOME
            if method == _DETAILED and mu == TABLE_I.mu and not shield and not quick:
                wanted = len(case.starts) if policy.config.scenario.robots == 1 else _MANY
            indices = case.sample(min(wanted, len(case.starts)))
            lines.append(StudyLine(case, indices, {"method": method}))
    how = {"where": where, "may_begin": may_begin, "progress": progress}
    fields = _report(lines, TransferRow, store, seed, **how)
    rows: tuple[TransferRow, ...] = fields["rows"]
    report = TransferReport(
        **fields,
        episode_wall_s=sum(row.wall_s for row in rows),
        simulated=sum(len(store.file(line.case).results) for line in lines),
        goals=tuple(goals(row for row in rows if row.method == _DETAILED)),
    )
    write_report(out / "transfer", report, markdown(report))
    return report


def markdown(report: TransferReport) -> str:
    """Return the table as Markdown, the goals below it, and how long it took."""
    return "\n".join([table_text(COLUMNS, report.rows), "", *_findings(report)])


def show(report: TransferReport) -> None:
    """Print what `markdown` has, in as many tables as the console is wide for."""
    show_table(COLUMNS, report.rows, names=4)
    Console().print(Markdown("\n".join(_findings(report))))


def _findings(report: TransferReport) -> list[str]:
    return [
        *(goal.finding() for goal in report.goals),
        f"- {report.simulated} episodes, which took {report.episode_wall_s / 60.0:.0f} min of the "
        "threads.",
    ]


def goals(best: Iterable[TransferRow]) -> list[Goal]:
    """Return whether each goal holds in the worst of the rows that it is about.

    Args:
        best: rows of the best method.
    """
    measured = (
        ("success without the shield", "success", False, min, _SUCCESS),
        ("collisions with the shield", "collision", True, max, 0.0),
        ("path length over the grid's", "path_ratio_to_grid", False, max, _PATH_RATIO),
    )
    rows, found = [row for row in best if row.episodes > 0], []
    for goal, measure, shield, worst, limit in measured:
        known = [e for e in rows if e.shield == shield and getattr(e, measure) is not None]
        if not known:
            continue
        row = worst(known, key=operator.attrgetter(measure))
        value = getattr(row, measure)
        _, low, high = interval_of(row, measure)
        found.append(
            Goal(
                goal=goal,
                limit=limit,
                worst=value,
                low=low,
                high=high,
                scenario=row.scenario,
                mu=row.mu,
                holds=value >= limit if worst is min else value <= limit,
            )
        )
    return found


def robustness(
    out: Path,
    world: World,
    *,
    scenario: str = "4",
    axes: Collection[Axis] = AXES,
    methods: Collection[str] = COMPARED,
    episodes: int | None = None,
    quick: bool = False,
    seed: int = 0,
    budget_minutes: float | None = None,
    where: Workers = Workers(),  # noqa: B008 - a constant
    progress: Progress = silent,
) -> RobustnessReport:
    """Simulate the missing rows of the table, and write it with its plot.

    Arguments are options of the command, `world` the one in which nothing is ideal.
    """
    may_begin, store = until(budget_minutes), EpisodeStore(out / "results")
    wanted = QUICK_EPISODES if quick else episodes or _SOME
    board, lines = find_scenario(scenario, ideal=True), []
    policies = {m: trained(m, board, out, seed, progress) for m in COMPARED if m in methods}
    for point in (p for axis in AXES if axis in axes for p in points(axis, board, world)):
        for method, policy in policies.items():
            for shield in (False, True) if point.axis == "everything" else (False,):
                options = SimulationOptions(shield=shield)
                case = case_of(policy, options, seed, world=point.world, progress=progress)
                indices = case.sample(min(wanted, len(case.starts)))
                lines.append(StudyLine(case, indices, {**point._asdict(), "method": method}))
    how = {"where": where, "may_begin": may_begin, "progress": progress}
    report = RobustnessReport(
        scenario=scenario, **_report(lines, RobustnessRow, store, seed, **how)
    )
    write_report(out / "robustness", report, table_text(OF_WORLDS, report.rows))
    unshielded = [row for row in report.rows if not row.shield]
    panels = {axis: [r for r in unshielded if r.axis == axis] for axis in AXES if axis in axes}
    title = f"scenario {scenario}, without the shield; bars: 95 %, Wilson"
    figure = draw_measure(panels, lambda row: row.value, lambda row: row.method, title=title)
    with replacing(out / "robustness.png") as temporary:
        figure.savefig(temporary, format="png", dpi=150)
    return report

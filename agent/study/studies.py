"""Studies of this project: of policies, and of methods in the dynamics and in other worlds.

The command lines are `minirobots evaluate`, `transfer` and `robustness`; see docs/methods.md.
"""

import operator
from collections.abc import Collection, Iterable, Iterator
from itertools import product
from pathlib import Path
from typing import Any, Literal

import msgspec
from rich.console import Console
from rich.markdown import Markdown

from agent.evaluation.cases import Case
from agent.evaluation.claims import claim_of
from agent.evaluation.rows import (
    MEASURES,
    METHOD,
    MU,
    OUTCOMES,
    PATH_RATIO,
    POLICY,
    SCENARIO,
    SHIELD,
    Row,
    option_column,
    rate_column,
)
from agent.evaluation.statistics import Interval, interval_text
from agent.study.axes import AXES, Axis, worlds_of
from agent.study.engine import Line, case_of, measure
from agent.study.grid import policy_files, show_failures
from agent.study.options import Sampling
from agent.study.policies import name_of, trained
from agent.study.report import Report, write_figure
from agent.study.store import EpisodeStore
from agent.study.user import lines_of
from agent.training.methods import METHODS
from agent.training.settings import COMPARED
from cosim.base.jobs import THREADS, Workers, until
from cosim.base.progress import Progress, silent
from cosim.base.table import Column, write_report
from cosim.base.table import markdown as table_text
from cosim.base.table import show as show_table
from cosim.model.outcome import ENDS
from cosim.model.params import TABLE_I
from cosim.model.scenario_file import PAPER, find_scenario
from cosim.model.world import World
from cosim.simulation.options import SimulationOptions

STARTS = 50
OF_POLICIES = (
    POLICY,
    SCENARIO,
    Column("episodes", lambda r: f"{r.episodes}" if r.claim else f"{r.episodes} of {r.starts}"),
    *map(rate_column, ENDS),
    *MEASURES[1:3],
    PATH_RATIO,
    MEASURES[0],
    *MEASURES[3:],
)
MUS = (TABLE_I.mu, 0.1, 0.2)  # most important first
_DETAILED = "moves"  # method with rows of every friction coefficient, and with goals
# Episodes of a pair in rows of that method at the default friction, and of other rows.
_MANY, _SOME, QUICK_EPISODES = 200, 50, 2
OF_METHODS = (SCENARIO, METHOD, MU, SHIELD, *OUTCOMES, *MEASURES[:3], PATH_RATIO, *MEASURES[3:])
OF_WORLDS = (
    option_column("axis", "not ideal"),
    option_column("value"),
    METHOD,
    SHIELD,
    Column("speed", lambda row: f"{1e3 * row.drive_speed_m_s:.2f} mm/s"),
    *OUTCOMES,
    *MEASURES,
)
# Goals of the best method: what is measured, with the shield or without, the worst, and the limit.
_GOALS = {
    "success without the shield": ("success", False, min, 0.99),
    "collisions with the shield": ("collision", True, max, 0.0),
    "path length over the grid's": ("path_ratio_to_grid", False, max, 1.25),
}


def evaluate(
    policies: Iterable[Any],
    physics: SimulationOptions,
    how: Sampling,
    *,
    starts: int | Literal["all"] | None = None,
    scenario: str | None = None,
    recordings: int = 3,
    progress: Progress = silent,
) -> Report:
    """Simulate missing episodes, and record the selected ones.

    Arguments are options of the command; policies are files, folders of runs, or what `policy_of`
    takes.
    """
    assert how.out is not None
    store, claim = EpisodeStore(how.out), claim_of(how.claim, how.confidence)

    def indices(case: Case) -> list[int]:
        available, wanted = len(case.starts), starts
        if wanted == "all" or (wanted is None and claim):
            wanted = available
        elif wanted is None:
            wanted = min(STARTS, available)
        return case.rounds(wanted) if claim else case.sample(wanted)

    named = {name_of(policy): policy for policy in policy_files(policies)}
    lines = lines_of(named, [scenario], vars(physics), how.seed, indices, claim, progress)
    more = {"recordings": recordings, "may_begin": until(how.budget_minutes), "progress": progress}
    return Report(seed=how.seed, rows=measure(lines, store, how.where, **more))


def show_evaluation(report: Report) -> None:
    """Print a report as tables: outcomes with 95 % intervals, measures, the first failing starts.

    Path, rotation, time and energy are means of successes. Verdicts on claims come last.
    """
    show_table(OF_POLICIES, report.rows, names=2, title="outcomes with 95 % intervals")
    show_failures(report.rows)
    for row in report.rows:
        if row.claim is not None:
            print(f"{row.claim.verdict} for {row.policy}: {row.claim}")


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


class TransferReport(Report, frozen=True, kw_only=True):
    """The content of transfer.json: `simulated` episodes are in its folder."""

    episode_wall_s: float
    simulated: int
    goals: tuple[Goal, ...]


def transfer(
    out: Path,
    *,
    scenarios: Collection[str] = tuple(PAPER),
    methods: Collection[str] = COMPARED,
    seed: int = 0,
    quick: bool = False,
    budget_minutes: float | None = None,
    where: Workers = THREADS,
    progress: Progress = silent,
) -> TransferReport:
    """Simulate missing episodes and write the table; arguments are options of the command."""
    may_begin, store = until(budget_minutes), EpisodeStore(out / "results")
    boards = [find_scenario(name, ideal=True) for name in scenarios]
    lines: list[Line] = []
    for method in (method for method in METHODS if method in methods):
        policies = [trained(method, board, out, seed, progress) for board in boards]
        mus = MUS if method == _DETAILED else MUS[:1]
        for mu, policy, shield in product(mus, policies, (False, True)):
            options = SimulationOptions(mu=mu, shield=shield)
            case = case_of(policy, options, seed, name=method, progress=progress)
            wanted, available = QUICK_EPISODES if quick else _SOME, len(case.starts)
            if method == _DETAILED and mu == TABLE_I.mu and not shield and not quick:
                wanted = available if policy.config.scenario.robots == 1 else _MANY
            lines.append(Line(case, case.sample(min(wanted, available)), method))
    rows = measure(lines, store, where, may_begin=may_begin, progress=progress)
    report = TransferReport(
        rows=rows,
        seed=seed if rows else None,
        episode_wall_s=sum(row.wall_s or 0.0 for row in rows),
        simulated=sum(len(store.results(line.case)) for line in lines),
        goals=tuple(goals(row for row in rows if row.policy == _DETAILED)),
    )
    write_report(out / "transfer", report, markdown(report))
    return report


def markdown(report: TransferReport) -> str:
    """Return the table as Markdown, the goals below it, and how long it took."""
    return "\n".join([table_text(OF_METHODS, report.rows), "", *_findings(report)])


def show(report: TransferReport) -> None:
    """Print what `markdown` has, in as many tables as the console is wide for."""
    show_table(OF_METHODS, report.rows, names=4)
    Console().print(Markdown("\n".join(_findings(report))))


def _findings(report: TransferReport) -> list[str]:
    return [
        *(goal.finding() for goal in report.goals),
        f"- {report.simulated} episodes, which took {report.episode_wall_s / 60.0:.0f} min of the "
        "threads.",
    ]


def goals(best: Iterable[Row]) -> Iterator[Goal]:
    """Return whether each goal holds in the worst of the best method's rows that it is about."""
    rows = [row for row in best if row.episodes > 0]
    for goal, (measured, shield, worst, limit) in _GOALS.items():
        known = [r for r in rows if r.shield == shield and getattr(r, measured) is not None]
        if not known:
            continue
        row = worst(known, key=operator.attrgetter(measured))
        value, low, high = row.interval(measured)
        yield Goal(
            goal=goal,
            limit=limit,
            worst=value,
            low=low,
            high=high,
            scenario=row.scenario,
            mu=row.mu,
            holds=value >= limit if worst is min else value <= limit,
        )


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
    where: Workers = THREADS,
    progress: Progress = silent,
) -> Report:
    """Simulate the missing rows of the table, and write it with its plot.

    Arguments are options of the command, `world` the one in which nothing is ideal.
    """
    from agent.study.plot import draw_measure  # noqa: PLC0415 - slow to import

    may_begin, store = until(budget_minutes), EpisodeStore(out / "results")
    wanted = QUICK_EPISODES if quick else episodes or _SOME
    board, lines = find_scenario(scenario, ideal=True), list[Line]()
    policies = {m: trained(m, board, out, seed, progress) for m in COMPARED if m in methods}
    for axis in (axis for axis in AXES if axis in axes):
        shields = (False, True) if axis == "everything" else (False,)
        for (value, of), method, shield in product(
            worlds_of(axis, board, world), policies, shields
        ):
            options = SimulationOptions(shield=shield)
            case = case_of(
                policies[method], options, seed, world=of, name=method, progress=progress
            )
            indices = case.sample(min(wanted, len(case.starts)))
            lines.append(Line(case, indices, method, {"axis": axis, "value": value, "world": of}))
    rows = measure(lines, store, where, may_begin=may_begin, progress=progress)
    report = Report(rows=rows, axes=("axis", "value", "world"), seed=seed if rows else None)
    write_report(out / "robustness", report, table_text(OF_WORLDS, report.rows))
    panels = {
        axis: [r for r in rows if r.options["axis"] == axis and not r.shield]
        for axis in AXES
        if axis in axes
    }
    figure = draw_measure(
        panels,
        lambda row: row.options["value"],
        lambda row: row.policy,
        title=f"scenario {scenario}, without the shield; bars: 95 %, Wilson",
    )
    write_figure(out / "robustness.png", figure)
    return report

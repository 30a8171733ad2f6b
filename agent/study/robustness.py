"""Measure policies in worlds that none of them was trained for: docs/robustness.md.

The worlds are `agent.study.axes`; the command line is `minirobots robustness`.
"""

from collections.abc import Collection
from pathlib import Path

import msgspec

from agent.study.axes import AXES, Axis, points
from agent.study.episodes import (
    MEASURES,
    METHOD,
    OUTCOMES,
    SHIELD,
    SPEED,
    EpisodesRow,
    StudyLine,
    case_of,
    simulate,
)
from agent.study.plot import draw_measure
from agent.study.policies import trained
from agent.study.store import EpisodeStore
from agent.training.settings import COMPARED
from cosim.base.jobs import Workers, until
from cosim.base.progress import Progress, silent
from cosim.base.storage import replacing
from cosim.base.table import field, markdown, write_report
from cosim.model.scenario_file import find_scenario
from cosim.model.world import World
from cosim.simulation.options import SimulationOptions

_EPISODES, _QUICK_EPISODES = 50, 2
COLUMNS = (
    field("axis", heading="not ideal"),
    field("value"),
    METHOD,
    SHIELD,
    SPEED,
    *OUTCOMES,
    *MEASURES,
)


class RobustnessRow(EpisodesRow, frozen=True, kw_only=True):
    """A row of robustness.json: a method in a world, see `agent.study.axes.AxisPoint`."""

    axis: str
    value: str
    world: World
    method: str


class RobustnessReport(msgspec.Struct, frozen=True, kw_only=True):
    """The content of robustness.json."""

    schema_version: int = 1
    scenario: str
    seed: int | None
    complete: bool
    rows: tuple[RobustnessRow, ...]


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
    wanted = _QUICK_EPISODES if quick else episodes or _EPISODES
    board, lines = find_scenario(scenario, ideal=True), []
    policies = {m: trained(m, board, out, seed, progress) for m in COMPARED if m in methods}
    for point in (p for axis in AXES if axis in axes for p in points(axis, board, world)):
        for method, policy in policies.items():
            for shield in (False, True) if point.axis == "everything" else (False,):
                options = SimulationOptions(shield=shield)
                case = case_of(policy, options, seed, world=point.world, progress=progress)
                indices = case.sample(min(wanted, len(case.starts)))
                lines.append(StudyLine(case, indices, {**point._asdict(), "method": method}))
    simulate(lines, store, where, may_begin=may_begin, progress=progress)
    rows = tuple(line.row(store, RobustnessRow) for line in lines)
    report = RobustnessReport(
        scenario=scenario,
        seed=seed if rows else None,
        complete=all(row.episodes == row.planned for row in rows),
        rows=rows,
    )
    write_report(out / "robustness", report, markdown(COLUMNS, rows))
    unshielded = [row for row in rows if not row.shield]
    panels = {axis: [r for r in unshielded if r.axis == axis] for axis in AXES if axis in axes}
    title = f"scenario {scenario}, without the shield; bars: 95 %, Wilson"
    figure = draw_measure(panels, lambda row: row.value, lambda row: row.method, title=title)
    with replacing(out / "robustness.png") as temporary:
        figure.savefig(temporary, format="png", dpi=150)
    return report

"""Evaluate policies in the full dynamics, start by start: episodes, results, recordings.

The counterpart of `agent.study.grid`, which is exact on the grid.
"""

from collections.abc import Iterable
from typing import Any, Literal

from agent.evaluation.cases import Case
from agent.evaluation.claims import claim_of
from agent.evaluation.rows import MEASURES, PATH_RATIO, POLICY, SCENARIO, rate_column
from agent.study.engine import measure
from agent.study.grid import policy_files, show_failures
from agent.study.options import Sampling
from agent.study.policies import name_of
from agent.study.report import Report
from agent.study.store import EpisodeStore
from agent.study.user import lines_of
from cosim.base.jobs import until
from cosim.base.progress import Progress, silent
from cosim.base.table import Column
from cosim.base.table import show as show_table
from cosim.model.outcome import ENDS
from cosim.simulation.options import SimulationOptions

STARTS = 50
COLUMNS = (
    POLICY,
    SCENARIO,
    Column("episodes", lambda r: f"{r.episodes}" if r.claim else f"{r.episodes} of {r.starts}"),
    *map(rate_column, ENDS),
    *MEASURES[1:3],
    PATH_RATIO,
    MEASURES[0],
    *MEASURES[3:],
)


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
    claim = claim_of(how.claim, how.confidence)

    def indices(case: Case) -> list[int]:
        available, wanted = len(case.starts), starts
        if wanted == "all" or (wanted is None and claim):
            wanted = available
        elif wanted is None:
            wanted = min(STARTS, available)
        return case.rounds(wanted) if claim else case.sample(wanted)

    named = {name_of(policy): policy for policy in policy_files(policies)}
    lines = lines_of(named, [scenario], vars(physics), how.seed, indices, claim, progress)
    rows = measure(
        lines,
        EpisodeStore(how.out),
        how.where,
        recordings=recordings,
        may_begin=until(how.budget_minutes),
        progress=progress,
    )
    return Report(seed=how.seed, rows=rows)


def show(report: Report) -> None:
    """Print a report as tables: outcomes with 95 % intervals, measures, the first failing starts.

    Path, rotation, time and energy are means of successes. Verdicts on claims come last.
    """
    show_table(COLUMNS, report.rows, names=2, title="outcomes with 95 % intervals")
    show_failures(report.rows)
    for row in report.rows:
        if row.claim is not None:
            print(f"{row.claim.verdict} for {row.policy}: {row.claim}")

"""Evaluate policies in the full dynamics, start by start: episodes, results, recordings.

The counterpart of `agent.evaluation.grid`, which is exact on the grid; the command line is
`cosim.evaluate`.
"""

from collections.abc import Iterable
from pathlib import Path
from typing import Any, Literal

import msgspec

from agent.evaluation.claims import Claim, JudgedClaim
from agent.evaluation.grid import policy_files, show_failures
from agent.study.episodes import (
    MEASURES,
    PATH_RATIO,
    SCENARIO,
    EpisodesRow,
    StudyLine,
    case_of,
    rate_column,
    record,
    simulate,
)
from agent.study.policies import name_of
from agent.study.store import EpisodeStore
from cosim.base.jobs import Workers
from cosim.base.progress import Progress, silent
from cosim.base.table import Column, field
from cosim.base.table import show as show_table
from cosim.model.outcome import ENDS, Outcome
from cosim.model.world import World
from cosim.simulation.options import SimulationOptions

STARTS = 50
Starts = int | Literal["all"] | None
COLUMNS = (
    field("policy"),
    SCENARIO,
    Column("episodes", lambda r: f"{r.episodes}" if r.claim else f"{r.episodes} of {r.starts}"),
    *map(rate_column, ENDS),
    *MEASURES[1:3],
    PATH_RATIO,
    MEASURES[0],
    *MEASURES[3:],
)


class PolicyRow(EpisodesRow, frozen=True, kw_only=True):
    """A policy of a report.

    Attributes:
        policy: its name or file.
        recordings, results: files.
        claim: with its verdict and evidence, if there is one.
    """

    policy: str
    recordings: tuple[str, ...] = ()
    results: str
    claim: JudgedClaim | None = None


class EvaluationReport(msgspec.Struct, frozen=True, kw_only=True):
    """Output of `python -m cosim.evaluate --json`: the policies under one physics."""

    schema_version: int = 1
    seed: int
    mu: float
    shield: bool
    world: World
    policies: tuple[PolicyRow, ...]


def evaluate(
    policies: Iterable[Any],
    physics: SimulationOptions,
    out: Path,
    *,
    starts: Starts = None,
    seed: int = 0,
    scenario: str | None = None,
    recordings: int = 3,
    claim: Claim | None = None,
    where: Workers = Workers(),  # noqa: B008 - a constant
    progress: Progress = silent,
) -> EvaluationReport:
    """Simulate missing episodes, and record the selected ones.

    Arguments are options of the command; policies are files, folders of runs, or what `policy_of`
    takes.
    """
    store, lines = EpisodeStore(out), []
    for policy in policy_files(policies):
        case = case_of(policy, physics, seed, scenario, progress=progress)
        available = len(case.starts)
        if starts == "all" or (starts is None and claim):
            wanted = available
        else:
            wanted = min(STARTS, available) if starts is None else starts
        indices = case.rounds(wanted) if claim else case.sample(wanted)
        labels = {"policy": name_of(policy), "results": str(store.file(case).path)}
        lines.append(StudyLine(case, indices, labels, claim))
    simulate(lines, store, where, progress=progress)
    chosen = [(line.case, _to_record(line, store, recordings)) for line in lines]
    rows = []
    recorded = record(chosen, store, where.count, progress)
    for line, paths in zip(lines, recorded, strict=True):
        line.labels["recordings"] = tuple(map(str, paths.values()))
        rows.append(line.row(store, PolicyRow, paths))
    config = lines[0].case.config
    return EvaluationReport(
        seed=seed,
        mu=config.robot.mu,
        shield=config.shield is not None,
        world=config.world,
        policies=tuple(rows),
    )


def _to_record(line: StudyLine, store: EpisodeStore, count: int) -> list[int]:
    """Return the first failures and successes of a sample."""
    results = line.results(store)
    failed = [k for k, result in results.items() if result.outcome != Outcome.SUCCESS]
    succeeded = [k for k, result in results.items() if result.outcome == Outcome.SUCCESS]
    return failed[:count] + succeeded[:count]


def show(report: EvaluationReport) -> None:
    """Print a report as tables: outcomes with 95 % intervals, measures, the first failing starts.

    Path, rotation, time and energy are means of successes. Verdicts on claims come last.
    """
    show_table(COLUMNS, report.policies, names=2, title="outcomes with 95 % intervals")
    show_failures(report.policies)
    for row in report.policies:
        if row.claim is not None:
            print(f"{row.claim.verdict} for {row.policy}: {row.claim}")

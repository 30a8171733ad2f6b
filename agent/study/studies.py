"""Studies of this project: of policies, and of methods in the dynamics.

The command lines are `minirobots evaluate` and `transfer`; see docs/methods.md.
"""

from collections.abc import Iterable, Iterator
from itertools import product
from typing import Any, Literal, get_args

import msgspec

from agent.evaluation.claims import claim_of
from agent.evaluation.rows import OF_METHODS, OF_POLICIES, Row
from agent.evaluation.statistics import Interval, interval_text
from agent.study.engine import Line, lines_of, measure
from agent.study.grid import policy_files, show_failures
from agent.study.options import Sampling, TransferOptions
from agent.study.policies import name_of, policy_of
from agent.study.report import Report
from agent.study.store import EpisodeStore
from agent.training.methods import METHODS
from cosim.base.jobs import until
from cosim.base.progress import Progress, silent
from cosim.base.table import write_report
from cosim.model.params import TABLE_I
from cosim.model.scenario import Scenario
from cosim.model.scenario_file import find_scenario
from cosim.simulation.options import SimulationOptions

STARTS = 50
MUS = (TABLE_I.mu, 0.1, 0.2)  # most important first
_DETAILED = "moves"  # method with rows of every friction coefficient, and with goals
# Episodes of a pair in rows of that method at the default friction, and of other rows.
_MANY, _SOME, QUICK_EPISODES = 200, 50, 2
Verdict = Literal["does not hold", "not decided", "holds"]
_VERDICTS = get_args(Verdict)  # the worst first
# Goals of the best method: what is measured, with the shield or without, whether more (1) or less
# (-1) is better, and the limit.
_GOALS = {
    "success without the shield": ("success", False, 1, 0.99),
    "collisions with the shield": ("collision", True, -1, 0.0),
    "path length over the grid's": ("path_ratio_to_grid", False, -1, 1.25),
}


class EvaluationReport(Report, frozen=True, kw_only=True):
    """What policies achieve; path, rotation, time and energy are means of successes."""

    table = OF_POLICIES
    title = "outcomes with 95 % intervals"

    def show(self) -> None:
        """Print the table, the first failing starts, and verdicts on claims."""
        super().show()
        show_failures(self.rows)
        for row in self.rows:
            if row.claim is not None:
                print(f"{row.claim.verdict} for {row.policy}: {row.claim}")


def evaluate(
    policies: Iterable[Any],
    physics: SimulationOptions,
    how: Sampling,
    *,
    starts: int | None = None,
    exactly: bool = False,
    scenario: str | None = None,
    recordings: int = 3,
    progress: Progress = silent,
) -> EvaluationReport:
    """Simulate missing episodes, and record the selected ones, as the command's options say.

    Args:
        policies: files, folders of runs, or what `policy_of` takes.
        starts, exactly: see `count` of `lines_of`.
    """
    assert how.out is not None
    store = EpisodeStore(how.out)
    by_name = {name_of(policy): policy for policy in policy_files(policies)}
    claim = claim_of(how.claim, how.confidence)
    which: dict[str, Any] = {"exactly": exactly, "claim": claim, "trainings": how.trainings}
    lines = lines_of(by_name, [scenario], vars(physics), how.seed, starts, progress, **which)
    more = {"recordings": recordings, "may_begin": until(how.budget_minutes), "progress": progress}
    return EvaluationReport(seed=how.seed, rows=measure(lines, store, how.where, **more))


class Goal(msgspec.Struct, frozen=True, kw_only=True):
    """Whether the intervals of all rows that a goal is about keep its limit, and the worst row."""

    goal: str
    limit: float
    worst: float
    low: float | None
    high: float | None
    scenario: str
    mu: float
    verdict: Verdict

    def finding(self) -> str:
        """Return it as text."""
        form = (3, 1.0, "") if self.goal.startswith("path") else (1, 100.0, "%")
        digits, factor, unit = form
        limit = f"{factor * self.limit:.{digits}f}{unit}"
        worst = interval_text(Interval(self.worst, self.low, self.high), *form)
        return (
            f"- Goal, {self.goal} ({limit}): {self.verdict}; the worst row has {worst} "
            f"(scenario {self.scenario}, µ = {self.mu:g})."
        )


class TransferReport(Report, frozen=True, kw_only=True):
    """The content of transfer.json: `simulated` episodes are in its folder."""

    table = OF_METHODS
    episode_wall_s: float
    simulated: int
    goals: tuple[Goal, ...]

    def to_markdown(self) -> str:
        """Return the table as Markdown, the goals below it, and how long it took."""
        return f"{super().to_markdown()}\n\n{self._findings()}"

    def show(self) -> None:
        """Print what `to_markdown` has, in as many tables as the console is wide for."""
        super().show()
        print(self._findings())

    def _findings(self) -> str:
        last = (
            f"- {self.simulated} episodes, which took {self.episode_wall_s / 60.0:.0f} min of the "
            "threads."
        )
        return "\n".join([*(goal.finding() for goal in self.goals), last])


def transfer(how: TransferOptions, progress: Progress = silent) -> TransferReport:
    """Simulate missing episodes, write the table and return it."""
    may_begin, store = until(how.budget_minutes), EpisodeStore(how.out / "results")
    boards = [find_scenario(name, ideal=True) for name in how.scenarios]
    lines: list[Line] = []
    for method in (method for method in METHODS if method in how.methods):
        policies = [_trained(method, board, how, progress) for board in boards]
        mus = MUS if method == _DETAILED else MUS[:1]
        for mu, policy, shield in product(mus, policies, (False, True)):
            count = QUICK_EPISODES if how.quick else _SOME
            if method == _DETAILED and mu == TABLE_I.mu and not shield and not how.quick:
                count = None if policy.config.scenario.robots == 1 else _MANY
            physics = {"mu": [mu], "shield": [shield]}
            lines += lines_of({method: policy}, [None], physics, how.seed, count, progress)
    rows = measure(lines, store, how.where, may_begin=may_begin, progress=progress)
    report = TransferReport(
        rows=rows,
        axes=("mu", "shield"),
        seed=how.seed,
        episode_wall_s=sum(row.wall_s or 0.0 for row in rows),
        simulated=sum(len(store.results(line.case)) for line in lines),
        goals=tuple(goals(row for row in rows if row.policy == _DETAILED)),
    )
    write_report(how.out / "transfer", report, report.to_markdown())
    return report


def _trained(method: str, board: Scenario, how: TransferOptions, progress: Progress) -> Any:
    """Return the policy of a method for a board, which is kept in the folder of a study, too."""
    policy = policy_of(method, board, seed=how.seed, progress=progress)
    policy.save(how.out / "policies" / f"{board.name}-{method}.npz")
    return policy


def _verdict(of: Interval, sign: int, limit: float) -> Verdict:
    """Return whether a whole interval keeps a limit, or no part of it does, else "not decided"."""
    if of.low is None or of.high is None:
        return "not decided"
    room = sign * (of.low - limit), sign * (of.high - limit)
    if min(room) >= 0.0:
        return "holds"
    return "does not hold" if max(room) < 0.0 else "not decided"


def goals(best: Iterable[Row]) -> Iterator[Goal]:
    """Return whether each goal holds in all of the best method's rows that it is about."""
    rows = [row for row in best if row.episodes > 0]
    for goal, (measured, shield, sign, limit) in _GOALS.items():
        about: list[tuple[Verdict, Row]] = [
            (_verdict(row.interval(measured), sign, limit), row)
            for row in rows
            if row.shield == shield and getattr(row, measured) is not None
        ]
        if not about:
            continue
        verdict, row = min(
            about, key=lambda of: (_VERDICTS.index(of[0]), sign * getattr(of[1], measured))
        )
        found: Any = dict(zip(("worst", "low", "high"), row.interval(measured), strict=True))
        found |= {"scenario": row.scenario, "mu": row.mu}
        yield Goal(goal=goal, limit=limit, verdict=verdict, **found)

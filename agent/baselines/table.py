"""The table of docs/baselines.md: its rows, their statistics over seeds, and its text."""

import msgspec
import numpy as np

from agent.evaluation.grid import PolicyMeasures
from agent.evaluation.statistics import Interval, Rate, Statistics, interval_text, rate, summarise
from agent.process.exact import Milestone
from cosim.base.command import show_table
from cosim.base.outcome import Outcome

TABLE_FILE, MARKDOWN_FILE = "baselines.json", "baselines.md"
ENOUGH = 0.99  # success that learners are timed to


class Drive(msgspec.Struct, frozen=True):
    """An episode in the dynamics.

    Attributes:
        index: of the start.
        outcome: how it ended.
        sim_time_s: how long it took.
        least_s: least mean time from that start on observed moves, see `agent.moves.bound`.
    """

    index: int
    outcome: Outcome
    sim_time_s: float
    least_s: float


class LearnerRun(msgspec.Struct, frozen=True, kw_only=True):
    """A training with its episodes.

    Attributes:
        scenario, learner, seed: what was trained.
        seconds: wall-clock time, evaluations included.
        curve: what greedy robots achieved meanwhile; empty if nothing was learnt.
        grid: what its policy achieves on the grid.
        drives: and in the dynamics, as the files of episodes have it; none in the file.
    """

    scenario: str
    learner: str
    seed: int
    seconds: float
    curve: tuple[Milestone, ...]
    grid: PolicyMeasures
    drives: tuple[Drive, ...] = ()

    def first_enough(self) -> Milestone | None:
        """The first evaluation with a success of ENOUGH."""
        return next((point for point in self.curve if point.success >= ENOUGH), None)

    def driven(self, episodes: int) -> bool:
        """Whether so many episodes in the dynamics are there, or one from every start."""
        return len(self.drives) >= min(episodes, self.grid.starts)

    def succeeded(self) -> list[Drive]:
        """Episodes in the dynamics that did."""
        return [drive for drive in self.drives if drive.outcome == Outcome.SUCCESS]


class BaselineRow(msgspec.Struct, frozen=True, kw_only=True):
    """A row of baselines.json: a learner in a scenario, statistics over its seeds.

    Attributes:
        scenario, learner: what is measured.
        left_out: why it is not, if so.
        seeds: trainings that are there.
        success: on the grid, from all starts or a sample of them.
        path_ratio, moves_ratio: over the optimum (`agent.process.optimum.ratios`), of successes.
        reached: trainings that had a success of ENOUGH at some evaluation.
        steps_to_enough, seconds_to_enough: moves of all robots and time until then.
        episodes: in the dynamics, of all seeds.
        driven: success there, with its Wilson interval.
        time_s, time_ratio: simulated time of successes, and over the least time.
    """

    scenario: str
    learner: str
    left_out: str | None
    seeds: int
    success: Statistics
    path_ratio: Statistics
    moves_ratio: Statistics
    reached: int
    steps_to_enough: Statistics
    seconds_to_enough: Statistics
    episodes: int
    driven: Rate | None
    time_s: Statistics
    time_ratio: Statistics


class BaselinesReport(msgspec.Struct, frozen=True, kw_only=True):
    """The content of baselines.json.

    Attributes:
        quick: whether learners were trained only to see that it works.
        seed, seeds: first seed, and how many were asked for.
        episodes: asked for, in the dynamics, of each training.
        complete: whether all of them are there.
        rows: of the table.
    """

    schema_version: int = 1
    quick: bool
    seed: int
    seeds: int
    episodes: int
    complete: bool
    rows: tuple[BaselineRow, ...]


def report_of(
    rows: list[tuple[str, str, list[LearnerRun], str | None]],
    seeds: int,
    episodes: int,
    *,
    seed: int = 0,
    quick: bool = False,
) -> BaselinesReport:
    """The content of baselines.json.

    Args:
        rows: scenario, learner, its trainings, and why there are none, if so.
        seeds: asked for.
        episodes: asked for, of each; a scenario may have fewer starts.
        seed, quick: see `BaselinesReport`.
    """
    complete = all(
        reason or (len(runs) == seeds and all(r.driven(episodes) for r in runs))
        for *_, runs, reason in rows
    )
    return BaselinesReport(
        quick=quick,
        seed=seed,
        seeds=seeds,
        episodes=episodes,
        complete=complete,
        rows=tuple(_row(*row) for row in rows),
    )


def _row(scenario: str, learner: str, runs: list[LearnerRun], left_out: str | None) -> BaselineRow:
    reached = [point for run in runs if (point := run.first_enough()) is not None]
    drives = [drive for run in runs for drive in run.drives]
    driven = None
    if drives:
        driven = rate(sum(len(run.succeeded()) for run in runs), len(drives))
    means = [
        np.mean([(d.sim_time_s, d.least_s) for d in run.succeeded()], axis=0)
        for run in runs
        if run.succeeded()
    ]
    return BaselineRow(
        scenario=scenario,
        learner=learner,
        left_out=left_out,
        seeds=len(runs),
        success=summarise([run.grid.success for run in runs], shares=True),
        path_ratio=summarise([run.grid.ratio_to_bound for run in runs]),
        moves_ratio=summarise([run.grid.steps_ratio_to_bound for run in runs]),
        reached=len(reached),
        steps_to_enough=summarise([point.agent_steps for point in reached]),
        seconds_to_enough=summarise([point.seconds for point in reached]),
        episodes=len(drives),
        driven=driven,
        time_s=summarise([time for time, _ in means]),
        time_ratio=summarise([time / least for time, least in means]),
    )


_HEADINGS = (
    "scenario",
    "learner",
    "seeds",
    "success on the grid",
    "path × optimum",
    "moves × optimum",
    "agent steps to 99 %",
    "time to 99 %",
    "episodes",
    "success in the dynamics",
    "simulated",
    "× least time",
)


def _cells(row: BaselineRow) -> list[str]:
    if row.left_out:
        return [row.scenario, row.learner, row.left_out, *["–"] * (len(_HEADINGS) - 3)]
    some = "" if row.reached == row.seeds or not row.reached else f" ({row.reached} seeds)"
    return [
        row.scenario,
        row.learner,
        str(row.seeds),
        interval_text(row.success, 1, 100.0, " %"),
        interval_text(row.path_ratio, 3),
        interval_text(row.moves_ratio, 3),
        interval_text(row.steps_to_enough, 2, 1e-6, " million") + some,
        interval_text(row.seconds_to_enough, 1, 1.0, " s"),
        str(row.episodes),
        interval_text(Interval(*(row.driven or [None] * 3)), 1, 100.0, "%"),
        interval_text(row.time_s, 0, 1.0, " s"),
        interval_text(row.time_ratio, 2),
    ]


def markdown(report: BaselinesReport) -> str:
    """The table as Markdown."""
    rows = [_HEADINGS, ["---"] * len(_HEADINGS), *map(_cells, report.rows)]
    return "\n".join("| " + " | ".join(row) + " |" for row in rows)


def show(report: BaselinesReport) -> None:
    """Print the table, in as many parts as the console is wide for."""
    show_table(None, _HEADINGS, [_cells(row) for row in report.rows], names=2)

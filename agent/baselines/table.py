"""The table of docs/baselines.md: its rows, their statistics over seeds, and its text."""

import msgspec
import numpy as np

from agent.evaluation.grid import PolicyMeasures
from agent.evaluation.statistics import Interval, Rate, Statistics, interval_text, rate, summarise
from agent.mdp.exact import Milestone
from cosim.base.table import Column, field
from cosim.model.outcome import Outcome

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

    def driven(self, episodes: int) -> bool:
        """Return whether there are this many episodes in the dynamics, or one from every start."""
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
        path_ratio, moves_ratio: over the optimum (`agent.mdp.optimum.ratios`), of successes.
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
    enough = ([point for point in run.curve if point.success >= ENOUGH] for run in runs)
    reached = [points[0] for points in enough if points]
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


def _column(name: str, heading: str, digits: int, factor: float = 1.0, unit: str = "") -> Column:
    """Return the column of a measure with its interval."""

    def text(row: BaselineRow) -> str:
        value = getattr(row, name)
        interval = Interval(*value) if isinstance(value, Rate) else value
        if interval is None or row.left_out is not None:
            return "–"
        return interval_text(interval, digits, factor, unit)

    return Column(heading, text)


def _steps(row: BaselineRow) -> str:
    some = "" if row.reached == row.seeds or not row.reached else f" ({row.reached} seeds)"
    return _STEPS.text(row) + some


_STEPS = _column("steps_to_enough", "agent steps to 99 %", 2, 1e-6, " million")
COLUMNS = (
    field("scenario"),
    field("learner"),
    Column("seeds", lambda row: row.left_out or str(row.seeds)),
    _column("success", "success on the grid", 1, 100.0, " %"),
    _column("path_ratio", "path × optimum", 3),
    _column("moves_ratio", "moves × optimum", 3),
    Column(_STEPS.heading, _steps),
    _column("seconds_to_enough", "time to 99 %", 1, 1.0, " s"),
    Column("episodes", lambda row: "–" if row.left_out else str(row.episodes)),
    _column("driven", "success in the dynamics", 1, 100.0, "%"),
    _column("time_s", "simulated", 0, 1.0, " s"),
    _column("time_ratio", "× least time", 2),
)

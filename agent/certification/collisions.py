"""Estimate how probable collisions are, by splitting: levels are gaps between the robots.

A branch is the episode of its root, simulated again with the same random numbers up to the RL step
at the end of which the robots were so close for the first time. From there on its speed noise and
its camera frames differ. Branches are kept as they end.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path

import msgspec
import numpy as np
from scipy.stats import beta

from agent.certification.splitting import Branch, Entrances, split
from agent.evaluation.cases import Case, Job
from agent.evaluation.statistics import CONFIDENCE, rate_of_weights
from agent.study.store import Header, RowFile
from cosim.base.errors import UserError
from cosim.base.jobs import JobKind, Workers, run
from cosim.base.progress import Progress, silent
from cosim.base.provenance import digest_of
from cosim.base.reached_code import code_digest
from cosim.base.storage import write_json
from cosim.base.table import show_texts
from cosim.coupling.rl_step import Step
from cosim.model.outcome import Outcome
from cosim.simulation.episode import RunningEpisode
from cosim.simulation.tasks import Task, simulate_tasks

SPLITTING_FILE = "splitting.json"
_FORKS = 4_000_000  # child of an episode's seed, next to those of `cosim.model.world`


class BranchRow(msgspec.Struct, frozen=True):
    """A line of the file of branches; see `agent.certification.splitting`."""

    root: int
    forks: tuple[tuple[int, int], ...]
    entrances: Entrances
    last_step: int
    wall_s: float


class ReachedLevel(msgspec.Struct, frozen=True):
    """A gap between robots, and the probability that they come so close or touch anything.

    The last one has the gap 0: they touch each other or an obstacle. `low` and `high` are the 95 %
    Wilson interval of `worth` episodes, those that would have the same standard error: all roots
    where they agree.
    """

    gap_mm: float
    probability: float
    low: float
    high: float
    worth: float


class SplittingReport(msgspec.Struct, frozen=True, kw_only=True):
    """The content of splitting.json.

    Attributes:
        scenario, digest, seed: see `agent.evaluation.cases.Case`.
        roots: independent episodes.
        branches: that an episode has after a level.
        simulated: episodes in all.
        collision: estimate of the rate, without bias.
        low, high: 95 % interval, see `ReachedLevel`.
        roots_with_collision: roots of which a branch ended so.
        highest: bound of the rate at 97.5 % that holds for any distribution: that of the share of
            roots which show a collision (Clopper-Pearson).
        worth: plain episodes that would have the same standard error, or the roots if all agree.
        levels: on the way to a collision.
        wall_s: of all episodes together.
    """

    schema_version: int = 1
    scenario: str
    digest: str
    seed: int
    roots: int
    branches: int
    simulated: int
    collision: float
    low: float
    high: float
    roots_with_collision: int
    highest: float
    worth: float
    levels: tuple[ReachedLevel, ...]
    wall_s: float


def estimate_collisions(
    case: Case,
    out: Path,
    *,
    roots: int,
    branches: int,
    gaps_mm: Sequence[float],
    where: Workers = Workers(),  # noqa: B008 - a constant
    progress: Progress = silent,
) -> SplittingReport:
    """Simulate missing roots and branches, and write the estimate.

    Args:
        case: policy and configuration.
        out: folder of branches and estimate.
        roots: independent episodes, from the starts of `Case.rounds`.
        branches: that an episode has after a level, itself among them.
        gaps_mm: levels before contact, falling.
        where: backend and number of workers; the results do not depend on it.
        progress: receives how many episodes are simulated.

    Raises:
        UserError: robots cannot collide, or see its message.
    """
    if case.policy.config.scenario.robots == 1 or case.config.on_collision != "end":
        raise UserError(
            "splitting needs episodes that end where two robots collide; choose another scenario "
            "or leave out --on-collision continue"
        )
    diameter_m = case.policy.config.scenario.robot_diameter_m
    distances_m = tuple(diameter_m + 1e-3 * gap_mm for gap_mm in gaps_mm)
    digest = digest_of(case.identity, gaps_mm, code_digest(estimate_collisions))
    store, asked = _BranchStore(case, out, digest), {}

    def simulated(wanted: Sequence[Branch]) -> Iterator[tuple[Branch, Entrances, int]]:
        jobs = [BranchJob(case, digest, distances_m, branch) for branch in wanted]
        for _ in run(jobs, store, BRANCHES, where, progress=progress):
            pass
        for branch in wanted:
            row = asked[branch] = store.rows[branch]
            yield branch, row.entrances, row.last_step

    reached = split(case.rounds(roots), branches, len(gaps_mm) + 1, simulated)
    levels = tuple(map(_level, (*gaps_mm, 0.0), reached.T))
    with_one = int((reached[:, -1] > 0.0).sum())
    tail = 0.5 * (1.0 - CONFIDENCE)
    highest = 1.0 if with_one == roots else beta.isf(tail, with_one + 1, roots - with_one)
    report = SplittingReport(
        scenario=case.policy.config.scenario.name,
        digest=digest,
        seed=case.seed,
        roots=roots,
        branches=branches,
        simulated=len(asked),
        collision=levels[-1].probability,
        low=levels[-1].low,
        high=levels[-1].high,
        roots_with_collision=with_one,
        highest=float(highest),
        worth=levels[-1].worth,
        levels=levels,
        wall_s=sum(row.wall_s for row in asked.values()),
    )
    write_json(out / SPLITTING_FILE, report)
    return report


def show_splitting(report: SplittingReport) -> None:
    """Print the probabilities of the levels, and the estimate with its interval."""
    rows = [
        (f"{at.gap_mm:g} mm", f"{at.probability:.3g}", f"[{at.low:.3g}, {at.high:.3g}]")
        for at in report.levels
    ]
    show_texts(("gap", "probability", "95 %"), rows, numbers=2)
    print(
        f"collision {report.collision:.3g} [{report.low:.3g}, {report.high:.3g}] (95 %, Wilson "
        f"interval); {report.roots_with_collision} of {report.roots} roots showed one, so the rate "
        f"is at most {report.highest:.3g} (97.5 %); {report.simulated} episodes, worth "
        f"{report.worth:.0f} plain ones"
    )
    print("an estimate certifies nothing; --claim does")


def _level(gap_mm: float, values: np.ndarray) -> ReachedLevel:
    """A level by its estimates (roots,), one per root."""
    share, variance = float(values.mean()), float(values.var(ddof=1)) / len(values)
    worth = share * (1.0 - share) / variance if variance else float(len(values))
    return ReachedLevel(gap_mm, *rate_of_weights(share, worth), worth)


@dataclass(frozen=True)
class BranchJob:
    """A branch to simulate.

    Attributes:
        case: policy and configuration.
        digest: of the case and the levels.
        distances_m: levels before contact, as distances between the robots' centres.
        branch: by its seeds.
    """

    case: Case
    digest: str
    distances_m: tuple[float, ...]
    branch: Branch

    @property
    def key(self) -> tuple[str, Branch]:
        """Equal for equal branches."""
        return self.digest, self.branch

    def task(self, entrances: list[int], last: list[int]) -> Task:
        """Return what to simulate.

        Args:
            entrances: receives the steps at the ends of which the levels were reached.
            last: receives the number of the last step.
        """

        def watch(step: Step, episode: RunningEpisode, _: float) -> None:
            reached = sum(d >= episode.measures.min_distance_m for d in self.distances_m)
            if step.outcome == Outcome.COLLISION:
                reached = len(self.distances_m) + 1
            entrances.extend([step.number] * (reached - len(entrances)))
            last[:] = [step.number]

        task = Job(self.case, self.branch.root).task()
        return replace(task, watch=watch, redrawn=_seeds(task.seed, self.branch))


def _simulated(
    jobs: Sequence[BranchJob], threads: int, may_begin: Callable[[], bool]
) -> Iterator[tuple[BranchJob, BranchRow]]:
    entrances: list[list[int]] = [[] for _ in jobs]
    last: list[list[int]] = [[0] for _ in jobs]
    tasks = [job.task(*of) for job, *of in zip(jobs, entrances, last, strict=True)]
    for k, result in simulate_tasks(tasks, threads, may_begin):
        root, forks = jobs[k].branch
        yield jobs[k], BranchRow(root, forks, tuple(entrances[k]), last[k][0], result.wall_s)


def _batch(job: BranchJob) -> object:
    return Job(job.case, job.branch.root).task().batch_key


BRANCHES: JobKind[BranchJob, BranchRow] = JobKind(_simulated, _batch)


class _BranchStore:
    """Branches of a case in a file.

    Attributes:
        rows: by branch.
    """

    def __init__(self, case: Case, out: Path, digest: str) -> None:
        header = Header(**msgspec.structs.asdict(case.identity), digest=digest)
        path = out / f"{case.policy.config.scenario.name}-branches-{digest}.jsonl"
        self._file = RowFile(path, header, BranchRow)
        self.rows = {Branch(row.root, row.forks): row for row in self._file.rows}

    def find(self, job: BranchJob) -> BranchRow | None:
        """Return the row of a branch, None if it is missing."""
        return self.rows.get(job.branch)

    def keep(self, job: BranchJob, row: BranchRow) -> None:
        """Keep the row of a branch."""
        self._file.append(row)
        self.rows[job.branch] = row


def _seeds(seed: np.random.SeedSequence, branch: Branch) -> dict[int, np.random.SeedSequence]:
    """Seeds by the steps from which on they hold: each is of its fork and of those before it."""
    seeds = {}
    for count, (step, _) in enumerate(branch.forks, 1):
        key = (*seed.spawn_key, _FORKS, *chain(*branch.forks[:count]))
        seeds[step] = np.random.SeedSequence(seed.entropy, spawn_key=key)
    return seeds

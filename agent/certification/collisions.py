"""How probable collisions are, by splitting: levels are gaps between the robots.

A branch is the episode of its root, simulated again with the same random numbers up to the RL step
at whose end the robots were so close for the first time; from there on its speed noise and its
camera frames are others. Branches are kept as they end.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import chain
from pathlib import Path

import msgspec
import numpy as np
from scipy.stats import beta

from agent.certification.splitting import Branch, Entrances, split
from agent.evaluation.cases import Case, Job
from agent.evaluation.row_file import Header, RowFile
from agent.evaluation.statistics import CONFIDENCE, rate_of_weights
from cosim.base.errors import UserError
from cosim.base.outcome import Outcome
from cosim.base.progress import Progress, silent
from cosim.base.provenance import digest_of
from cosim.base.reached_code import code_digest
from cosim.base.storage import write_json
from cosim.episodes import Task, simulate_tasks
from cosim.navigation.episode import RunningEpisode
from cosim.navigation.step import Step

SPLITTING_FILE = "splitting.json"
_FORKS = 4_000_000  # child of an episode's seed, beside those of `cosim.base.world`


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
    jobs: int = 2,
    progress: Progress = silent,
) -> SplittingReport:
    """Simulate what is missing of the roots and their branches, and write the estimate.

    Args:
        case: policy and configuration.
        out: folder of branches and estimate.
        roots: independent episodes, from the starts of `Case.cover`.
        branches: that an episode has after a level, itself among them.
        gaps_mm: levels before contact, falling.
        jobs: threads; the results do not depend on it.
        progress: is told how many episodes are simulated.

    Raises:
        UserError: robots cannot collide, or see its message.
    """
    if case.policy.config.scenario.robots == 1 or case.config.on_collision != "end":
        raise UserError(
            "splitting needs episodes that end where two robots collide; choose another scenario "
            "or leave out --on-collision continue"
        )
    simulated = _Branches(case, out, tuple(gaps_mm), jobs, progress)
    reached = split(case.cover(roots), branches, len(gaps_mm) + 1, simulated)
    levels = tuple(map(_level, (*gaps_mm, 0.0), reached.T))
    with_one = int((reached[:, -1] > 0.0).sum())
    tail = 0.5 * (1.0 - CONFIDENCE)
    highest = 1.0 if with_one == roots else beta.isf(tail, with_one + 1, roots - with_one)
    report = SplittingReport(
        scenario=case.policy.config.scenario.name,
        digest=simulated.digest,
        seed=case.seed,
        roots=roots,
        branches=branches,
        simulated=len(simulated.asked),
        collision=levels[-1].probability,
        low=levels[-1].low,
        high=levels[-1].high,
        roots_with_collision=with_one,
        highest=float(highest),
        worth=levels[-1].worth,
        levels=levels,
        wall_s=sum(row.wall_s for row in simulated.asked.values()),
    )
    write_json(out / SPLITTING_FILE, report)
    return report


def _level(gap_mm: float, values: np.ndarray) -> ReachedLevel:
    """A level by its estimates (roots,), one per root."""
    share, variance = float(values.mean()), float(values.var(ddof=1)) / len(values)
    worth = share * (1.0 - share) / variance if variance else float(len(values))
    return ReachedLevel(gap_mm, *rate_of_weights(share, worth), worth)


class _Branches:
    """Simulates branches, or finds them in their file.

    Attributes:
        digest: of the case and the levels.
        asked: rows of all branches asked for so far.
    """

    def __init__(
        self, case: Case, out: Path, gaps_mm: tuple[float, ...], jobs: int, progress: Progress
    ) -> None:
        self._case, self._jobs, self._progress = case, jobs, progress
        diameter_m = case.policy.config.scenario.robot_diameter_m
        self._distances_m = [diameter_m + 1e-3 * gap_mm for gap_mm in gaps_mm]
        self.digest = digest_of(case.identity, gaps_mm, code_digest(__name__))
        header = Header(**msgspec.structs.asdict(case.identity), digest=self.digest)
        path = out / f"{case.policy.config.scenario.name}-branches-{self.digest}.jsonl"
        self._file = RowFile(path, header, BranchRow)
        self._known = {Branch(row.root, row.forks): row for row in self._file.rows}
        self.asked: dict[Branch, BranchRow] = {}

    def __call__(self, branches: Sequence[Branch]) -> Iterable[tuple[Branch, Entrances, int]]:
        missing = [branch for branch in branches if branch not in self._known]
        for row in self._simulated(missing):
            self._file.append(row)
            self._known[Branch(row.root, row.forks)] = row
            self._progress("episodes", len(self._known), None, f"{len(self._known)} episodes")
        found = {branch: self._known[branch] for branch in branches}
        self.asked |= found
        return ((branch, row.entrances, row.last_step) for branch, row in found.items())

    def _simulated(self, branches: Sequence[Branch]) -> Iterator[BranchRow]:
        entrances: list[list[int]] = [[] for _ in branches]
        last = [0] * len(branches)
        tasks = [self._task(branch, k, entrances[k], last) for k, branch in enumerate(branches)]
        for number, result in simulate_tasks(tasks, self._jobs):
            root, forks = branches[number]
            yield BranchRow(root, forks, tuple(entrances[number]), last[number], result.wall_s)

    def _task(self, branch: Branch, number: int, entrances: list[int], last: list[int]) -> Task:
        levels = len(self._distances_m) + 1

        def watch(step: Step, episode: RunningEpisode, _: float) -> None:
            reached = sum(d >= episode.measures.min_distance_m for d in self._distances_m)
            if step.outcome == Outcome.COLLISION:
                reached = levels
            entrances.extend([step.number] * (reached - len(entrances)))
            last[number] = step.number

        task = Job(self._case, branch.root).task()
        return replace(task, watch=watch, redrawn=_seeds(task.seed, branch))


def _seeds(seed: np.random.SeedSequence, branch: Branch) -> dict[int, np.random.SeedSequence]:
    """Seeds by the steps from which on they hold: each is of its fork and of those before it."""
    seeds = {}
    for count, (step, _) in enumerate(branch.forks, 1):
        key = (*seed.spawn_key, _FORKS, *chain(*branch.forks[:count]))
        seeds[step] = np.random.SeedSequence(seed.entropy, spawn_key=key)
    return seeds

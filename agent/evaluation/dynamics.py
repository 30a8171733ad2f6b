"""What policies achieve in the full dynamics, start by start: episodes, results, recordings.

The counterpart of `agent.evaluation.grid`, which is exact on the grid. Results are kept as they
come; the command line is `cosim.evaluate`.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Literal

import msgspec

from agent.evaluation.cases import Case, Job, run_jobs
from agent.evaluation.grid import policy_files
from agent.evaluation.outcomes import Failure, Measured, failures, summary
from agent.evaluation.result_file import ResultFile
from agent.policies import load_policy
from cosim.base.errors import UserError
from cosim.base.outcome import Outcome
from cosim.base.progress import Progress, silent, under_way
from cosim.base.world import IDEAL, World
from cosim.episodes import compile_kernels
from cosim.navigation.options import Driving
from cosim.navigation.result import EpisodeResult
from cosim.scenarios.file import find_in_world, in_world, read_world

STARTS = 50
Starts = int | Literal["all"] | None


class Evaluated:
    """A named policy with the episodes asked for and those that are there."""

    def __init__(
        self, name: str, file: ResultFile, starts: Starts, folder: Path, recorded: int
    ) -> None:
        self.name = name
        self.case = file.case
        some = min(STARTS, len(file.case.starts)) if starts is None else starts
        self.indices = file.case.sample(None if some == "all" else some)
        self.file = file
        self.recordings: dict[int, Path] = {}
        self._folder, self._recorded = folder, recorded

    def missing(self) -> list[Job]:
        """Episodes not yet simulated, in the order of the sample."""
        return self.file.missing(self.indices)

    def results(self) -> dict[int, EpisodeResult]:
        """Results so far of the episodes asked for, in the order of the sample."""
        found = {k: self.file.results.get(k) for k in self.indices}
        return {
            k: msgspec.structs.replace(r, recording=self._recording(k))
            for k, r in found.items()
            if r is not None
        }

    def _recording(self, index: int) -> str | None:
        return str(self.recordings[index]) if index in self.recordings else None

    def unrecorded(self) -> list[Job]:
        """Episodes to record: the first failures and successes of the sample, simulated again."""
        failed: list[int] = []
        succeeded: list[int] = []
        for index, result in self.results().items():
            (succeeded if result.outcome == Outcome.SUCCESS else failed).append(index)
        jobs: list[Job] = []
        for index in failed[: self._recorded] + succeeded[: self._recorded]:
            outcome = self.file.results[index].outcome
            path = self._folder / f"{self.file.path.stem}-{index:06d}-{outcome}.rrd"
            self.recordings[index] = path
            if not path.exists():
                jobs.append(Job(self.case, index, path))
        return jobs


def evaluate(
    policies: Iterable[Path],
    physics: Driving,
    out: Path,
    *,
    starts: Starts = None,
    seed: int = 0,
    scenario: str | None = None,
    recordings: int = 3,
    jobs: int = 2,
    progress: Progress = silent,
) -> list[Evaluated]:
    """Simulate what is missing, and record what is to be recorded.

    Args:
        policies: files, or folders of runs.
        physics: of the co-simulation.
        out: folder of results and recordings.
        starts: how many to sample; by default `STARTS`, or all where there are fewer.
        seed: of the sample and of the speed noise.
        scenario: refuse policies of any other one.
        recordings: failures to record of each policy, and successes.
        jobs: threads; the results do not depend on it.
        progress: is told what is prepared and simulated.

    Raises:
        UserError: see its message.
    """
    only, world = None, IDEAL if physics.world is None else read_world(physics.world)
    if scenario is not None:
        only, world = find_in_world(scenario, physics.world)
    named = [(path, load_policy(path, only)) for path in policy_files(tuple(policies))]
    for path, policy in named:
        policy.require_scenario(in_world(policy.config.scenario, world), f"{path}: the policy")
    diameters = {policy.config.scenario.robot_diameter_m for _, policy in named}
    prepared = {d: physics.prepare(d, progress, world) for d in diameters}
    files: dict[str, ResultFile] = {}
    evaluated: list[Evaluated] = []
    for path, policy in named:
        config, fmu = prepared[policy.config.scenario.robot_diameter_m]
        case = Case(policy, config, fmu, seed)
        file = files.setdefault(case.digest, ResultFile(out, case))
        evaluated.append(Evaluated(str(path), file, starts, out / "recordings", recordings))
    missing = list({job.key: job for e in evaluated for job in e.missing()}.values())
    if missing:
        with under_way(progress, "preparing the kernels"):
            compile_kernels(missing[0].task(), len(missing), jobs)
    for job, result in tracked(run_jobs(missing, jobs), len(missing), progress, "episodes"):
        files[job.case.digest].add(job.index, result)
    unrecorded = list({job.key: job for e in evaluated for job in e.unrecorded()}.values())
    record(unrecorded, files, jobs, progress)
    return evaluated


def record(
    jobs: Sequence[Job], files: Mapping[str, ResultFile], threads: int, progress: Progress = silent
) -> None:
    """Simulate episodes again and record them.

    Args:
        jobs: with the paths of their recordings.
        files: with their results, by digest of the case.
        threads: of the simulation.
        progress: is told how many are recorded.

    Raises:
        UserError: an episode ends otherwise than the first time.
    """
    for job, result in tracked(run_jobs(jobs, threads), len(jobs), progress, "recordings"):
        file = files[job.case.digest]
        first = file.results[job.index]
        again = msgspec.structs.replace(
            result, recording=None, realtime_factor=first.realtime_factor
        )
        if again != first:
            raise UserError(
                f"{job.recording}: the same episode ended otherwise when it was simulated again; "
                f"{file.path} was made by another machine or library: remove it"
            )


def tracked(
    episodes: Iterator[tuple[Job, EpisodeResult]], total: int, progress: Progress, task: str
) -> Iterator[tuple[Job, EpisodeResult]]:
    """Pass episodes on and report how many there are, and their success."""
    successes = 0
    for count, (job, result) in enumerate(episodes, 1):
        yield job, result
        successes += result.outcome == Outcome.SUCCESS
        progress(task, count, total, f"{count}/{total}  success {successes / count:.1%}")


class PolicyRow(Measured, frozen=True, kw_only=True):
    """A policy of a report.

    Attributes:
        policy: name of its file.
        scenario, digest: what was simulated, see `Case`.
        starts: how many there are.
        wall_s: of all episodes together.
        failing_starts, failures: those that did not end in success.
        recordings, results: files.
    """

    policy: str
    scenario: str
    digest: str
    starts: int
    wall_s: float
    failing_starts: int
    failures: tuple[Failure, ...]
    recordings: tuple[str, ...]
    results: str


class EvaluationReport(msgspec.Struct, frozen=True, kw_only=True):
    """What `python -m cosim.evaluate --json` prints: the policies under one physics."""

    schema_version: int = 1
    seed: int
    mu: float
    shield: bool
    world: World
    policies: tuple[PolicyRow, ...]


def report_of(evaluated: list[Evaluated], seed: int) -> EvaluationReport:
    """Rates, measures and failures of evaluated policies."""
    rows = []
    for e in evaluated:
        results = e.results()
        failed = failures(results)
        rows.append(
            PolicyRow(
                policy=e.name,
                scenario=e.case.policy.config.scenario.name,
                digest=e.case.digest,
                starts=len(e.case.starts),
                **msgspec.structs.asdict(summary(e.case, results)),
                wall_s=sum(r.wall_s for r in results.values()),
                failing_starts=len(failed),
                failures=failed,
                recordings=tuple(str(path) for path in e.recordings.values()),
                results=str(e.file.path),
            )
        )
    config = evaluated[0].case.config
    return EvaluationReport(
        seed=seed,
        mu=config.robot.mu,
        shield=config.shield is not None,
        world=config.world,
        policies=tuple(rows),
    )

"""Tables of episodes: the episodes of a row, its statistics, and its text."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from agent.evaluation.cases import Case, Job, run_jobs
from agent.evaluation.claims import Claim, JudgedClaim
from agent.evaluation.outcomes import Failure, Measured, failures, summary
from agent.evaluation.statistics import Interval, interval_text
from agent.study.policies import name_of, policy_of
from agent.study.store import EpisodeStore
from cosim.base.errors import UserError
from cosim.base.jobs import JobKind, Workers, always, run
from cosim.base.progress import Progress, silent
from cosim.base.table import Column
from cosim.base.table import field as column
from cosim.model.outcome import Outcome
from cosim.model.scenario_file import find_in_world
from cosim.simulation.driving import options_for
from cosim.simulation.options import SimulationOptions, resolve
from cosim.simulation.result import EpisodeResult
from cosim.simulation.tasks import compile_kernels

EPISODES: JobKind[Job, EpisodeResult] = JobKind(
    run_jobs,
    batch=lambda job: job.task().batch_key,
    succeeded=lambda result: result.outcome == Outcome.SUCCESS,
    prepare=lambda jobs, threads: compile_kernels(jobs[0].task(), len(jobs), threads),
)


def case_of(
    policy: Any,
    options: SimulationOptions,
    seed: int,
    scenario: Any = None,
    *,
    world: Any = None,
    name: str | None = None,
    progress: Progress = silent,
) -> Case:
    """Return a policy under the options of a command.

    Args:
        policy: what `policy_of` takes.
        options: of the command.
        seed: of training, of samples of starts and of what episodes draw.
        scenario: name, file or record; by default that of the policy.
        world: see `resolve`.
        name: of the policy, for messages.
        progress: receives what is trained and calibrated.

    Raises:
        UserError: see `policy_of` and `resolve`.
    """
    given = options.world if world is None else world
    only = None if scenario is None else options.board(find_in_world(scenario, given)[0])
    name = f"{name or name_of(policy)}: the policy"
    policy = policy_of(policy, only, seed=seed, progress=progress)
    _, config, fmu = resolve(
        options_for(policy, options),
        policy.config.scenario if scenario is None else scenario,
        progress,
        world=world,
        require=lambda board: policy.require_scenario(board, name),
    )
    return Case(policy, config, fmu, seed)


class EpisodesRow(Measured, frozen=True, kw_only=True):
    """A row of a table of episodes; see `Measured` for what they achieve.

    Attributes:
        scenario: its name.
        mu, shield, drive_speed_m_s: of the co-simulation; the speed is that of the calibration.
        starts: combinations of start cells that the scenario has.
        planned: episodes asked for.
        wall_s: wall-clock time of the episodes counted, of all threads together.
        digest: of the case.
        failing_starts: how many episodes did not end in success.
        failures: these.
    """

    scenario: str
    mu: float
    shield: bool
    drive_speed_m_s: float
    starts: int
    planned: int
    wall_s: float
    digest: str
    failing_starts: int
    failures: tuple[Failure, ...]


Row = TypeVar("Row", bound=EpisodesRow)


@dataclass(frozen=True)
class StudyLine:
    """The episodes of a row.

    Attributes:
        case: policy and configuration.
        indices: of the starts, see `Case.sample`.
        labels: what else names the row, by field of the row.
        claim: statement about the policy; the row ends with the episode that decides it.

    Raises:
        UserError: the claim is about episodes that do not end where robots collide.
    """

    case: Case
    indices: list[int]
    labels: dict[str, Any] = field(default_factory=dict)
    claim: Claim | None = None

    def __post_init__(self) -> None:
        if self.claim is not None and self.case.config.on_collision != "end":
            raise UserError(
                "a claim is about episodes that end where robots collide; leave out --on-collision "
                "continue"
            )

    def jobs(self) -> list[Job]:
        """Return the episodes, the first ones of the sample first."""
        return [Job(self.case, index) for index in self.indices]

    def results(self, store: EpisodeStore) -> dict[int, EpisodeResult]:
        """Return the episodes that count: the completed prefix, up to the decision of the claim."""
        known = store.file(self.case).completed_prefix(self.indices)
        count = None if self.claim is None else self.claim.judge(known.values()).episodes
        return dict(islice(known.items(), count))

    def row(self, store: EpisodeStore, form: type[Row], recordings: Mapping[int, Path] = {}) -> Row:
        """Return the row of the episodes that count.

        Args:
            store: of the episodes.
            form: of the row; its further fields are the labels.
            recordings: of some of the episodes, by index of the start.
        """
        case, results = self.case, self.results(store)
        judged = {"claim": self.claim.judge(results.values())} if self.claim else {}
        failed = tuple(
            msgspec.structs.replace(failure, recording=str(recordings[failure.index]))
            if failure.index in recordings
            else failure
            for failure in failures(results)
        )
        return form(
            **msgspec.structs.asdict(summary(case, results)),
            **{
                "scenario": case.policy.config.scenario.name,
                "mu": case.config.robot.mu,
                "shield": case.config.shield is not None,
                "drive_speed_m_s": case.config.steering.drive_speed_m_s,
                "starts": len(case.starts),
                "planned": len(self.indices),
                "wall_s": sum(r.wall_s for r in results.values()),
                "digest": case.digest,
                "failing_starts": len(failed),
                "failures": failed,
                **judged,
                **self.labels,
            },
        )


def simulate(
    lines: Sequence[StudyLine],
    store: EpisodeStore,
    where: Workers,
    *,
    may_begin: Callable[[], bool] = always,
    progress: Progress = silent,
) -> None:
    """Simulate the missing episodes of all rows at once, so that rows share batches.

    Rows with a claim follow one by one, each in its order until its claim is decided.
    """

    def compute(jobs: list[Job], may_begin: Callable[[], bool]) -> Iterator[EpisodeResult]:
        ended = run(jobs, store, EPISODES, where, may_begin=may_begin, progress=progress)
        return (result for _, result in ended)

    def judge(line: StudyLine, claim: Claim) -> JudgedClaim:
        known = store.file(line.case).completed_prefix(line.indices)
        return claim.judge(known.values())

    together = [job for line in lines if line.claim is None for job in line.jobs()]
    for _ in compute(together, may_begin):
        pass
    for line in lines:
        if (claim := line.claim) is None:
            continue
        judged = judge(line, claim)

        def undecided() -> bool:
            return judged.verdict == "undecided" and may_begin()  # noqa: B023 - of this line

        while undecided():
            jobs = [job for job in line.jobs()[: judged.enough] if store.find(job) is None]
            if not jobs:
                break
            for result in compute(jobs, undecided):
                if result.outcome in claim.against:
                    judged = judge(line, claim)
            judged = judge(line, claim)


def record(
    chosen: Sequence[tuple[Case, Iterable[int]]],
    store: EpisodeStore,
    threads: int,
    progress: Progress = silent,
) -> list[dict[int, Path]]:
    """Simulate episodes again that are not recorded, and record them, on this machine.

    Args:
        chosen: indices of each case's starts with results in the store.
        store: of the results.
        threads: of the simulation.
        progress: receives how many are recorded.

    Returns:
        The recordings of each case, by index of the start.

    Raises:
        UserError: an episode ends otherwise than the first time.
    """
    found: list[dict[int, Path]] = []
    jobs: dict[Path, Job] = {}
    for case, indices in chosen:
        file = store.file(case)
        place = str(file.path.parent / "recordings" / file.path.stem)
        paths = {k: Path(f"{place}-{k:06d}-{file.results[k].outcome}.rrd") for k in indices}
        jobs |= {path: Job(case, k, path) for k, path in paths.items() if not path.exists()}
        found.append(paths)
    for count, (job, result) in enumerate(run_jobs(list(jobs.values()), threads), 1):
        first = store.file(job.case).results[job.index]
        factor = first.realtime_factor
        if msgspec.structs.replace(result, recording=None, realtime_factor=factor) != first:
            raise UserError(
                f"{job.recording}: the same episode ended otherwise when it was simulated again. "
                "Either the policy draws at random or remembers other episodes: let it depend on "
                f"the observation alone. Or {store.file(job.case).path} was made by another "
                "machine or library: remove it"
            )
        progress("recordings", count, len(jobs), f"{count}/{len(jobs)}")
    return found


def interval_of(row: Measured, name: str) -> Interval:
    """Return a measure of a row with its interval."""
    return Interval(*(getattr(row, name + end) for end in ("", "_low", "_high")))


def _others(row: EpisodesRow) -> str:
    shares = (getattr(row, name) or 0.0 for name in ("out_of_board", "timeout"))
    counts = ", ".join(str(round(row.episodes * share)) for share in shares)
    return counts if row.episodes else "–"


def _episodes(row: EpisodesRow) -> str:
    n = row.episodes
    return str(n) if n == row.planned else f"{n} of {row.planned}"


def rate_column(name: str) -> Column:
    """Return the column of the rate of an outcome."""
    return Column(
        name.replace("_", " "), lambda row: interval_text(interval_of(row, name), 1, 100.0, "%")
    )


SCENARIO, METHOD = column("scenario"), column("method")
MU = column("mu", "{:g}", "µ")
SHIELD = Column("shield", lambda row: "on" if row.shield else "off")
SPEED = Column("speed", lambda row: f"{1e3 * row.drive_speed_m_s:.2f} mm/s")
PATH_RATIO = Column(
    "× own grid path", lambda row: interval_text(interval_of(row, "path_ratio_to_grid"), 3)
)
OUTCOMES = (
    Column("episodes", _episodes),
    rate_column("success"),
    rate_column("collision"),
    Column("out of board, timeout", _others),
)
MEASURES = (
    column("min_distance_cm", "{:.2f} cm", "min distance"),
    column("path_length_cm", "{:.1f} cm", "path"),
    column("rotation_deg", "{:.0f}°", "rotation"),
    column("sim_time_s", "{:.0f} s", "simulated"),
    column("energy_j", "{:.1f} J", "energy"),
)

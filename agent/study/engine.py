"""The engine of all studies: cases become jobs, jobs episodes that are kept, and these rows."""

import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from itertools import islice, product
from pathlib import Path
from typing import Any

import msgspec

from agent.evaluation.cases import Case, Job, run_jobs
from agent.evaluation.claims import Claim, JudgedClaim
from agent.evaluation.rows import Failure, Row, measures, text_of
from agent.mdp.greedy import GreedyPolicy
from agent.study.options import Sampling
from agent.study.policies import is_trained, policy_of
from agent.study.store import EpisodeStore, simulate_missing
from cosim.base.arguments import ConfigError, to_plain
from cosim.base.errors import UserError, shorten
from cosim.base.jobs import Workers, always
from cosim.base.progress import Progress, silent
from cosim.model.outcome import Outcome
from cosim.model.scenario import Scenario
from cosim.model.scenario_file import find_in_world
from cosim.model.world import World
from cosim.simulation.driving import needs_calibration, options_for
from cosim.simulation.options import options_of, resolve
from cosim.simulation.result import EpisodeResult

_LOGGER = logging.getLogger(__name__)
# Options that are taken before those of the physics, for messages about unknown ones.
_OF_STUDY = [f.name for kind in (Sampling, Workers) for f in fields(kind) if f.name != "where"]


@dataclass(frozen=True)
class Line:
    """What a row is made of: a case, and which of its episodes; each training has a row."""

    case: Case
    indices: list[int]  # of the starts, see `Case.sample`
    policy: str  # of the row, as are its options
    options: dict[str, Any] = field(default_factory=dict)
    claim: Claim | None = None  # about the policy; the row ends with the episode that decides it
    training: int | None = None  # seed of the policy's training, if the study has trained it

    def __post_init__(self) -> None:
        if self.claim is not None and self.case.config.on_collision != "end":
            raise UserError(
                "a claim is about episodes that end where robots collide; leave out --on-collision "
                "continue"
            )

    def results(self, store: EpisodeStore) -> dict[int, EpisodeResult]:
        """Return the episodes that count: the completed prefix, up to the decision of the claim."""
        known = store.completed_prefix(self.case, self.indices)
        return dict(islice(known.items(), self.claim and self.claim.judge(known.values()).episodes))

    def row(self, store: EpisodeStore, recordings: Mapping[int, Path] = {}) -> Row:
        """Return the row of the episodes that count, which it has; some are recorded."""
        case, results, claim = self.case, self.results(store), self.claim
        failures = tuple(
            Failure(
                starts=result.starts,
                outcome=result.outcome,
                index=index,
                recording=str(recordings[index]) if index in recordings else None,
            )
            for index, result in sorted(results.items())
            if result.outcome != Outcome.SUCCESS
        )
        return Row(
            policy=self.policy,
            scenario=case.policy.config.scenario.name,
            options=self.options,
            **measures([(case, results)]),
            mu=case.config.robot.mu,
            shield=case.config.shield is not None,
            drive_speed_m_s=case.config.steering.drive_speed_m_s
            if needs_calibration(case.policy)
            else None,
            starts=len(case.starts),
            planned=len(self.indices),
            wall_s=sum(r.wall_s for r in results.values()),
            digest=case.digest,
            failing_starts=len(failures),
            failures=failures,
            recordings=tuple(map(str, recordings.values())),
            claim=claim and claim.judge(results.values()),
            results=results,
            training=self.training,
            trainings=1 if case.policy.episodes else None,
        )


def lines_of(
    policies: Mapping[str, Any],
    scenarios: Sequence[Any],
    given: Mapping[str, Any],
    seed: int,
    count: int | None,
    progress: Progress = silent,
    *,
    exactly: bool = False,
    claim: Claim | None = None,
    trainings: int = 1,
) -> list[Line]:
    """Return policies in every combination of scenarios and options, a line for each training.

    Args:
        policies: by name, what `policy_of` takes.
        scenarios: None for that of every policy.
        given: `world` and options of `minirobots run`; a list is an axis, as are worlds by names
            that no field of a world has.
        seed: of training, of samples of starts and of what episodes draw.
        count: episodes of a row, None for one from every start. Where there are fewer starts, all,
            or with a claim these again, each time with other noise.
        exactly: whether fewer starts are refused instead.
        trainings: of methods that learn, with the seeds from `seed` on.
    """
    given = {name: to_plain(name, value) for name, value in given.items()}
    worlds: dict[Any, Any] = {}
    if isinstance(of := given.get("world"), Mapping) and not {*of} & {*World.__struct_fields__}:
        worlds = dict(of)
        given["world"] = list(worlds) or of
    axes = {name: value for name, value in given.items() if isinstance(value, list)}
    if not (policies and scenarios and all(axes.values())):
        raise ConfigError("policies, scenarios and every axis need at least one value each")
    boards = [board for board in scenarios if board is not None]
    _require_distinct("scenario", [find_in_world(board)[0].name for board in boards])
    for name, several in axes.items():
        _require_distinct(name, several)
    lines: list[Line] = []
    found: dict[tuple[str, Scenario | None, str, int | None], Any] = {}
    if claim is not None and trainings > 1:
        raise ConfigError(
            f"trainings = {trainings} contradicts a claim, which is about one policy; leave out one"
        )
    if trainings > 1 and not any(map(is_trained, policies.values())):
        raise ConfigError(
            f"trainings = {trainings} has no effect: no policy here is trained for the study; "
            "leave it out, or name a method that learns"
        )
    drawn = [
        (name, of, training)
        for name, of in policies.items()
        for training in (range(seed, seed + trainings) if is_trained(of) else (None,))
    ]
    for board, (name, of, training), values in product(scenarios, drawn, product(*axes.values())):
        chosen = dict(zip(axes, values, strict=True))
        physics = {"world": None, **given, **chosen}
        world = physics.pop("world")
        world = worlds[world] if worlds else world
        options = options_of("study", physics, *_OF_STUDY)
        only = None if board is None else options.board(board, world)[0]
        key = name, only, str(options.machine), training
        if key not in found:
            how = {"seed": training or 0, "options": options, "progress": progress}
            found[key] = policy_of(of, only, **how)
        policy = found[key]
        setup = resolve(
            options_for(policy, options),
            policy.config.scenario if board is None else board,
            progress,
            world=world,
            require=lambda own, p=policy, name=name: p.require_scenario(own, f"{name}: the policy"),
            calibrate=needs_calibration(policy),
        )
        if isinstance(policy, GreedyPolicy):
            policy.warn_of_machine(setup.config)
        case = Case(policy, setup.config, setup.fmu, seed)
        starts = len(case.starts)
        if claim is not None:
            indices = case.rounds(count or starts)
        else:
            indices = case.sample(count if count and exactly else min(count or starts, starts))
        lines.append(Line(case, indices, name, chosen, claim, training))
    return lines


def _require_distinct(name: str, values: Sequence[Any]) -> None:
    """Refuse values of an axis with rows that look the same."""
    known: dict[str, Any] = {}
    for value in values:
        text = text_of(value)
        if text in known:
            raise ConfigError(
                f"{name} = {shorten(list(values))} has {known[text]!r} and {value!r}, which tables "
                f"show alike, as {text}; leave one out"
            )
        known[text] = value


def measure(
    lines: Sequence[Line],
    store: EpisodeStore,
    where: Workers,
    *,
    recordings: int = 0,
    episodes: bool = False,
    may_begin: Callable[[], bool] = always,
    progress: Progress = silent,
) -> tuple[Row, ...]:
    """Simulate the missing episodes of all rows at once, so that they share batches.

    Rows with a claim follow one by one, each in its order until its claim is decided. Trainings of
    one method become a row over all of them.

    Args:
        recordings: how many failures, and successes, of each row are recorded, on this machine.
        episodes: whether rows have theirs.
    """
    odd = dict.fromkeys(line.policy for line in lines if not line.case.known)
    if odd and store.path is not None:
        _LOGGER.warning(
            "%s: the class has no method digest; episodes are kept in memory only and will not be "
            "found again (docs/studies.md)",
            ", ".join(odd),
        )
    how: dict[str, Any] = {"where": where, "progress": progress}
    together = [Job(line.case, k) for line in lines if line.claim is None for k in line.indices]
    for _ in simulate_missing(together, store, may_begin=may_begin, **how):
        pass
    for line in lines:
        if line.claim is not None:
            _decide(line, line.claim, store, may_begin, how)
    recorded = _record(lines, store, recordings, where.count if recordings else 1, progress)
    groups: dict[str, list[tuple[Line, Row]]] = {}
    for line, paths in zip(lines, recorded, strict=True):
        row = line.row(store, paths)
        groups.setdefault(str(row.labels()), []).append((line, row))
    rows = map(_pooled, groups.values())
    return tuple(rows) if episodes else tuple(map(_without_episodes, rows))


def _without_episodes(row: Row) -> Row:
    parts = tuple(map(_without_episodes, row.by_training))
    return msgspec.structs.replace(row, results={}, by_training=parts)


def _pooled(trainings: Sequence[tuple[Line, Row]]) -> Row:
    """Return the row over the rows of single trainings, which it has; the only one as it is.

    Of each training the same episodes count: as many as all that have begun have.
    """
    rows = tuple(row for _, row in trainings)
    if len(rows) == 1:
        return rows[0]
    begun = [(line.case, row.results) for line, row in trainings if row.results] or [
        (trainings[0][0].case, {})
    ]
    least = min(len(results) for _, results in begun)
    parts = [(case, dict(islice(results.items(), least))) for case, results in begun]
    together: dict[str, Any] = {
        name: tuple(one for row in rows for one in getattr(row, name))
        for name in ("failures", "recordings")
    }
    summed = {
        n: sum(getattr(row, n) for row in rows) for n in ("planned", "wall_s", "failing_starts")
    }
    one = {"training": None, "trainings": len(begun), "digest": "", "results": {}}
    more = {**one, **summed, **together, "by_training": rows}
    return msgspec.structs.replace(rows[0], **measures(parts), **more)


def _decide(
    line: Line, claim: Claim, store: EpisodeStore, may_begin: Callable[[], bool], how: Any
) -> None:
    """Simulate episodes in their order until they decide the claim, or none may begin."""

    def judge() -> JudgedClaim:
        return claim.judge(store.completed_prefix(line.case, line.indices).values())

    def undecided() -> bool:
        return judged.verdict == "undecided" and may_begin()

    judged = judge()
    while undecided():
        jobs = [Job(line.case, k) for k in line.indices[: judged.enough]]
        if all(map(store.find, jobs)):
            return
        for _, result in simulate_missing(jobs, store, may_begin=undecided, **how):
            if result.outcome in claim.against:
                judged = judge()
        judged = judge()


def _record(
    lines: Sequence[Line], store: EpisodeStore, count: int, threads: int, progress: Progress
) -> list[dict[int, Path]]:
    """Record the first failures and successes of each row, and return paths by index of the start.

    They are simulated again.
    """
    recorded: list[dict[int, Path]] = []
    jobs: dict[Path, Job] = {}
    for line in lines:
        case, results = line.case, line.results(store)
        succeeded = [k for k, result in results.items() if result.outcome == Outcome.SUCCESS]
        failed = [k for k, result in results.items() if result.outcome != Outcome.SUCCESS]
        place = f"{store.folder / 'recordings' / case.policy.config.scenario.name}-{case.digest}"
        paths = {
            k: Path(f"{place}-{k:06d}-{results[k].outcome}.rrd")
            for k in (*failed[:count], *succeeded[:count])
        }
        jobs |= {path: Job(case, k, path) for k, path in paths.items() if not path.exists()}
        recorded.append(paths)
    for number, (job, result) in enumerate(run_jobs(list(jobs.values()), threads), 1):
        first = store.results(job.case)[job.index]
        factor = first.realtime_factor
        if msgspec.structs.replace(result, recording=None, realtime_factor=factor) != first:
            raise UserError(
                f"{job.recording}: the same episode ended otherwise when it was simulated again. "
                "Either the policy draws at random or remembers other episodes: let it depend on "
                f"the observation alone. Or {store.path} was made by another machine or library: "
                "remove it"
            )
        progress("recordings", number, len(jobs), f"{number}/{len(jobs)}")
    return recorded

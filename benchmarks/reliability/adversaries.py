"""Policies that want robots to collide, against the shield: how close they bring them.

On a board of 16 x 16 cells with an obstacle, robots begin next to each other, anywhere. In half of
the blocks robots drive on at the end of their moves, and are asked only every 2 s: they leave the
lines that they had planned. Blocks are kept as they are done: the same command resumes.
"""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, get_args

import msgspec
import numpy as np

from agent.evaluation.cases import RECORDS, CaseIdentity
from agent.study.store import Header, RowFile
from cosim.base.command import workers
from cosim.base.errors import UserError
from cosim.base.progress import progress_bars, under_way
from cosim.base.provenance import digest_of
from cosim.base.reached_code import code_digest
from cosim.coupling.rl_step import Step, SupportsAct
from cosim.model.config import CoSimConfig
from cosim.model.outcome import Outcome
from cosim.model.scenario import Scenario
from cosim.onboard.features import DIRECTION_COUNT
from cosim.simulation.episode import RunningEpisode
from cosim.simulation.options import SimulationOptions, resolve
from cosim.simulation.result import EpisodeResult
from cosim.simulation.tasks import Task, simulate_tasks
from minirobots.options import CommandOptions, Count, File, Folder, Jobs
from tests.references import colliding
from tests.references.colliding import REACH, Greedy, Learnt, Random, arena, near_starts

Adversary = Literal["short", "random", "greedy", "learnt"]
# s of their episodes
KINDS: dict[Adversary, float] = {"short": 2.0, "random": 3.0, "greedy": 4.0, "learnt": 4.0}
BLOCK = 250  # episodes of a kind
LESSONS, LESSON_S = 1000, 8.0  # episodes that the learnt begins with, without the shield


@dataclass(frozen=True, kw_only=True)
class Options(CommandOptions):
    """Let policies that want robots to collide loose on the shield, and on robots without it.

    What has been simulated is kept in --out: the same command resumes.
    """

    episodes: Count = 2000
    """Episodes with the shield, of four kinds of adversaries in turn, 250 each."""
    unshielded: Count = 1000
    """Episodes without it."""
    kinds: tuple[Adversary, ...] = get_args(Adversary)
    """Adversaries to let loose, all by default; the episodes of others are left out."""
    robots: Literal[2, 3] = 2
    """Robots on the board."""
    world: File | None = None
    """World of the episodes (.toml with a table [world]), by default the paper's."""
    jobs: Jobs = -1
    out: Folder = Path("runs/adversaries")
    """Folder of results."""


class Block(msgspec.Struct, frozen=True):
    """Episodes of a kind; `least_gap_mm` is the smallest of all, between robots."""

    number: int
    kind: Adversary
    episodes: int
    contacts: int
    off_board: int
    least_gap_mm: float
    stops: int


POLICIES = {"short": Greedy, "random": Random, "greedy": Greedy}


def _episodes(
    scenario: Scenario,
    config: CoSimConfig,
    fmu: Path,
    policy: SupportsAct,
    seeds: Sequence[np.random.SeedSequence],
    watch: Callable[[Step, RunningEpisode, float], None],
) -> list[EpisodeResult]:
    """Episodes one batch after the other, so that a learner learns in one order."""
    tasks = [
        Task(scenario, fmu, config, policy, starts, seed, watch=watch)
        for seed in seeds
        for starts in [near_starts(scenario, np.random.default_rng(seed))]
    ]
    return [result for _, result in simulate_tasks(tasks, 1)]


def lessons(
    scenario: Scenario, config: CoSimConfig, fmu: Path, episodes: int = LESSONS
) -> np.ndarray:
    """The table that `Learnt` begins with, of robots that drive anywhere without the shield."""
    timing = config.timing._replace(episode_limit_s=LESSON_S)
    root = np.random.SeedSequence(0)
    random = Random(np.random.default_rng(root))
    learner = Learnt(random.rng, np.zeros((2 * REACH + 1, 2 * REACH + 1, DIRECTION_COUNT)))
    unshielded, seeds = replace(config, shield=None, timing=timing), root.spawn(episodes)
    _episodes(scenario, unshielded, fmu, random, seeds, lambda step, *_: learner.learn(step))
    return learner.q


def simulate(
    number: int,
    kind: Adversary,
    episodes: int,
    scenario: Scenario,
    config: CoSimConfig,
    fmu: Path,
    table: np.ndarray,
) -> Block:
    """A block; it is determined by its number and the rest, whatever else runs."""
    root = np.random.SeedSequence(number)
    rng = np.random.default_rng(root)
    learnt = Learnt(rng, table.copy()) if kind == "learnt" else None
    stops = 0

    def watch(step: Step, episode: RunningEpisode, _: float) -> None:
        nonlocal stops
        if learnt:
            learnt.learn(step)
        if step.outcome:
            stops += episode.shield_stops

    policy = learnt or POLICIES[kind](rng)
    results = _episodes(scenario, config, fmu, policy, root.spawn(episodes), watch)
    outcomes = [result.outcome for result in results]
    gaps = [10.0 * (r.min_distance_cm or 0.0) - 1e3 * scenario.robot_diameter_m for r in results]
    return Block(
        number,
        kind,
        episodes,
        outcomes.count(Outcome.COLLISION),
        outcomes.count(Outcome.OUT_OF_BOARD),
        min(gaps),
        stops,
    )


def _file(scenario: Scenario, config: CoSimConfig, fmu: Path, folder: Path) -> RowFile[Block]:
    """The file of the blocks."""
    identity = CaseIdentity(
        scenario=scenario.name,
        scenario_digest=scenario.digest(),
        policy_digest=digest_of(KINDS, BLOCK, LESSONS),
        seed=0,
        motor_fmu_digest=digest_of(fmu),
        parameters={name: row["value"] for name, row in config.table().items()},
        code_digest=code_digest(__name__, colliding, but=RECORDS),
    )
    header = Header(**msgspec.structs.asdict(identity), digest=digest_of(identity))
    return RowFile(folder / f"{scenario.name}-{header.digest}.jsonl", header, Block)


def attack(
    episodes: int,
    kinds: Sequence[Adversary],
    robots: int,
    shield: bool,
    world: Path | None,
    jobs: int,
    out: Path,
) -> list[Block]:
    """Blocks of some of the kinds, of this number of episodes of all; those of the file exist."""
    jobs = workers(jobs)
    scenario, config, fmu = resolve(SimulationOptions(shield=shield, world=world), arena(robots))
    file = _file(scenario, config, fmu, out)
    known = {block.number: block for block in file.rows}

    def size(number: int) -> int:
        return min(BLOCK, episodes - number * BLOCK)

    def kind_of(number: int) -> Adversary:
        return tuple(KINDS)[number % len(KINDS)]

    numbers = [n for n in range(-(-episodes // BLOCK)) if kind_of(n) in kinds]

    def block(number: int) -> Block:
        kind = kind_of(number)
        through = number // len(KINDS) % 2 == 1
        timing = config.timing._replace(episode_limit_s=KINDS[kind])
        mine = replace(config, timing=timing, through=through)
        return simulate(number, kind, size(number), scenario, mine, fmu, table)

    if not numbers:
        raise UserError(
            f"so few episodes have no block of {' or '.join(kinds) or 'any kind'}; ask for "
            f"{len(KINDS) * BLOCK} or more, and for a kind"
        )
    missing = [n for n in numbers if n not in known or known[n].episodes != size(n)]
    table = np.empty(0)
    with progress_bars() as progress, ThreadPoolExecutor(jobs) as pool:
        if any(kind_of(number) == "learnt" for number in missing):
            with under_way(progress, "learning to collide"):
                table = lessons(scenario, config, fmu)
        for done, row in enumerate(pool.map(block, missing), len(numbers) - len(missing) + 1):
            file.append(row)
            known[row.number] = row
            so_far = [known[n] for n in numbers if n in known and known[n].episodes == size(n)]
            contacts = sum(b.contacts + b.off_board for b in so_far)
            said_so = f"{sum(b.episodes for b in so_far)} episodes, {contacts} contacts"
            progress("attacking", done, len(numbers), said_so)
    return [known[n] for n in numbers]


def measure(
    episodes: int,
    unshielded: int,
    kinds: Sequence[Adversary],
    robots: int,
    world: Path | None,
    jobs: int,
    out: Path,
) -> dict[str, Any]:
    """Return what the adversaries achieve against the shield and, in fewer episodes, without it."""
    rows = []
    for shield, count in ((False, unshielded), (True, episodes)):
        blocks = attack(count, kinds, robots, shield, world, jobs, out)
        for kind in KINDS:
            mine = [block for block in blocks if block.kind == kind]
            if mine:
                row = {"shield": shield, "kind": kind}
                for name in ("episodes", "contacts", "off_board", "stops"):
                    row[name] = sum(getattr(block, name) for block in mine)
                rows.append(row | {"least_gap_mm": min(block.least_gap_mm for block in mine)})
    return {"robots": robots, "world": str(world or "ideal"), "rows": rows}

"""Policies that want robots to collide, against the shield: how close they bring them.

On a board of 16 x 16 cells with an obstacle, robots begin next to each other, anywhere. In half of
the blocks robots drive on at the end of their moves, and are asked only every 2 s: they leave the
lines that they had planned. Blocks are kept as they are done: the same command resumes.
"""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
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
from cosim.model.outcome import Outcome
from cosim.onboard.features import DIRECTION_COUNT
from cosim.simulation.episode import RunningEpisode
from cosim.simulation.options import Setup, SimulationOptions, resolve
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


class Options(CommandOptions):
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
    setup: Setup,
    policy: SupportsAct,
    seeds: Sequence[np.random.SeedSequence],
    watch: Callable[[Step, RunningEpisode, float], None],
) -> list[EpisodeResult]:
    """Episodes one batch after the other, so that a learner learns in one order."""
    tasks = [
        Task(setup.scenario, setup.fmu, setup.config, policy, starts, seed, watch=watch)
        for seed in seeds
        for starts in [near_starts(setup.scenario, np.random.default_rng(seed))]
    ]
    return [result for _, result in simulate_tasks(tasks, 1)]


def lessons(setup: Setup, episodes: int = LESSONS) -> np.ndarray:
    """The table that `Learnt` begins with, of robots that drive anywhere without the shield."""
    timing = setup.config.timing._replace(episode_limit_s=LESSON_S)
    unshielded = setup._replace(config=replace(setup.config, shield=None, timing=timing))
    root = np.random.SeedSequence(0)
    random = Random(np.random.default_rng(root))
    learner = Learnt(random.rng, np.zeros((2 * REACH + 1, 2 * REACH + 1, DIRECTION_COUNT)))
    _episodes(unshielded, random, root.spawn(episodes), lambda step, *_: learner.learn(step))
    return learner.q


def simulate(number: int, kind: Adversary, episodes: int, setup: Setup, table: np.ndarray) -> Block:
    """A block; it is determined by its number and the rest, not by other blocks."""
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
    results = _episodes(setup, policy, root.spawn(episodes), watch)
    outcomes = [result.outcome for result in results]
    diameter_mm = 1e3 * setup.scenario.robot_diameter_m
    gaps = [10.0 * (result.min_distance_cm or 0.0) - diameter_mm for result in results]
    return Block(
        number,
        kind,
        episodes,
        outcomes.count(Outcome.COLLISION),
        outcomes.count(Outcome.OUT_OF_BOARD),
        min(gaps),
        stops,
    )


def _file(setup: Setup, folder: Path) -> RowFile[Block]:
    """The file of the blocks."""
    scenario = setup.scenario
    identity = CaseIdentity(
        scenario=scenario.name,
        scenario_digest=scenario.digest(),
        policy_digest=digest_of(KINDS, BLOCK, LESSONS),
        seed=0,
        motor_fmu_digest=digest_of(setup.fmu),
        parameters={name: row["value"] for name, row in setup.config.table().items()},
        code_digest=code_digest(__name__, colliding, but=RECORDS),
    )
    header = Header(**msgspec.structs.asdict(identity), digest=digest_of(identity))
    return RowFile(folder / f"{scenario.name}-{header.digest}.jsonl", header, Block)


def attack(options: Options, shield: bool, episodes: int) -> list[Block]:
    """Blocks of the kinds asked for, of this number of episodes of all; those of the file exist."""
    physics = SimulationOptions(shield=shield, world=options.world)
    setup, kinds = resolve(physics, arena(options.robots)), tuple(KINDS)
    file = _file(setup, options.out)
    known = {block.number: block for block in file.rows}
    table = np.empty(0)

    def kind_of(number: int) -> Adversary:
        return kinds[number % len(kinds)]

    sizes = {
        number: min(BLOCK, episodes - first)
        for number, first in enumerate(range(0, episodes, BLOCK))
        if kind_of(number) in options.kinds
    }

    def done() -> list[Block]:
        return [known[n] for n, size in sizes.items() if n in known and known[n].episodes == size]

    def block(number: int) -> Block:
        kind = kind_of(number)
        through = number // len(kinds) % 2 == 1
        timing = setup.config.timing._replace(episode_limit_s=KINDS[kind])
        mine = setup._replace(config=replace(setup.config, timing=timing, through=through))
        return simulate(number, kind, sizes[number], mine, table)

    if not sizes:
        raise UserError(
            f"so few episodes have no block of {' or '.join(options.kinds) or 'any kind'}; ask for "
            f"{len(kinds) * BLOCK} or more, and for a kind"
        )
    missing = sizes.keys() - {each.number for each in done()}
    with progress_bars() as progress, ThreadPoolExecutor(workers(options.jobs)) as pool:
        if any(kind_of(number) == "learnt" for number in missing):
            with under_way(progress, "learning to collide"):
                table = lessons(setup)
        for row in pool.map(block, sorted(missing)):
            file.append(row)
            known[row.number] = row
            contacts = sum(b.contacts + b.off_board for b in done())
            said = f"{sum(b.episodes for b in done())} episodes, {contacts} contacts"
            progress("attacking", len(done()), len(sizes), said)
    return done()


def measure(options: Options) -> dict[str, Any]:
    rows = []
    for shield, count in ((False, options.unshielded), (True, options.episodes)):
        blocks = attack(options, shield, count)
        for kind in KINDS:
            mine = [block for block in blocks if block.kind == kind]
            if mine:
                row = {"shield": shield, "kind": kind}
                for name in ("episodes", "contacts", "off_board", "stops"):
                    row[name] = sum(getattr(block, name) for block in mine)
                rows.append(row | {"least_gap_mm": min(block.least_gap_mm for block in mine)})
    return {"robots": options.robots, "world": str(options.world or "ideal"), "rows": rows}

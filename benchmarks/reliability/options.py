"""Options of the benchmarks of this folder."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal, get_args

import tyro

from benchmarks.options import Benchmark
from cosim.base.command import Jobs, require_at_least, require_falling
from cosim.base.errors import UserError

Part = Literal["paper", "motor", "physics", "learning", "steering", "shield"]
Adversary = Literal["short", "random", "greedy", "learnt"]


@dataclass(frozen=True, kw_only=True)
class Adversaries(Benchmark):
    """Let policies that want robots to collide loose on the shield, and on robots without it.

    What has been simulated is kept in --out: the same command resumes.
    """

    episodes: int = 2000
    """Episodes with the shield, of four kinds of adversaries in turn, 250 each."""
    unshielded: int = 1000
    """Episodes without it."""
    kinds: tuple[Adversary, ...] = get_args(Adversary)
    """Adversaries to let loose, all by default; the episodes of others are left out."""
    robots: Literal[2, 3] = 2
    """Robots on the board."""
    world: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    """World of the episodes (.toml with a table [world]), by default the paper's."""
    jobs: Jobs = -1
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")] = Path("runs/adversaries")
    """Folder of results."""


@dataclass(frozen=True, kw_only=True)
class Coverage(Benchmark):
    """Simulate how often intervals of 95 % hold the mean or the rate that they are for."""

    samples: int = 2000
    """Samples of every distribution and number of runs."""
    runs: tuple[int, ...] = (2, 5, 20, 100)
    """Runs in a sample."""
    seed: int = 0

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.samples < 1 or not self.runs or min(self.runs) < 2:
            raise UserError("--samples must be at least 1, and --runs name numbers from 2 on")


@dataclass(frozen=True, kw_only=True)
class Endurance(Benchmark):
    """Simulate hours of two robots, without and with a recording: memory, cost and what drifts."""

    hours: Annotated[float, tyro.conf.arg(metavar="H")] = 1.0
    """Simulated time of each of the two runs, in hours; at least two minutes."""
    seed: int = 0
    """Of the episodes."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 2 / 60 <= self.hours < 1e4:
            raise UserError("--hours must be 0.034 (two minutes) to 10000")
        require_at_least(0, seed=self.seed)


@dataclass(frozen=True, kw_only=True)
class Falsification(Benchmark):
    """Count the episodes that searches need to find the first collision of a policy.

    By a surrogate, by evolution and at random, in the same ranges and with the same seeds. Episodes
    are kept in --out: the same command resumes.
    """

    scenario: str = "4"
    """Scenario of two robots or more."""
    method: str = "shortest"
    """By which the policy is made, see `python -m cosim.run --help`; one that collides rarely."""
    shield: bool = False
    """Whether robots have the shield (docs/shield.md)."""
    ranges: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    """Ranges to search, as of `minirobots falsify`."""
    seeds: int = 3
    """Searches of each kind."""
    episodes: int = 200
    """Episodes of a search that finds nothing."""
    jobs: Jobs = -1
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")] = Path("runs/falsification")
    """Folder of results and recordings."""


@dataclass(frozen=True, kw_only=True)
class Mutations(Benchmark):
    """Write faults into a copy of the code, one at a time, and count those that no test notices.

    Their list is benchmarks/reliability/mutations.toml. Run it in a checkout with the group test.
    """

    parts: tuple[Part, ...] = get_args(Part)
    """Parts of the project whose faults are tried, all by default."""


@dataclass(frozen=True, kw_only=True)
class Splitting(Benchmark):
    """Hold how often robots come close and collide, by splitting, against plain episodes.

    Of the paper's policy, without the shield. What has been simulated is kept in --out: the same
    command resumes.
    """

    scenario: str = "4"
    """Scenario of two robots or more."""
    episodes: int = 100
    """Plain episodes."""
    roots: int = 40
    """Independent episodes that are split."""
    branches: int = 4
    """Branches that an episode has after a level."""
    gaps: tuple[float, ...] = (10.0, 3.0)
    """Levels: gaps between the robots in mm."""
    seed: int = 0
    """Of the plain episodes; the roots have the next one."""
    jobs: Jobs = -1
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")] = Path("runs/splitting")
    """Folder of results."""

    def __post_init__(self) -> None:
        super().__post_init__()
        require_at_least(0, seed=self.seed)
        require_falling(gaps=self.gaps)

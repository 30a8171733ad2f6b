"""Options of studies: arguments of `minirobots.study` and `evaluate`, and of the command lines."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro
from msgspec import Meta

from agent.training.settings import COMPARED, MethodName
from cosim.base.arguments import ConfigError
from cosim.base.command import BudgetMinutes, Checked, Count, Folder, Seed
from cosim.base.jobs import THREADS, Where
from cosim.model.scenario_file import PAPER, find_scenario


@dataclass(frozen=True, kw_only=True)
class Work(Checked):
    """What a study draws from, for how long it runs, and where."""

    seed: Seed = 0
    budget_minutes: BudgetMinutes = None
    where: Where = THREADS


@dataclass(frozen=True, kw_only=True)
class Sampling(Work):
    """Which episodes are simulated, where, and where they are kept."""

    claim: str | None = None
    """Claim to certify or refuse, such as 'collision < 1e-2': RATE < p or RATE > p with the rate of
    collision, out_of_board, timeout, failure or success. A row ends with the episode that decides
    it."""
    confidence: Annotated[Annotated[float, Meta(gt=0, lt=1)] | None, tyro.conf.arg(metavar="P")] = (
        None
    )
    """Least probability that the verdict is right, by default 0.999."""
    trainings: Count = 1
    """Trainings of each method that learns, with the seeds seed, seed + 1, ...; all are driven from
    the same starts with the same noise."""
    out: Folder | None = None
    """Folder of results and tables, from which the same study resumes; by default nothing is
    kept."""


@dataclass(frozen=True, kw_only=True)
class TransferOptions(Work):
    """How methods are compared in the dynamics."""

    quick: bool = False
    """Short trial: two episodes in every row, instead of 50, 200 or all starts."""
    methods: tuple[MethodName, ...] = COMPARED
    """Methods to measure; see `minirobots run --help`."""
    out: Folder = Path("runs/transfer")
    """Folder of the table (transfer.json, transfer.md), policies and results."""
    scenarios: tuple[str, ...] = tuple(PAPER)
    """Scenarios to measure, built in or files (.toml)."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.scenarios or not self.methods:
            raise ConfigError("--scenarios and --methods need at least one each")
        names = [find_scenario(name, ideal=True).name for name in self.scenarios]
        if len(set(names)) < len(names):
            raise ConfigError("--scenarios has two of one name; leave one out, or rename it")

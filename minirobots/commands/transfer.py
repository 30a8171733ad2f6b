"""Count the episodes of the full dynamics that succeed, by method of training."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from agent.training.settings import COMPARED, Method
from cosim.base.progress import Progress
from cosim.model.built_in import PAPER
from cosim.model.config import ConfigError
from cosim.model.scenario_file import find_scenario
from minirobots.options import BudgetMinutes, Distributed, Folder, Resumable, Seed


class Transfer(Distributed, Resumable):
    """Measure how policies trained by different methods succeed in the full co-simulation.

    Rows are scenarios 1a to 4, methods, friction coefficients, and the shield off and on; the most
    important ones come first. Every episode is kept when it ends: the same command resumes, and
    with --budget-minutes 0 it starts no episode and writes the table of existing results. Policies
    and calibrations that are missing are made first.
    """

    out: Folder = Path("runs/transfer")
    """Folder of the table (transfer.json, transfer.md), policies and results."""
    quick: bool = False
    """Short trial: two episodes in every row instead of all starts, 200 or 50."""
    budget_minutes: BudgetMinutes = None
    scenarios: tuple[str, ...] = tuple(PAPER)
    """Scenarios to measure, built in or files (.toml)."""
    methods: tuple[Method, ...] = COMPARED
    """Methods to measure; see `minirobots run --help`."""
    seed: Seed = 0

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.scenarios or not self.methods:
            raise ConfigError("--scenarios and --methods need at least one each")
        names = [find_scenario(name, ideal=True).name for name in self.scenarios]
        if len(set(names)) < len(names):
            raise ConfigError("--scenarios has two of one name; leave one out, or rename it")


def run(options: Transfer, progress: Progress) -> Iterator[Any]:
    """Simulate missing episodes, write the table and print it, with the goals."""
    from agent.study.published import show, transfer

    report = transfer(**options.arguments(), progress=progress)
    yield report
    show(report)
    print(f"table in {options.out}/: transfer.json, transfer.md")

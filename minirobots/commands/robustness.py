"""Measure how policies succeed in worlds that are not ideal."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from agent.study.published import AXES, Axis
from agent.training.settings import COMPARED, Method
from cosim.base.progress import Progress
from cosim.model.config import ConfigError, require_one_of
from cosim.model.scenario_file import ROUGH, find_scenario, read_world
from minirobots.options import BudgetMinutes, Count, Distributed, File, Folder, Resumable, Seed


class Robustness(Distributed, Resumable):
    """Measure how policies succeed in worlds that none of them was trained for.

    Worlds deviate from the ideal in one thing at a time (friction, patches, motors, camera, delay,
    noise, load, slope, bouncing feet), and in everything at once, then also with the shield. Every
    episode is kept when it ends: the same command resumes, and with --budget-minutes 0 it starts no
    episode and writes the table and the plot of existing results. Policies and calibrations that
    are missing are made first.
    """

    out: Folder = Path("runs/robustness")
    """Folder of the table (robustness.json, .md, .png), policies and results."""
    quick: bool = False
    """Short trial: two episodes in every row."""
    episodes: Count | None = None
    """Episodes of every row, 50 by default."""
    budget_minutes: BudgetMinutes = None
    scenario: str = "4"
    """Built-in scenario or a scenario file (.toml)."""
    world: File = ROUGH
    """World with all deviations (.toml with a table [world]), by default that of
    docs/robustness.md."""
    axes: tuple[Axis, ...] = AXES
    """Deviations from the ideal to measure, one at a time, and everything."""
    methods: tuple[Method, ...] = COMPARED
    """Methods to measure, from the defaults; see `minirobots run --help`."""
    seed: Seed = 0

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.quick and self.episodes is not None:
            raise ConfigError("--episodes contradicts --quick; leave out one of them")
        if not self.axes or not self.methods:
            raise ConfigError("--axes and --methods need at least one each")
        for method in self.methods:
            require_one_of("--methods", method, COMPARED)
        find_scenario(self.scenario, ideal=True)


def run(options: Robustness, progress: Progress) -> Iterator[Any]:
    """Simulate missing episodes, write the table and the plot, and print the table."""
    world = read_world(options.world)
    from agent.study.published import OF_WORLDS, robustness
    from cosim.base.table import show

    report = robustness(**options.arguments(world=world), progress=progress)
    yield report
    show(OF_WORLDS, report.rows, names=5)
    print(f"table in {options.out}/: robustness.json, robustness.md, robustness.png")

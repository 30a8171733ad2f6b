"""`python -m cosim.robustness`: how policies hold in worlds that are not ideal.

Makes the table of docs/robustness.md. The work is `agent.robustness`.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from agent.robustness.axes import AXES, Axis
from agent.training.settings import IN_WORLDS, Method
from cosim.base.command import Jobs, Json, parse, print_json, require_at_least, workers
from cosim.base.config import ConfigError, require_one_of
from cosim.base.errors import run_command
from cosim.base.progress import resumable_bars
from cosim.scenarios.file import ROUGH, find_scenario, read_world


@dataclass(frozen=True, kw_only=True)
class Robustness:
    """Measure how policies succeed in worlds that none of them was trained for.

    One thing at a time is not ideal (friction, patches, motors, camera, delay, noise, load, slope,
    bouncing feet), and everything at once, then also with the shield. Every episode is kept
    as it comes: the same command goes on where an earlier one ended, and writes the table and the
    plot of what is there at any time.
    """

    out: Annotated[Path, tyro.conf.arg(metavar="DIR")] = Path("runs/robustness")
    """Folder of the table (robustness.json, .md, .png), policies and results."""
    quick: bool = False
    """Two episodes in every row: to see that it works."""
    episodes: int | None = None
    """Episodes of every row, 50 by default."""
    budget_minutes: Annotated[float | None, tyro.conf.arg(metavar="M")] = None
    """Start no episode after so many minutes; rows then have as much of the beginning of their
    samples as is there."""
    scenario: str = "4"
    """Built-in scenario or a scenario file (.toml)."""
    world: Annotated[Path, tyro.conf.arg(metavar="FILE")] = ROUGH
    """World in which nothing is ideal (.toml with a table [world]), by default that of
    docs/robustness.md."""
    axes: tuple[Axis, ...] = AXES
    """What is not ideal in the worlds to measure, one thing at a time, and everything."""
    methods: tuple[Method, ...] = IN_WORLDS
    """Methods to measure, of those of the default; see `python -m cosim.run --help`."""
    seed: int = 0
    """Seed of training, of samples of starts and of what episodes draw."""
    jobs: Jobs = -1
    json: Json = False

    def __post_init__(self) -> None:
        workers(self.jobs)
        require_at_least(0, seed=self.seed, budget_minutes=self.budget_minutes)
        require_at_least(1, episodes=self.episodes)
        if self.quick and self.episodes is not None:
            raise ConfigError("--episodes contradicts --quick; leave out one of them")
        if not self.axes or not self.methods:
            raise ConfigError("--axes and --methods need at least one each")
        for method in self.methods:
            require_one_of("--methods", method, IN_WORLDS)
        find_scenario(self.scenario, ideal=True)


def main() -> None:
    """Command line; see `Robustness`."""
    options = parse(Robustness, "cosim.robustness")
    world = read_world(options.world)
    from agent.robustness.measurement import EPISODES, QUICK_EPISODES, robustness
    from agent.robustness.table import show

    with resumable_bars(options.out) as progress:
        report = robustness(
            options.out,
            world,
            scenario=options.scenario,
            axes=options.axes,
            methods=options.methods,
            episodes=QUICK_EPISODES if options.quick else options.episodes or EPISODES,
            seed=options.seed,
            budget_minutes=options.budget_minutes,
            jobs=workers(options.jobs),
            progress=progress,
        )
    show(report)
    print(f"table in {options.out}/: robustness.json, robustness.md, robustness.png")
    if options.json:
        print_json(report)


if __name__ == "__main__":
    run_command(main)

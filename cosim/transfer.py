"""`python -m cosim.transfer`: how many episodes of the full dynamics succeed, by method.

Makes the table of docs/transfer.md: scenarios, methods, friction coefficients, with and without
the shield. The work is `agent.evaluation.transfer`.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from agent.training.settings import COMPARED, Method
from cosim.base.command import Jobs, Json, parse, print_json, require_at_least, workers
from cosim.base.config import ConfigError
from cosim.base.errors import run_command
from cosim.base.progress import resumable_bars
from cosim.scenarios.built_in import PAPER
from cosim.scenarios.file import find_scenario


@dataclass(frozen=True, kw_only=True)
class Transfer:
    """Measure how policies trained by different methods succeed in the full co-simulation.

    Rows are scenarios 1a to 4, methods, friction coefficients, and the shield off and
    on; the most important ones come first. Every episode is kept as it comes: the same command
    goes on where an earlier one ended, and writes the table of what is there at any time.
    """

    out: Annotated[Path, tyro.conf.arg(metavar="DIR")] = Path("runs/transfer")
    """Folder of the table (transfer.json, transfer.md), policies and results."""
    quick: bool = False
    """Two episodes in every row instead of all starts, 200 or 50: to see that it works."""
    budget_minutes: Annotated[float | None, tyro.conf.arg(metavar="M")] = None
    """Start no episode after so many minutes; rows then have as much of the beginning of their
    samples as is there."""
    scenarios: tuple[str, ...] = tuple(PAPER)
    """Scenarios to measure, built in or files (.toml)."""
    methods: tuple[Method, ...] = COMPARED
    """Methods to measure; see `python -m cosim.run --help`."""
    seed: int = 0
    """Seed of training, of samples of starts and of the speed noise."""
    jobs: Jobs = -1
    json: Json = False

    def __post_init__(self) -> None:
        workers(self.jobs)
        require_at_least(0, seed=self.seed, budget_minutes=self.budget_minutes)
        if not self.scenarios or not self.methods:
            raise ConfigError("--scenarios and --methods need at least one each")
        names = [find_scenario(name, ideal=True).name for name in self.scenarios]
        if len(set(names)) < len(names):
            raise ConfigError("--scenarios has two of one name; leave one out, or rename it")


def main() -> None:
    """Command line; see `Transfer`."""
    options = parse(Transfer, "cosim.transfer")
    from agent.evaluation.transfer import transfer
    from agent.evaluation.transfer_table import show

    with resumable_bars(options.out) as progress:
        report = transfer(
            options.out,
            scenarios=options.scenarios,
            methods=options.methods,
            seed=options.seed,
            quick=options.quick,
            budget_minutes=options.budget_minutes,
            jobs=workers(options.jobs),
            progress=progress,
        )
    show(report)
    print(f"table in {options.out}/: transfer.json, transfer.md")
    if options.json:
        print_json(report)


if __name__ == "__main__":
    run_command(main)

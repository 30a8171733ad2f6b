"""`python -m analysis.reproduce`: every experiment of the paper, its figures and the report."""

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from cosim.base.command import Jobs, Json, parse, print_json, require_at_least, workers
from cosim.base.errors import run_command


@dataclass(frozen=True)
class Reproduce:
    """Run every experiment of the paper, draw every figure, and write the report.

    Results go to DIR/results, figures to DIR/figures, the page to DIR/report; open it with
    `python -m analysis.serve DIR/report`. The same command goes on after an interrupt: stages that
    the same code has finished are kept, a training that was interrupted continues from its
    checkpoints. How long each stage took is in DIR/results/timings.json.
    """

    out: Annotated[Path, tyro.conf.arg(metavar="DIR")] = Path("runs/reproduction")
    """Folder to write to."""
    quick: bool = False
    """A few minutes' worth: few runs, fewer training episodes, few co-simulated episodes."""
    seed: int = 0
    """Seed of everything random."""
    jobs: Jobs = -1
    json: Json = False

    def __post_init__(self) -> None:
        workers(self.jobs)
        require_at_least(0, seed=self.seed)


def main() -> None:
    """Command line; see `Reproduce`."""
    options = parse(Reproduce, "analysis.reproduce")
    from analysis.profiles import FULL, QUICK
    from analysis.stages import reproduce
    from cosim.base.progress import progress_bars

    def say(text: str) -> None:
        print(text, file=sys.stderr)

    try:
        with progress_bars() as progress:
            page = reproduce(
                options.out,
                QUICK if options.quick else FULL,
                seed=options.seed,
                jobs=workers(options.jobs),
                progress=progress,
                say=say,
            )
    except KeyboardInterrupt:
        say(f"what is finished is in {options.out}/; the same command goes on")
        raise
    print(f"results, figures and report in {options.out}/: {page}")
    print(f"open it with: python -m analysis.serve {page.parent}")
    if options.json:
        print_json({"page": str(page)})


if __name__ == "__main__":
    run_command(main)

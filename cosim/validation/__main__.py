"""`python -m cosim.validation`: ours beside published numbers of machines of this family.

Makes the tables of docs/validation.md.
"""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro

from cosim.base.command import (
    Jobs,
    Json,
    MotorFmuFile,
    parse,
    print_json,
    require_at_least,
    show_table,
    workers,
)
from cosim.base.errors import run_command
from cosim.base.progress import progress_bars
from cosim.base.storage import replacing, write_json
from cosim.fmi.isolation import Isolation


@dataclass(frozen=True, kw_only=True)
class Validate:
    """Hold the simulation against published machines, each with the preset that stands for it.

    Measures speeds at their motor speeds, steps per turn, turning, closed paths driven by the
    clock, V-shaped steps, and on which parameters the speeds depend. What is measured is kept in
    the cache: the same command goes on where an earlier one ended.
    """

    out: Annotated[Path, tyro.conf.arg(metavar="DIR")] = Path("runs/validation")
    """Folder of the tables: validation.json and validation.md."""
    quick: bool = False
    """Two phases and two robots instead of eight each: to see that it works."""
    seed: int = 0
    """Seed of noise and motor phases on paths."""
    jobs: Jobs = -1
    json: Json = False
    motor_fmu: MotorFmuFile = None
    isolation: Annotated[Isolation, tyro.conf.OmitArgPrefixes] = field(default_factory=Isolation)

    def __post_init__(self) -> None:
        workers(self.jobs)
        require_at_least(0, seed=self.seed)


def main() -> None:
    """Command line; see `Validate`."""
    options = parse(Validate, "cosim.validation")
    options.isolation.enter("cosim.validation", options.motor_fmu)
    from cosim.navigation.options import Physics
    from cosim.validation.measurement import QUICK, Effort, validate
    from cosim.validation.report import report_of
    from cosim.validation.tables import markdown, tables

    effort = QUICK if options.quick else Effort()
    options.out.mkdir(parents=True, exist_ok=True)
    with progress_bars() as progress:
        fmu = Physics(motor_fmu=options.motor_fmu).fmu(progress)
        found = validate(fmu, effort, options.seed, workers(options.jobs), progress)
    report = report_of(found, effort, options.seed)
    write_json(options.out / "validation.json", report)
    with replacing(options.out / "validation.md") as temporary:
        temporary.write_text(markdown(report), encoding="utf-8")
    for title, header, rows in tables(report):
        show_table(None, header, rows, title=title, names=3)
    print(f"results in {options.out}/: validation.json, validation.md")
    if options.json:
        print_json(report)


if __name__ == "__main__":
    run_command(main)

"""Simulated speeds and paths compared with published numbers of machines."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from cosim.base.command import MotorFmuFile
from cosim.base.progress import Progress
from minirobots.options import Distributed, Folder, IsolatedOptions, Resumable, Seed


class Validate(Distributed, IsolatedOptions, Resumable):
    """Compare the simulation with published machines, each with its preset.

    It compares speeds at their motor speeds, steps per turn, turning, closed paths driven by the
    clock, V-shaped steps, and the sensitivity of speeds to parameters. Measurements are kept in the
    cache: the same command resumes.
    """

    out: Folder = Path("runs/validation")
    """Folder of the tables: validation.json and validation.md."""
    quick: bool = False
    """Short trial: two phases and two robots instead of eight each."""
    seed: Seed = 0
    motor_fmu: MotorFmuFile = None

    def interrupted(self) -> str:
        """Return where the results are."""
        return "measurements so far are in the cache; the same command continues"


def run(options: Validate, progress: Progress) -> Iterator[Any]:
    """Measure missing results, and write and print the tables."""
    from cosim.base.table import show, write_report
    from cosim.machine.validation.report import tables, text_of
    from cosim.machine.validation.validate import FULL, QUICK, validate
    from cosim.simulation.options import Physics

    count = QUICK if options.quick else FULL
    fmu = Physics(motor_fmu=options.motor_fmu).fmu(progress)
    report = validate(fmu, count, options.seed, options.where, progress)
    write_report(options.out / "validation", report, text_of(report))
    yield report
    for title, columns, rows in tables(report):
        show(columns, rows, names=3, title=title)
    print(f"results in {options.out}/: validation.json, validation.md")

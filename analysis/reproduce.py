"""`python -m analysis.reproduce`: every experiment of the paper, its figures and the report.

Composes the project's own commands, stage after stage; each keeps its own progress and files, and
could be run alone. What is made in which order and lies where is
`analysis.reading.results`, how much is done `analysis.profiles`.
"""

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, cast

import tyro
from rich.console import Console

from agent.evaluation.transfer import Transfer, transfer
from agent.experiments.run import run_experiment
from agent.experiments.variants import Name
from analysis.figures.draw import Figures, draw_figures
from analysis.motor_test import MotorTest, record
from analysis.profiles import FULL, QUICK, Profile
from analysis.reading.results import RESULTS, Result
from analysis.report.page import Report, write_report
from analysis.timings import Timings
from cosim.base.errors import UserError, run_command
from cosim.base.progress import progress_bars
from cosim.base.scenario import BUILT_IN
from cosim.calibrate import Calibrate, calibrate
from cosim.platform import PlatformRun, write_platform
from cosim.run import Run, run


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
    jobs: int = os.cpu_count() or 1
    """Training runs and co-simulated episodes at once; the results do not depend on it."""

    def __post_init__(self) -> None:
        if self.jobs < 1:
            raise UserError("--jobs must be at least 1")
        if self.seed < 0:
            raise UserError("--seed must not be negative")


def reproduce(options: Reproduce, profile: Profile, console: Console) -> Path:
    """Run what is not finished, then draw the figures and write the report.

    Returns:
        The report's page.

    Raises:
        UserError: see its message; what was finished stays.
    """
    results = options.out / "results"
    timings = run_stages(options, profile, console)
    with timings.stage("figures"):
        drawn, lacking = draw_figures(Figures(results=results, out=options.out / "figures"))
    for name, reason in lacking.items():
        console.print(f"not drawn: {name}: {reason}", soft_wrap=True)
    console.print(f"{len(drawn)} figures: {timings.seconds('figures'):.1f} s")
    return write_report(Report(results, options.out / "report"))


def run_stages(options: Reproduce, profile: Profile, console: Console) -> Timings:
    """Run what is not finished; returns how long everything took.

    Raises:
        UserError: see its message; what was finished stays.
    """
    results = options.out / "results"
    timings = Timings(results, profile, options.seed)
    for number, result in enumerate(RESULTS.values(), start=1):
        label = f"{number}/{len(RESULTS)} {result.title}"
        if timings.finished(result.name) and result.exists(results):
            console.print(f"{label}: finished before")
            continue
        console.print(f"{label} …")
        with timings.stage(result.name):
            _make(result, result.location(results), profile, options, console)
        console.print(f"{label}: {timings.seconds(result.name):.1f} s")
    return timings


def _make(
    result: Result, out: Path, profile: Profile, options: Reproduce, console: Console
) -> None:
    """Do what the result's command does, as much of it as the profile says.

    Called again after an interrupt it goes on, or begins anew.
    """
    seed, jobs = options.seed, options.jobs
    match result.module:
        case "cosim.platform":
            write_platform(PlatformRun(out=out))
        case "analysis.motor_test":
            record(MotorTest(out=out))
        case "cosim.calibrate":
            calibrate(Calibrate(out=out, jobs=jobs), console)
        case "cosim.run":
            alone = BUILT_IN[result.of].robots == 1
            settings = Run(
                result.of,
                episodes=profile.single_episodes if alone else profile.pair_episodes,
                method=profile.drive_method,
                train_episodes=profile.drive_episodes,
                seed=seed,
                out=out,
                jobs=jobs,
                time_limit=profile.episode_limit_s,
            )
            run(settings, console)
        case "agent.experiments":
            with progress_bars(console) as progress:
                run_experiment(
                    cast(Name, result.of),
                    out,
                    runs=profile.runs,
                    seed=seed,
                    episodes=profile.train_episodes,
                    jobs=jobs,
                    progress=progress,
                )
        case "cosim.transfer":
            table = Transfer(
                out=out,
                quick=profile.transfer_quick,
                scenarios=profile.transfer_scenarios,
                methods=profile.transfer_methods,
                seed=seed,
                jobs=jobs,
            )
            transfer(table, console)


def main() -> None:
    """Command line; see `Reproduce`."""
    options = tyro.cli(
        Reproduce, prog="python -m analysis.reproduce", config=(tyro.conf.FlagCreatePairsOff,)
    )
    console = Console(stderr=True)
    try:
        page = reproduce(options, QUICK if options.quick else FULL, console)
    except KeyboardInterrupt:
        console.print(f"what is finished is in {options.out}/; the same command goes on")
        raise
    print(f"results, figures and report in {options.out}/: {page}")
    print(f"open it with: python -m analysis.serve {page.parent}")


if __name__ == "__main__":
    run_command(main)

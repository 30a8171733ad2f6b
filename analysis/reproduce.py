"""`python -m analysis.reproduce`: every experiment of the paper, its figures and the report.

Composes the project's own commands, stage after stage; each keeps its own progress and files, and
could be run alone. What lies where is `analysis.reading.results`, how much is done
`analysis.profiles`.
"""

import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import tyro
from rich.console import Console

from agent.evaluation.transfer import Transfer, transfer
from agent.experiments import EXPERIMENTS, Experiments, Name, run_experiment
from analysis.figures.draw import Figures, draw_figures
from analysis.motor_test import MotorTest, record
from analysis.profiles import FULL, QUICK, Profile
from analysis.reading.results import RESULTS
from analysis.report.page import Report, write_report
from analysis.timings import Timings
from cosim.base.errors import UserError, run_command
from cosim.base.scenario import BUILT_IN
from cosim.calibrate import Calibrate, calibrate
from cosim.platform import PlatformRun, write_platform
from cosim.run import Run, run

LEARNING: tuple[Name, ...] = ("fig08", "fig11", "fig10")


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


class Stage(NamedTuple):
    """A part of the reproduction.

    Attributes:
        name: of its result in `analysis.reading.results`.
        title: for people.
        run: makes the result; called again after an interrupt it goes on, or begins anew.
    """

    name: str
    title: str
    run: Callable[[], Any]


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
    todo = list(stages(results, profile, options, console))
    for number, stage in enumerate(todo, start=1):
        label = f"{number}/{len(todo)} {stage.title}"
        if timings.finished(stage.name) and RESULTS[stage.name].exists(results):
            console.print(f"{label}: finished before")
            continue
        console.print(f"{label} …")
        with timings.stage(stage.name):
            stage.run()
        console.print(f"{label}: {timings.seconds(stage.name):.1f} s")
    return timings


def stages(
    results: Path, profile: Profile, options: Reproduce, console: Console
) -> Iterator[Stage]:
    """All stages in their order: the quick ones first, so that a mistake shows early."""

    def at(name: str) -> Path:
        return RESULTS[name].location(results)

    yield Stage(
        "platform",
        "platform of one degree of freedom (Fig. 3)",
        partial(write_platform, PlatformRun(out=at("platform"))),
    )
    yield Stage(
        "motor_test",
        "motor in open and closed loop (Fig. 7)",
        partial(record, MotorTest(out=at("motor_test"))),
    )
    calibration = Calibrate(out=at("calibration"), jobs=options.jobs)
    title = "motor speeds calibrated to motion"
    yield Stage("calibration", title, partial(calibrate, calibration, console))
    for scenario, description in BUILT_IN.items():
        name = f"episodes_{scenario}"
        episodes = profile.single_episodes if description.robots == 1 else profile.pair_episodes
        settings = Run(
            scenario,
            episodes=episodes,
            method=profile.drive_method,
            train_episodes=profile.drive_episodes,
            seed=options.seed,
            out=at(name),
            jobs=options.jobs,
            time_limit=profile.episode_limit_s,
        )
        title = f"scenario {scenario} co-simulated (Fig. {9 if description.robots == 1 else 12})"
        yield Stage(name, title, partial(run, settings, console))
    for name in LEARNING:
        experiment = Experiments(
            name,
            runs=profile.runs,
            seed=options.seed,
            out=at(name),
            episodes=profile.train_episodes,
            jobs=options.jobs,
            resume=True,
        )
        title = f"training, {len(EXPERIMENTS[name])} variants (Fig. {int(name[3:])})"
        yield Stage(name, title, partial(run_experiment, experiment, console))
    table = Transfer(
        out=at("transfer"),
        quick=profile.transfer_quick,
        scenarios=profile.transfer_scenarios,
        methods=profile.transfer_methods,
        seed=options.seed,
        jobs=options.jobs,
    )
    yield Stage("transfer", "success in co-simulation", partial(transfer, table, console))


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

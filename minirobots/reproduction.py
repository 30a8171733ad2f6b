"""All that a reproduction does, stage after stage: every result, then the figures and the report.

Each stage runs the result's own command, keeps its own files, and could be run alone. What is made
in which order and lies where is `analysis.reading.results`, how much is done `analysis.profiles`.
"""

import itertools
from collections.abc import Callable
from pathlib import Path
from typing import Any

from agent.study.user import study
from analysis.figures.draw import draw_figures
from analysis.figures.style import figure_entries
from analysis.profiles import Profile
from analysis.reading.results import RESULTS, Result
from analysis.report.page import write_report
from analysis.timings import Timings
from cosim.base.progress import Progress, silent
from cosim.model.scenario_file import find_scenario
from minirobots.commands import class_of
from minirobots.runner import parse


def reproduce(
    out: Path,
    profile: Profile,
    *,
    seed: int,
    jobs: int,
    progress: Progress = silent,
    say: Callable[[str], None],
) -> Path:
    """Run all unfinished stages, then draw the figures and write the report; return its page.

    Called again after an interrupt, the commands continue or start again. `say` receives a line for
    every stage.
    """
    results = out / "results"
    timings = Timings(results, profile, seed)
    for number, result in enumerate(RESULTS.values(), start=1):
        label = f"{number}/{len(RESULTS)} {result.title}"
        if timings.finished(result.name) and result.exists(results):
            say(f"{label}: finished before")
            continue
        say(f"{label} …")
        with timings.stage(result.name):
            if result.maker == "study":
                of = compared(profile, seed, jobs)
                study(**of, out=result.location(results), progress=progress)
            else:
                command_of(result, results, profile, seed, jobs).run(progress)
        say(f"{label}: {timings.seconds(result.name):.1f} s")
    with timings.stage("figures"):
        _draw(out, progress, say)
    say(f"figures: {timings.seconds('figures'):.1f} s")
    return write_report(results, out / "figures", out / "report")


def compared(profile: Profile, seed: int, jobs: int) -> dict[str, Any]:
    """Return the study of a profile's methods in its scenarios, without and with the shield."""
    return {
        "policies": list(profile.transfer_methods),
        "scenario": list(profile.transfer_scenarios),
        "trainings": profile.transfer_trainings,
        "episodes": profile.transfer_episodes,
        "shield": [False, True],
        "seed": seed,
        "jobs": jobs,
    }


def redraw(out: Path, progress: Progress, say: Callable[[str], None]) -> Path:
    """Draw the figures and write the report from existing results, and return its page."""
    _draw(out, progress, say)
    return write_report(out / "results", out / "figures", out / "report")


def _draw(out: Path, progress: Progress, say: Callable[[str], None]) -> None:
    _, lacking = draw_figures(figure_entries(), out / "results", out / "figures", progress=progress)
    for name, reason in lacking.items():
        say(f"not drawn: {name}: {reason}")


def command_of(result: Result, results: Path, profile: Profile, seed: int, jobs: int) -> Any:
    """Return the command that makes a result: its own, with the amounts of a profile."""
    amounts: dict[str, Any] = {"out": result.location(results)}
    match result.maker:
        case "calibrate":
            amounts |= {"jobs": jobs}
        case "run":
            alone = find_scenario(result.of).robots == 1
            amounts |= {
                "episodes": profile.single_episodes if alone else profile.pair_episodes,
                "train-episodes": profile.drive_episodes.get(result.method),
                "train-seed": seed,
                "seed": seed,
                "time-limit": profile.episode_limit_s,
                "jobs": jobs,
            }
        case "experiments":
            amounts |= {
                "runs": profile.runs,
                "episodes": profile.episodes_of(result.of),
                "greedy-points": profile.greedy_points,
                "seed": seed,
                "jobs": jobs,
                "backend": "loky",
            }
    given = {f"--{name}": str(value) for name, value in amounts.items() if value is not None}
    arguments = [*result.arguments, *itertools.chain(*given.items())]
    return parse(class_of(result.maker), f"minirobots {result.maker}", arguments).options

"""Search the worst episodes of a policy."""

from collections.abc import Iterator
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

from agent.falsification.search import SearchName, Sought
from cosim.base.arguments import ConfigError
from cosim.base.progress import Progress
from cosim.simulation.options import SimulationOptions
from minirobots.options import (
    Count,
    Distributed,
    File,
    Folder,
    NotNegative,
    Resumable,
    Seed,
    Simulating,
)

if TYPE_CHECKING:
    from agent.falsification.found import FoundCase

_CASE = ("episode", "starts", "seed", "outcome", "gap", "simulated")


class Falsify(Distributed, Simulating, Resumable):
    """Search the worst episodes of a policy in the full co-simulation, within declared ranges.

    The search covers starts, initial phases of the motors and seeds of the noise, and fields of the
    world that --ranges adds. Every episode is kept as it ends: the same command resumes. All
    failures and the worst episodes become regression cases (cases.json), which --replay runs again.
    """

    policy: File
    """Policy (policy.npz)."""
    out: Folder = Path("runs/falsify")
    """Folder of results, recordings, falsification.json and cases.json."""
    objective: Sought = "gap"
    """Goal of the search: the smallest gap between two robots, which is 0 where robots touch or one
    leaves the board; or the longest time."""
    ranges: File | None = None
    """Ranges to search (.toml with a table [ranges], see docs/falsification.md); other ranges keep
    their defaults: all starts, all phases, 1000 seeds, and the world as declared."""
    search: SearchName = "surrogate"
    """Choice of episodes: by starts for which a cheap model of observed moves predicts the worst;
    by evolution (CMA-ES); or uniformly at random as a baseline."""
    episodes: Count = 200
    """Episodes to simulate, those of earlier runs included."""
    until_found: bool = False
    """End with the generation of 8 episodes in which the first failure is found."""
    keep: NotNegative = 3
    """Worst episodes to record."""
    seed: Seed = 0
    replay: File | None = None
    """Instead of a search, simulate the cases of a cases.json with the policy again and print which
    still fail; the exit status is 1 if one fails."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.replay is not None:
            plain = Falsify(
                policy=self.policy, physics=SimulationOptions(motor_fmu=self.physics.motor_fmu)
            )
            may_be_given = {"replay", "where", "json", "isolation"}
            names = {option.name for option in fields(self)} - may_be_given
            if any(getattr(self, name) != getattr(plain, name) for name in names):
                raise ConfigError(
                    "--replay has the dynamics from its file and searches nothing; give only "
                    "--policy, --motor-fmu, --jobs and --json with it"
                )


def run(options: Falsify, progress: Progress) -> Iterator[Any]:
    """Search and print the worst episodes; or simulate and print the cases of a file again."""
    from cosim.base.table import show_texts

    if options.replay is not None:
        from agent.falsification.found import ReplayReport, read_cases, run_again
        from agent.policies import load_policy

        found, policy = read_cases(options.replay), load_policy(options.policy)
        if found.config.motor_fmu and options.physics.motor_fmu is None:
            raise ConfigError(
                f"{options.replay}: its cases were found with another motor FMU than the built-in "
                "one; name it by --motor-fmu"
            )
        fmu, threads = options.physics.fmu(progress), options.where.count
        now = run_again(found, policy, fmu, threads, progress)
        replayed = ReplayReport(then=found.cases, now=now)
        yield replayed
        rows = [
            [*_cells(was), *_ended(case), "fails" if case.fails else "holds"]
            for was, case in zip(found.cases, now, strict=True)
        ]
        show_texts((*_CASE, "now", "gap now", "simulated now", ""), rows)
        failed = sum(case.fails for case in found.cases)
        print(f"{replayed.failing} of {len(rows)} cases fail, {failed} did when they were found")
        return
    from agent.falsification.falsify import falsify
    from cosim.base.errors import in_shell

    arguments = options.arguments("replay", "where", progress=progress)
    report = falsify(**arguments, **vars(options.where), **vars(options.physics))
    yield report
    show_texts(_CASE, [_cells(case) for case in report.worst], title="worst episodes")
    ends = ", ".join(f"{count} {outcome}" for outcome, count in report.outcomes.items())
    after = "an episode without a gap" if report.objective == "gap" else "a time-out"
    first = "none found" if report.first is None else f"the first in episode {report.first - 1}"
    print(f"{report.episodes} episodes ({ends}), {report.found} of them {after}: {first}")
    recordings = [case.recording for case in report.worst if case.recording]
    if recordings:
        print(f"open with: {in_shell('rerun')} {recordings[0]}")
    print(f"results in {options.out}/: falsification.json, cases.json")


def _cells(case: "FoundCase") -> list[str]:
    starts = " ".join(f"({x}, {y})" for x, y in case.starts)
    return [str(case.number), starts, str(case.seed), *_ended(case)]


def _ended(case: "FoundCase") -> list[str]:
    from cosim.base.table import known

    return [case.outcome, known(case.gap_cm, "{:.3f} cm"), f"{case.sim_time_s:.0f} s"]


def failed(result: Any) -> bool:
    """Return whether a case that was replayed fails."""
    return getattr(result, "failing", 0) > 0

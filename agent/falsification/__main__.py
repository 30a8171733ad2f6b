"""`python -m agent.falsification`: the worst episodes of a policy, searched for and run again."""

import sys
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Literal

import tyro

from cosim.base.command import Jobs, Json, parse, print_json, require_at_least, workers
from cosim.base.errors import run_command
from cosim.base.progress import progress_bars, resumable_bars
from cosim.fmi.isolation import Isolation
from cosim.model.config import ConfigError
from cosim.simulation.options import SimulationOptions

FAILS_STATUS = 1


@dataclass(frozen=True, kw_only=True)
class Falsify:
    """Search the worst episodes of a policy in the full co-simulation, within declared ranges.

    Starts, initial phases of the motors and seeds of the noise are searched, and what --ranges
    adds of the world. Every episode is kept as it comes: the same command resumes where an earlier
    one ended. All failures and the worst episodes become regression cases (cases.json), which
    --replay runs again.
    """

    policy: Annotated[Path, tyro.conf.arg(metavar="FILE")]
    """Policy (policy.npz)."""
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")] = Path("runs/falsify")
    """Folder of results, recordings, falsification.json and cases.json."""
    objective: Literal["gap", "time"] = "gap"
    """What is searched: the smallest gap between two robots, which is none where robots touch or
    one leaves the board; or the longest time."""
    ranges: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    """Ranges to search (.toml with a table [ranges], see docs/falsification.md); what it does not
    name has its default: all starts, all phases, 1000 seeds, and the world as declared."""
    search: Literal["surrogate", "cma", "random"] = "surrogate"
    """How episodes are chosen: from the starts of which a cheap model of observed moves expects the
    worst; by evolution (CMA-ES); or uniformly at random as a baseline."""
    episodes: int = 200
    """Episodes to simulate, those of earlier runs included."""
    until_found: bool = False
    """End with the generation of 8 episodes in which the first failure is found."""
    keep: int = 3
    """Worst episodes to record."""
    seed: int = 0
    """Seed of the search."""
    replay: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    """Instead of a search, simulate the cases of a cases.json with the policy again and say which
    still fail; the exit status is 1 if one does."""
    jobs: Jobs = -1
    json: Json = False
    physics: Annotated[SimulationOptions, tyro.conf.OmitArgPrefixes] = field(
        default_factory=SimulationOptions
    )
    isolation: Annotated[Isolation, tyro.conf.OmitArgPrefixes] = field(default_factory=Isolation)

    def __post_init__(self) -> None:
        workers(self.jobs)
        require_at_least(1, episodes=self.episodes)
        require_at_least(0, keep=self.keep, seed=self.seed)
        if self.replay is not None:
            kept = ("policy", "replay", "jobs", "json", "isolation")
            said = {name: getattr(self, name) for name in kept}
            physics = SimulationOptions(motor_fmu=self.physics.motor_fmu)
            plain = replace(Falsify(policy=self.policy), **said | {"replay": None})
            if replace(self, replay=None) != replace(plain, physics=physics):
                raise ConfigError(
                    "--replay has the dynamics from its file and searches nothing; with it give "
                    "only --policy, --motor-fmu, --jobs and --json"
                )


def main() -> None:
    """Command line; see `Falsify`."""
    options = parse(Falsify, "agent.falsification")
    options.isolation.enter("agent.falsification", options.physics.motor_fmu)
    if options.replay is not None:
        _replay(options, options.replay)
        return
    from agent.falsification.measurement import falsify
    from agent.falsification.ranges import read_ranges
    from agent.falsification.table import show

    with resumable_bars(options.out) as progress:
        report = falsify(
            options.policy,
            options.physics,
            options.out,
            ranges={} if options.ranges is None else read_ranges(options.ranges),
            objective=options.objective,
            search=options.search,
            episodes=options.episodes,
            seed=options.seed,
            until_found=options.until_found,
            keep=options.keep,
            jobs=workers(options.jobs),
            progress=progress,
        )
    show(report)
    print(f"results in {options.out}/: falsification.json, cases.json")
    if options.json:
        print_json(report)


def _replay(options: Falsify, path: Path) -> None:
    from agent.falsification.found import ReplayReport, read_cases, run_again
    from agent.falsification.table import show_replay
    from agent.policies import load_policy

    found = read_cases(path)
    policy = load_policy(options.policy)
    with progress_bars() as progress:
        fmu = options.physics.fmu(progress)
        now = run_again(found, policy, fmu, workers(options.jobs), progress)
    report = ReplayReport(then=found.cases, now=now)
    show_replay(report)
    if options.json:
        print_json(report)
    if report.failing:
        sys.exit(FAILS_STATUS)


if __name__ == "__main__":
    run_command(main)

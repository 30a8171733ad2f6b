"""`python -m cosim.evaluate`: what policies achieve in the full dynamics, start by start.

The counterpart of `agent.evaluate`, which is exact on the grid; here motors, friction and noise
decide, and rates have intervals. The work is `agent.evaluation.dynamics`.
"""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro

from cosim.base.command import Jobs, Json, parse, print_json, require_at_least, workers
from cosim.base.config import ConfigError
from cosim.base.errors import run_command
from cosim.base.progress import resumable_bars
from cosim.fmi.isolation import Isolation
from cosim.navigation.options import Driving


@dataclass(frozen=True, kw_only=True)
class Evaluate:
    """Evaluate policies in the full co-simulation: motors, friction, noise, decisions every 2 s.

    Every start, or a sample drawn with the seed, gives one episode; rates have 95 % Wilson
    intervals, paths are compared with the policy's own on the grid. Results are kept as they come:
    the same command, or one that asks for more starts, goes on where an earlier one ended.
    Recorded are failures and a few successes, to be opened in the Rerun viewer.
    """

    policies: Annotated[tuple[Path, ...], tyro.conf.Positional]
    """Policies (policy.npz) or folders of runs made by agent.train."""
    starts: str | None = None
    """How many starts to sample without replacement, or 'all' of them (1a 30, 1b 116, pairs
    900, those that start on one side 600); by default 50, or all where there are fewer."""
    seed: int = 0
    """Seed of the sample and of the speed noise; every start has its own noise."""
    scenario: str | None = None
    """Refuse policies of any other scenario (a name, or a scenario file)."""
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")] = Path("runs/evaluate")
    """Folder of results and recordings; results of other configurations are kept apart in it."""
    recordings: int = 3
    """Episodes of each policy to record: at most so many failures and so many successes."""
    jobs: Jobs = -1
    json: Json = False
    physics: Annotated[Driving, tyro.conf.OmitArgPrefixes] = field(default_factory=Driving)
    isolation: Annotated[Isolation, tyro.conf.OmitArgPrefixes] = field(default_factory=Isolation)

    def __post_init__(self) -> None:
        workers(self.jobs)
        number = self.starts is None or (self.starts.isdecimal() and int(self.starts) > 0)
        if not number and self.starts != "all":
            raise ConfigError(f"--starts {self.starts} is neither 'all' nor a positive number")
        require_at_least(0, seed=self.seed, recordings=self.recordings)


def main() -> None:
    """Command line; see `Evaluate`."""
    options = parse(Evaluate, "cosim.evaluate")
    options.isolation.enter("cosim.evaluate", options.physics.motor_fmu)
    from agent.evaluation.dynamics import evaluate, report_of
    from agent.evaluation.tables import show

    with resumable_bars(options.out, "results") as progress:
        evaluated = evaluate(
            options.policies,
            options.physics,
            options.out,
            starts=options.starts if options.starts in (None, "all") else int(options.starts),
            seed=options.seed,
            scenario=options.scenario,
            recordings=options.recordings,
            jobs=workers(options.jobs),
            progress=progress,
        )
    report = report_of(evaluated, options.seed)
    show(report)
    print(f"results in {options.out}/")
    recordings = [path for row in report.policies for path in row.recordings]
    if recordings:
        print(f"open with: uv run rerun {recordings[0]}")
    if options.json:
        print_json(report)


if __name__ == "__main__":
    run_command(main)

"""`python -m cosim.evaluate`: what policies achieve in the full dynamics, start by start.

The counterpart of `agent.evaluate`, which is exact on the grid; here motors, friction and noise
decide, and rates have intervals. The report is data first (`--json`) and tables second.
"""

import json
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import tyro
from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeRemainingColumn,
)

from agent.evaluation.cases import Case, Job, run_jobs
from agent.evaluation.grid import policy_files
from agent.evaluation.outcomes import failures, summary
from agent.evaluation.result_file import ResultFile
from agent.evaluation.rollout import EpisodeResult
from agent.evaluation.tables import show
from agent.training.policy import Policy
from cosim.base.config import ConfigError, CoSimConfig
from cosim.base.errors import UserError, run_command
from cosim.base.outcome import Outcome
from cosim.base.params import SAFETY_MARGIN_HELP, SPEED_NOISE, TABLE_I, TIMING
from cosim.base.scenario import find_scenario
from cosim.navigation.calibration_cache import calibrated
from fmus.build import cached_fmu

SCHEMA_VERSION = 1


@dataclass(frozen=True)
class Evaluate:
    """Evaluate policies in the full co-simulation: motors, friction, noise, decisions every 2 s.

    Every start, or a sample drawn with the seed, gives one episode; rates have 95 % Wilson
    intervals, paths are compared with the policy's own on the grid. Results are kept as they come:
    the same command, or one that asks for more starts, goes on where an earlier one ended.
    Recorded are failures and a few successes, to be opened in the Rerun viewer.
    """

    policies: Annotated[tuple[Path, ...], tyro.conf.Positional]
    """Policies (policy.npz) or folders of runs made by agent.train."""
    starts: str = "50"
    """How many starts to sample without replacement, or 'all' of them (1a 30, 1b 116, pairs
    900)."""
    seed: int = 0
    """Seed of the sample and of the speed noise; every start has its own noise."""
    jobs: int = 2
    """Episodes to co-simulate at the same time, in threads; the results do not depend on it."""
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")] = Path("runs/evaluate")
    """Folder of results and recordings; results of other configurations are kept apart in it."""
    scenario: str | None = None
    """Refuse policies of any other scenario (1a, 1b, 2, 3, 4 or a scenario file)."""
    mu: float = TABLE_I.mu
    """Coulomb friction coefficient of the feet (0.1 to 0.4 in the literature). Above some 0.2 the
    desired speed needs hopping and is refused."""
    noise: float = SPEED_NOISE.relative_amplitude
    """Half width of the uniform noise on measured motor speeds, relative to the drive speed."""
    safety_margin: Annotated[float, tyro.conf.arg(metavar="M", help=SAFETY_MARGIN_HELP)] = 0.0
    time_limit: Annotated[float, tyro.conf.arg(metavar="S")] = TIMING.episode_limit_s
    """Simulated time in s after which an episode ends as a time-out."""
    recordings: int = 3
    """Episodes of each policy to record: at most so many failures and so many successes."""
    json: bool = False
    """Print a JSON object as the last line of output."""

    def __post_init__(self) -> None:
        if self.starts != "all" and not (self.starts.isdecimal() and int(self.starts) > 0):
            raise ConfigError(f"--starts {self.starts} is neither 'all' nor a positive number")
        if self.jobs < 1:
            raise ConfigError("--jobs must be at least 1")
        for name in ("seed", "recordings"):
            if getattr(self, name) < 0:
                raise ConfigError(f"--{name} must not be negative")

    def count(self) -> int | None:
        """Number of starts, None for all."""
        return None if self.starts == "all" else int(self.starts)

    def config(self) -> CoSimConfig:
        """Parameters of the co-simulation.

        Raises:
            ConfigError: they do not fit together.
        """
        return CoSimConfig(
            robot=TABLE_I._replace(mu=self.mu),
            noise=SPEED_NOISE._replace(relative_amplitude=self.noise),
            timing=TIMING._replace(episode_limit_s=self.time_limit),
            safety_margin_m=self.safety_margin,
        )


class Evaluated:
    """A named policy with the episodes asked for and those that are there."""

    def __init__(self, name: str, file: ResultFile, options: Evaluate) -> None:
        self.name = name
        self.case = file.case
        self.indices = file.case.sample(options.count())
        self.file = file
        self.recordings: dict[int, Path] = {}
        self._folder = options.out / "recordings"
        self._recorded = options.recordings

    def missing(self) -> list[Job]:
        """Episodes not yet simulated, in the order of the sample."""
        return [Job(self.case, k) for k in self.indices if k not in self.file.results]

    def results(self) -> dict[int, EpisodeResult]:
        """Results so far of the episodes asked for, in the order of the sample."""
        found = {k: self.file.results.get(k) for k in self.indices}
        return {
            k: replace(r, recording=str(self.recordings[k]) if k in self.recordings else None)
            for k, r in found.items()
            if r is not None
        }

    def unrecorded(self) -> list[Job]:
        """Episodes to record: the first failures and successes of the sample, simulated again."""
        failed: list[int] = []
        succeeded: list[int] = []
        for index, result in self.results().items():
            (succeeded if result.outcome == Outcome.SUCCESS else failed).append(index)
        jobs: list[Job] = []
        for index in failed[: self._recorded] + succeeded[: self._recorded]:
            outcome = self.file.results[index].outcome
            path = self._folder / f"{self.file.path.stem}-{index:06d}-{outcome}.rrd"
            self.recordings[index] = path
            if not path.exists():
                jobs.append(Job(self.case, index, path))
        return jobs


def evaluate(options: Evaluate, console: Console) -> list[Evaluated]:
    """Simulate what is missing, and record what is to be recorded.

    Args:
        options: the command line.
        console: for progress; nothing is drawn if it is no terminal.

    Raises:
        UserError: see its message.
    """
    scenario = None if options.scenario is None else find_scenario(options.scenario)
    policies = [(path, Policy.load(path, scenario)) for path in policy_files(options.policies)]
    with console.status("preparing the motor FMU (some seconds the first time)"):
        fmu = cached_fmu()
    configs = {
        diameter_m: calibrated(options.config().sized(diameter_m), fmu, console)
        for diameter_m in {policy.config.scenario.robot_diameter_m for _, policy in policies}
    }
    with console.status("preparing the kernels (some seconds the first time)"):
        files: dict[str, ResultFile] = {}
        evaluated: list[Evaluated] = []
        for path, policy in policies:
            config = configs[policy.config.scenario.robot_diameter_m]
            case = Case(policy, config, fmu, options.seed)
            file = files.setdefault(case.digest, ResultFile(options.out, case))
            evaluated.append(Evaluated(str(path), file, options))
        evaluated[0].case.system().compile()
    missing = list({job.key: job for e in evaluated for job in e.missing()}.values())
    for job, result in tracked(run_jobs(missing, options.jobs), len(missing), console):
        files[job.case.digest].add(job.index, result)
    unrecorded = list({job.key: job for e in evaluated for job in e.unrecorded()}.values())
    for job, result in tracked(
        run_jobs(unrecorded, options.jobs), len(unrecorded), console, "recordings"
    ):
        first = files[job.case.digest].results[job.index]
        again = replace(result, recording=None, realtime_factor=first.realtime_factor)
        if again != first:
            raise UserError(
                f"{job.recording}: the same episode ended otherwise when it was simulated again; "
                f"{files[job.case.digest].path} was made by another machine or library: remove it"
            )
    return evaluated


def tracked(
    episodes: Iterator[tuple[Job, EpisodeResult]],
    total: int,
    console: Console,
    what: str = "episodes",
) -> Iterator[tuple[Job, EpisodeResult]]:
    """Pass episodes on while a bar shows how many there are, their success and the time left."""
    columns = (
        TextColumn("[progress.description]{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[state]}"),
        TimeRemainingColumn(),
    )
    successes = count = 0
    with Progress(*columns, console=console, disable=not console.is_terminal) as bar:
        task = bar.add_task(what, total=total, state="")
        for job, result in episodes:
            yield job, result
            count += 1
            successes += result.outcome == Outcome.SUCCESS
            bar.update(task, advance=1, state=f"success {successes / count:.1%}")


def report_of(evaluated: list[Evaluated], options: Evaluate) -> dict[str, Any]:
    """The object that `--json` prints."""
    rows: list[dict[str, Any]] = []
    for e in evaluated:
        results = e.results()
        failed = failures(results)
        rows.append(
            {
                "policy": e.name,
                "scenario": e.case.policy.config.scenario.name,
                "digest": e.case.digest,
                "starts": len(e.case.starts),
                **summary(e.case, results),
                "wall_s": sum(r.wall_s for r in results.values()),
                "failing_starts": len(failed),
                "failures": failed,
                "recordings": [str(path) for path in e.recordings.values()],
                "results": str(e.file.path),
            }
        )
    return {
        "schema_version": SCHEMA_VERSION,
        "seed": options.seed,
        "mu": options.mu,
        "safety_margin_m": options.safety_margin,
        "policies": rows,
    }


def main() -> None:
    """Command line; see `Evaluate`."""
    options = tyro.cli(
        Evaluate, prog="python -m cosim.evaluate", config=(tyro.conf.FlagCreatePairsOff,)
    )
    stderr, stdout = Console(stderr=True), Console()
    try:
        evaluated = evaluate(options, stderr)
    except KeyboardInterrupt:
        stderr.print(
            f"results so far are in {options.out}/; the same command goes on", soft_wrap=True
        )
        raise
    report = report_of(evaluated, options)
    show(report, stdout)
    stdout.print(f"results in {options.out}/", soft_wrap=True)
    recordings = [path for row in report["policies"] for path in row["recordings"]]
    if recordings:
        stdout.print(f"open with: uv run rerun {recordings[0]}", soft_wrap=True)
    if options.json:
        print(json.dumps(report))


if __name__ == "__main__":
    run_command(main)

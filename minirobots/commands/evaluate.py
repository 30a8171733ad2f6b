"""Evaluate policies in the full dynamics, or on the grid, with intervals."""

from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from cosim.base.errors import in_shell
from cosim.base.progress import Progress
from cosim.model.config import ConfigError
from minirobots.options import Distributed, Folder, NotNegative, Resumable, Seed, Simulating

if TYPE_CHECKING:
    from agent.study.report import Report


class Evaluate(Distributed, Simulating, Resumable):
    """Evaluate policies in the full co-simulation: motors, friction, noise, decisions every 2 s.

    Every start, or a sample drawn with the seed, gives one episode; rates have 95 % Wilson
    intervals, paths are compared with the policy's own on the grid. Every result is kept when the
    episode ends: the same command, or one that asks for more starts, resumes. Failures and a few
    successes are recorded for the Rerun viewer.

    With --grid every policy is evaluated on the grid instead, by the greedy episode from every
    combination of start cells. Up to 10 000 combinations nothing is sampled: scenarios 1a, 1b and 2
    to 4 have 30, 116 and 900. Where there are more, 10 000 are drawn, and success has a 95 %
    interval. Path length and moves are means over robots and successful starts; their ratio to the
    exact optimum (minirobots bound) shows how far a policy is from the best possible one.
    """

    policies: Annotated[tuple[str, ...], tyro.conf.Positional] = ()
    """Policies (policy.npz), folders of runs made by `minirobots train`, names of methods, or
    MODULE:NAME of an object with act(observation) or of its class; methods and objects need a
    --scenario."""
    policy: Annotated[tuple[str, ...], tyro.conf.UseAppendAction] = ()
    """A policy as above; repeat it for several."""
    grid: bool = False
    """Evaluate on the grid, exactly; takes files and folders of runs, and no option but --json."""
    starts: str | None = None
    """Number of starts to sample without replacement, or 'all' (1a 30, 1b 116, pairs 900, those
    that start on one side 600); by default 50, or all where there are fewer. With --claim the
    maximum number of episodes, by default all starts; more than that begin again with the first
    start, each time with other noise."""
    claim: str | None = None
    """Claim to certify or refuse, such as 'collision < 1e-2': RATE < p or RATE > p with the rate of
    collision, out_of_board, timeout, failure or success. The evaluation ends with the episode that
    decides it; the exit status is 1 unless every policy is certified."""
    confidence: Annotated[float | None, tyro.conf.arg(metavar="P")] = None
    """Least probability that the verdict is right, by default 0.999."""
    seed: Seed = 0
    scenario: str | None = None
    """Scenario (a name, or a file) of methods and objects; files of any other one are refused."""
    out: Folder = Path("runs/evaluate")
    """Folder of results and recordings; results of other configurations are kept apart in it."""
    recordings: NotNegative = 3
    """Episodes of each policy to record: at most this number of failures and of successes."""

    def __post_init__(self) -> None:
        super().__post_init__()
        number = self.starts is None or (self.starts.isdecimal() and int(self.starts) > 0)
        if not number and self.starts != "all":
            raise ConfigError(f"--starts {self.starts} is neither 'all' nor a positive number")
        if self.grid:
            of_grid = {"policies", "policy", "grid", "json"}
            if without := [name for name in _changed(self, Evaluate()) if name not in of_grid]:
                named = ", ".join(f"--{name.replace('_', '-')}" for name in without)
                raise ConfigError(f"{named}: no effect with --grid; leave one of them out")

    def interrupted(self) -> str:
        """Return where the results are, of which the grid has none."""
        return "" if self.grid else super().interrupted()


def run(options: Evaluate, progress: Progress) -> Iterator[Any]:
    """Simulate missing episodes, record failures and successes, and print the results."""
    if options.grid:
        yield from _on_grid((*options.policies, *options.policy))
        return
    from agent.evaluation.claims import claim_of
    from agent.study.evaluate import evaluate, show

    arguments = options.arguments(
        *("policy", "grid", "confidence"),
        policies=(*options.policies, *options.policy),
        physics=options.physics,
        starts=options.starts if options.starts in (None, "all") else int(options.starts),
        claim=claim_of(options.claim, options.confidence),
    )
    report = evaluate(**arguments, progress=progress)
    yield report
    show(report)
    print(f"results in {options.out}/")
    recordings = [path for row in report.rows for path in row.recordings]
    if recordings:
        print(f"open with: {in_shell('rerun')} {recordings[0]}")


def _changed(given: Any, default: Any) -> Iterator[str]:
    """Names of options that are not the default, those of nested records too."""
    for option in fields(given):
        value, usual = getattr(given, option.name), getattr(default, option.name)
        if is_dataclass(value):
            yield from _changed(value, usual)
        elif value != usual:
            yield option.name


def _on_grid(policies: tuple[str, ...]) -> Iterator[Any]:
    from agent.policies import load_policy
    from agent.study.grid import policy_files, report_of, show

    paths = policy_files(tuple(map(Path, policies)))
    report = report_of((str(path), load_policy(path)) for path in paths)
    yield report
    show(report)


def failed(report: "Report") -> bool:
    """Return whether a claim is not certified."""
    return any(row.claim.verdict != "certified" for row in report.rows if row.claim is not None)

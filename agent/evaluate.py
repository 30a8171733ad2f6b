"""`python -m agent.evaluate`: rates, lengths and failing starts of trained policies."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from cosim.base.command import Json, parse, print_json
from cosim.base.errors import run_command


@dataclass(frozen=True, kw_only=True)
class EvaluateOnGrid:
    """Evaluate policies on the grid: the greedy episode from every combination of start cells.

    Nothing is sampled up to 10 000 combinations: scenarios 1a, 1b and 2 to 4 have 30, 116 and 900.
    Where there are more, 10 000 are drawn, and success has a 95 % interval. Path length and
    moves are means over robots and successful starts; their ratio to the exact optimum
    (python -m agent.process.bound) says how far a policy is from the best possible one.
    """

    policies: Annotated[tuple[Path, ...], tyro.conf.Positional]
    """Policies (policy.npz) or folders of runs made by agent.train."""
    json: Json = False


def main() -> None:
    """Command line; see `EvaluateOnGrid`."""
    options = parse(EvaluateOnGrid, "agent.evaluate")
    from agent.evaluation.grid import policy_files, report_of, show
    from agent.policies import load_policy

    paths = policy_files(options.policies)
    report = report_of((str(path), load_policy(path)) for path in paths)
    show(report)
    if options.json:
        print_json(report)


if __name__ == "__main__":
    run_command(main)

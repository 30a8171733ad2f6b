"""Evaluate policies on the grid, exactly: rates, lengths and failing starts."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import tyro

from cosim.base.progress import Progress
from minirobots.options import CommandOptions


class EvaluateOnGrid(CommandOptions):
    """Evaluate policies on the grid: the greedy episode from every combination of start cells.

    Nothing is sampled up to 10 000 combinations: scenarios 1a, 1b and 2 to 4 have 30, 116 and 900.
    Where there are more, 10 000 are drawn, and success has a 95 % interval. Path length and moves
    are means over robots and successful starts; their ratio to the exact optimum (minirobots bound)
    measures how far a policy is from the best possible one.
    """

    policies: tyro.conf.Positional[tuple[Path, ...]]
    """Policies (policy.npz) or folders of runs made by agent.train."""


def run(options: EvaluateOnGrid, _: Progress) -> Iterator[Any]:
    """Evaluate every policy and print a row for each."""
    from agent.evaluation.grid import policy_files, report_of, show
    from agent.policies import load_policy

    paths = policy_files(options.policies)
    report = report_of((str(path), load_policy(path)) for path in paths)
    yield report
    show(report)

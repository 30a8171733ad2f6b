"""Evaluate policies on the grid, exactly: rates, lengths and failing starts."""

from pathlib import Path
from typing import TYPE_CHECKING

import tyro

from cosim.base.progress import Progress
from minirobots.options import CommandOptions

if TYPE_CHECKING:
    from agent.evaluation.grid import GridReport


class EvaluateOnGrid(CommandOptions):
    """Evaluate policies on the grid: the greedy episode from every combination of start cells.

    Nothing is sampled up to 10 000 combinations: scenarios 1a, 1b and 2 to 4 have 30, 116 and 900.
    Where there are more, 10 000 are drawn, and success has a 95 % interval. Path length and
    moves are means over robots and successful starts; their ratio to the exact optimum
    (minirobots bound) says how far a policy is from the best possible one.
    """

    policies: tyro.conf.Positional[tuple[Path, ...]]
    """Policies (policy.npz) or folders of runs made by agent.train."""


def run(options: EvaluateOnGrid, _: Progress) -> "GridReport":
    """Evaluate every policy."""
    from agent.evaluation.grid import policy_files, report_of
    from agent.policies import load_policy

    paths = policy_files(options.policies)
    return report_of((str(path), load_policy(path)) for path in paths)


def show(_: EvaluateOnGrid, report: "GridReport") -> None:
    """Print a row for every policy."""
    from agent.evaluation.grid import show as show_report

    show_report(report)

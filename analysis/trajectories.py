"""Panels of figures 9 and 12: ways that trained policies take from some start cells."""

from typing import NamedTuple

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure

from agent.evaluation import all_starts, greedy_path
from agent.grid import OUTCOMES
from agent.policy import Policy
from analysis.board import draw_board, draw_paths
from analysis.style import WIDTH_IN


class Example(NamedTuple):
    """One greedy episode.

    Attributes:
        cells: (moves + 1, N, 2) int64.
        outcome: its name.
    """

    cells: np.ndarray
    outcome: str


def examples(policy: Policy, count: int, seed: int) -> list[Example]:
    """Greedy episodes from starts drawn with a seed, without repetition."""
    starts = all_starts(policy.process)
    chosen = np.random.default_rng(seed).choice(len(starts), min(count, len(starts)), replace=False)
    found = []
    for k in chosen:
        cells, outcome = greedy_path(policy.process, policy.values, starts[k])
        found.append(Example(cells, OUTCOMES[outcome]))
    return found


def draw_examples(boards: list[list[tuple[Policy, list[Example]]]]) -> Figure:
    """A grid of boards, each with the ways of the examples given for it."""
    rows, columns = len(boards), len(boards[0])
    width = WIDTH_IN / max(columns, 2)
    figure, grid = plt.subplots(
        rows, columns, figsize=(width * columns, (width + 0.3) * rows), squeeze=False
    )
    for row, axes_row in zip(boards, grid, strict=True):
        for axes, (policy, found) in zip(axes_row, row, strict=True):
            scenario = policy.config.scenario
            draw_board(axes, scenario)
            for example in found:
                draw_paths(axes, scenario, example.cells)
            reached = sum(example.outcome == "success" for example in found)
            ends = found[0].outcome if len(found) == 1 else f"{reached} of {len(found)} reached"
            axes.set_title(f"{scenario.name}: {ends}", loc="left")
        axes_row[0].set_ylabel("y in cm")
    for axes_row in grid[:-1]:
        for axes in axes_row:
            axes.set_xlabel("")
    return figure

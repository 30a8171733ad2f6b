"""Figures 9 and 12: ways of robots in the co-simulation, from recordings of episodes."""

from pathlib import Path
from typing import Any, NamedTuple

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from analysis.figures.board import draw_board, robot_colour
from analysis.figures.caption import Caption, Drawing
from analysis.figures.style import WIDTH_IN, FigureError
from analysis.inspect import path_length_m
from analysis.reading.results import FIGURES, RESULTS, recordings
from cosim.base.scenario import BUILT_IN, Scenario
from cosim.reading.episode import Episode, read_episode

SINGLE, PAIRS = ("1a", "1b"), ("2", "3", "4")


class Way(NamedTuple):
    """What a figure needs of a recorded episode.

    Attributes:
        positions_m: (n, 2) of each robot's centre.
        cells: (m, 2) of each robot at the RL steps.
        outcome: of the episode.
        path_length_m: of each robot.
        duration_s: simulated.
    """

    positions_m: tuple[np.ndarray, ...]
    cells: tuple[np.ndarray, ...]
    outcome: str
    path_length_m: tuple[float, ...]
    duration_s: float


def read_way(path: Path) -> Way:
    """The way of an episode's recording.

    Raises:
        RecordingReadError: it is no recording of an episode with positions and cells.
    """
    return way_of(read_episode(path))


def way_of(episode: Episode) -> Way:
    """The way of an episode.

    Raises:
        RecordingReadError: it has no positions or cells.
    """
    return Way(
        tuple(episode.signals[f"/sim/{robot}/position"].values[:, :2] for robot in episode.robots),
        tuple(episode.signals[f"/rl/{robot}/cell"].values for robot in episode.robots),
        episode.outcome or "unfinished",
        tuple(path_length_m(episode, robot) or 0.0 for robot in episode.robots),
        episode.time_s,
    )


def fig09(results: Path) -> Drawing:
    """Ways of one robot: all recorded episodes of a scenario on one board.

    Raises:
        FigureError: there are no recordings.
    """
    ways = _read(results, SINGLE)
    figure, grid = plt.subplots(1, len(SINGLE), figsize=(WIDTH_IN, 3.9), squeeze=False)
    for axes, (name, found) in zip(grid[0], ways.items(), strict=True):
        _draw_ways(axes, BUILT_IN[name], found)
        reached = sum(way.outcome == "success" for way in found)
        axes.set_title(f"scenario {name}: {reached} of {len(found)} reached", loc="left")
    grid[0, 0].set_ylabel("y in cm")
    claim = (
        "after learning, short (sub-optimal) paths lead to the target from any random start of a "
        "relatively large grid."
    )
    return Drawing(figure, _caption("fig09", "Ways of one robot", claim, ways))


def fig12(results: Path) -> Drawing:
    """Ways of pairs: an episode on each board, a scenario in each column.

    Raises:
        FigureError: there are no recordings.
    """
    ways = _read(results, PAIRS)
    return Drawing(
        _draw_boards(ways),
        _caption(
            "fig12",
            "Ways of pairs",
            "sub-optimal paths of both robots are found from random starts, while a collision "
            "between them is avoided.",
            ways,
        ),
    )


def _read(results: Path, scenarios: tuple[str, ...]) -> dict[str, list[Way]]:
    ways = {}
    for name in scenarios:
        paths = recordings(name, results)
        if not paths:
            command = RESULTS[f"episodes_{name}"].command(results)
            raise FigureError(f"scenario {name}: no recordings; run `{command}` first")
        ways[name] = [read_way(path) for path in paths]
    return ways


def _draw_boards(ways: dict[str, list[Way]]) -> Figure:
    rows, columns = max(map(len, ways.values())), len(ways)
    width = WIDTH_IN / columns
    size = (WIDTH_IN, (width + 0.35) * rows)
    figure, grid = plt.subplots(rows, columns, figsize=size, squeeze=False)
    for column, (name, found) in zip(grid.T, ways.items(), strict=True):
        for axes in column[len(found) :]:
            axes.set_axis_off()
        for axes, way in zip(column, found, strict=False):
            _draw_ways(axes, BUILT_IN[name], [way])
            axes.set_title(f"scenario {name}: {way.outcome.replace('_', ' ')}", loc="left")
        for axes in column[: len(found) - 1]:
            axes.set_xlabel("")
    for axes in grid[:, 0]:
        axes.set_ylabel("y in cm")
    return figure


def _draw_ways(axes: Axes, scenario: Scenario, ways: list[Way]) -> None:
    """Lines: centres of robots; dots: cells at the decisions; circles: rims at start and end."""
    draw_board(axes, scenario)
    cell_cm = 100.0 * scenario.cell_m
    radius_cm = 50.0 * scenario.robot_diameter_m
    for way in ways:
        for robot, (position, cells) in enumerate(zip(way.positions_m, way.cells, strict=True)):
            colour = robot_colour(robot)
            line = "-" if way.outcome == "success" else ":"
            axes.plot(*(100.0 * position.T), line, color=colour, linewidth=1.0)
            centres = (cells + 0.5) * cell_cm
            axes.plot(*centres.T, ".", color=colour, markersize=2.5, alpha=0.6)
            for place, alpha in ((position[0], 0.35), (position[-1], 0.8)):
                centre = (100.0 * place[0], 100.0 * place[1])
                axes.add_patch(Circle(centre, radius_cm, fill=False, color=colour, alpha=alpha))


def _caption(figure: str, title: str, claim: str, ways: dict[str, list[Way]]) -> Caption:
    numbers: dict[str, Any] = {}
    ours = []
    for name, found in ways.items():
        outcomes = [way.outcome for way in found]
        lengths = [100.0 * np.mean(way.path_length_m) for way in found if way.outcome == "success"]
        numbers[name] = {
            "outcomes": outcomes,
            "path_length_cm": [float(length) for length in lengths],
            "duration_s": [way.duration_s for way in found],
        }
        reached = outcomes.count("success")
        others = sorted({outcome.replace("_", " ") for outcome in outcomes} - {"success"})
        text = f"Scenario {name}: {reached} of {len(found)} co-simulated episodes end in success"
        if lengths:
            text += f", after {np.mean(lengths):.1f} cm a robot on average"
        ours.append(text + (f"; the others: {', '.join(others)}." if others else "."))
    return Caption(
        figure,
        f"{title} with motors, mass and friction; lines: centres (dotted where the episode "
        "failed), dots: cells at the decisions, circles: rims at the start (light) and the end",
        claim,
        tuple(ours),
        numbers,
        FIGURES[figure],
    )

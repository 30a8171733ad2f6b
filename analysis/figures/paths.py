"""Figures 9 and 12: paths of robots in the co-simulation, from recordings of episodes."""

from pathlib import Path
from typing import Any, NamedTuple

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from analysis.figures.fig05 import draw_board, robot_colour
from analysis.figures.style import WIDTH_IN, Caption, Drawing, FigureError
from analysis.reading.inspection import path_length_m
from analysis.reading.results import FIGURES, RESULTS, recordings
from cosim.reading.episode import read_episode
from cosim.scenarios.built_in import PAPER
from cosim.scenarios.scenario import Scenario

SINGLE, PAIRS = ("1a", "1b"), ("2", "3", "4")


class Track(NamedTuple):
    """What a figure needs of a recorded episode.

    Attributes:
        positions_m: (n, 2) of each robot's centre.
        cells: (m, 2) of each robot at the RL steps.
        outcome: of the episode.
        path_length_m: of each robot.
        time_s: simulated.
    """

    positions_m: tuple[np.ndarray, ...]
    cells: tuple[np.ndarray, ...]
    outcome: str
    path_length_m: tuple[float, ...]
    time_s: float


def read_track(path: Path) -> Track:
    """The track of an episode's recording.

    Raises:
        RecordingReadError: it is no recording of an episode with positions and cells.
    """
    episode = read_episode(path)
    return Track(
        tuple(episode.signals[f"{robot}/position"].values[:, :2] for robot in episode.robots),
        tuple(episode.signals[f"{robot}/cell"].values for robot in episode.robots),
        episode.outcome or "unfinished",
        tuple(path_length_m(episode, robot) or 0.0 for robot in episode.robots),
        episode.time_s,
    )


def fig09(results: Path) -> Drawing:
    """Paths of one robot: all recorded episodes of a scenario on one board.

    Raises:
        FigureError: there are no recordings.
    """
    tracks = _read(results, SINGLE)
    figure, grid = plt.subplots(1, len(SINGLE), figsize=(WIDTH_IN, 3.9), squeeze=False)
    for axes, (name, found) in zip(grid[0], tracks.items(), strict=True):
        _draw_tracks(axes, PAPER[name], found)
        reached = sum(track.outcome == "success" for track in found)
        axes.set_title(f"scenario {name}: {reached} of {len(found)} reached", loc="left")
    grid[0, 0].set_ylabel("y in cm")
    claim = (
        "after learning, short (sub-optimal) paths lead to the target from any random start of a "
        "relatively large grid."
    )
    return Drawing(figure, _caption("fig09", "Paths of one robot", claim, tracks))


def fig12(results: Path) -> Drawing:
    """Paths of pairs: an episode on each board, a scenario in each column.

    Raises:
        FigureError: there are no recordings.
    """
    tracks = _read(results, PAIRS)
    return Drawing(
        _draw_boards(tracks),
        _caption(
            "fig12",
            "Paths of pairs",
            "sub-optimal paths of both robots are found from random starts, while a collision "
            "between them is avoided.",
            tracks,
        ),
    )


def recorded(scenario: str, results: Path) -> list[Path]:
    """Recordings of a scenario's episodes, in their order.

    Raises:
        FigureError: there are none.
    """
    paths = recordings(scenario, results)
    if not paths:
        command = RESULTS[f"episodes_{scenario}"].command(results)
        raise FigureError(f"scenario {scenario}: no recordings; run `{command}` first")
    return paths


def _read(results: Path, scenarios: tuple[str, ...]) -> dict[str, list[Track]]:
    return {name: [read_track(path) for path in recorded(name, results)] for name in scenarios}


def _draw_boards(tracks: dict[str, list[Track]]) -> Figure:
    rows, columns = max(map(len, tracks.values())), len(tracks)
    width = WIDTH_IN / columns
    size = (WIDTH_IN, (width + 0.35) * rows)
    figure, grid = plt.subplots(rows, columns, figsize=size, squeeze=False)
    for column, (name, found) in zip(grid.T, tracks.items(), strict=True):
        for axes in column[len(found) :]:
            axes.set_axis_off()
        for axes, track in zip(column, found, strict=False):
            _draw_tracks(axes, PAPER[name], [track])
            axes.set_title(f"scenario {name}: {track.outcome.replace('_', ' ')}", loc="left")
        for axes in column[: len(found) - 1]:
            axes.set_xlabel("")
    for axes in grid[:, 0]:
        axes.set_ylabel("y in cm")
    return figure


def _draw_tracks(axes: Axes, scenario: Scenario, tracks: list[Track]) -> None:
    """Lines: centres of robots; dots: cells at the decisions; circles: rims at start and end."""
    draw_board(axes, scenario)
    cell_cm = 100.0 * scenario.cell_m
    radius_cm = 50.0 * scenario.robot_diameter_m
    for track in tracks:
        for robot, (position, cells) in enumerate(zip(track.positions_m, track.cells, strict=True)):
            colour = robot_colour(robot)
            line = "-" if track.outcome == "success" else ":"
            axes.plot(*(100.0 * position.T), line, color=colour, linewidth=1.0)
            centres = (cells + 0.5) * cell_cm
            axes.plot(*centres.T, ".", color=colour, markersize=2.5, alpha=0.6)
            for place, alpha in ((position[0], 0.35), (position[-1], 0.8)):
                centre = (100.0 * place[0], 100.0 * place[1])
                axes.add_patch(Circle(centre, radius_cm, fill=False, color=colour, alpha=alpha))


def _caption(figure: str, title: str, claim: str, tracks: dict[str, list[Track]]) -> Caption:
    numbers: dict[str, Any] = {}
    ours = []
    for name, found in tracks.items():
        outcomes = [track.outcome for track in found]
        succeeded = [track for track in found if track.outcome == "success"]
        lengths = [100.0 * np.mean(track.path_length_m) for track in succeeded]
        numbers[name] = {
            "outcomes": outcomes,
            "path_length_cm": [float(length) for length in lengths],
            "time_s": [track.time_s for track in found],
        }
        others = sorted({outcome.replace("_", " ") for outcome in outcomes} - {"success"})
        share = f"{len(succeeded)} of {len(found)}"
        text = f"Scenario {name}: {share} co-simulated episodes end in success"
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

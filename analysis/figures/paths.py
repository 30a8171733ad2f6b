"""Figures 9 and 12: paths of robots in the co-simulation, from recordings of episodes."""

from pathlib import Path
from typing import Any, NamedTuple

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle

from agent.evaluation.rows import Row
from agent.evaluation.statistics import interval_text
from agent.study.report import Report
from analysis.figures.fig05 import draw_board
from analysis.figures.style import UNTESTED, WIDTH_IN, Drawing, figure, verdict, verdicts
from analysis.reading.inspection import path_length_m
from analysis.reading.results import DRIVEN_BY, RESULTS, episodes_of, read_result, recordings
from cosim.base.colours import BLACK, GREY, robot_colour
from cosim.model.scenario import Scenario
from cosim.model.scenario_file import find_scenario
from cosim.recording.reader import read_episode

SINGLE, PAIRS = ("1a", "1b"), ("2", "3", "4")
MARK_S = 10.0  # simulated time between two marks on a path
STYLES: dict[str, str] = dict(zip(DRIVEN_BY, (":", "-"), strict=True))  # of distances over time


def _needed(scenarios: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(episodes_of(name, method) for method in DRIVEN_BY for name in scenarios)


class Track(NamedTuple):
    """Signals of a recorded episode that a figure needs."""

    times_s: np.ndarray  # (n,)
    positions_m: tuple[np.ndarray, ...]  # (n, 2) of each robot's centre
    outcome: str
    path_length_m: tuple[float, ...]  # of each robot
    time_s: float  # simulated


Tracks = dict[tuple[str, str], list[Track]]  # of a scenario and a method


def read_track(path: Path) -> Track:
    """The track of an episode's recording."""
    episode = read_episode(path)
    positions = [episode.signals[f"{robot}/position"] for robot in episode.robots]
    return Track(
        positions[0].time_s,
        tuple(position.values[:, :2] for position in positions),
        episode.outcome or "unfinished",
        tuple(path_length_m(episode, robot) or 0.0 for robot in episode.robots),
        episode.time_s,
    )


@figure(
    "fig09",
    "Paths of one robot, {style}",
    claim=(
        "after learning, short (sub-optimal) paths lead to the target from any random start of a "
        "relatively large grid."
    ),
    claims=("Fig. 9: paths of one robot",),
    inputs=_needed(SINGLE),
)
def fig09(results: Path) -> Drawing:
    """Draw paths of one robot: all episodes of a scenario on one board, a method in each row."""
    tracks = _read(results, SINGLE)
    figure, grid = plt.subplots(
        len(DRIVEN_BY), len(SINGLE), figsize=(WIDTH_IN, 7.6), sharex=True, squeeze=False
    )
    for axes, ((name, method), found) in zip(grid.flat, tracks.items(), strict=True):
        draw_tracks(axes, find_scenario(name), found)
        reached = sum(track.outcome == "success" for track in found)
        axes.set_title(f"{name}, {method}: {reached} of {len(found)} reached", loc="left")
        axes.set_xlabel("x in cm" if axes in grid[-1] else "")
    for axes in grid[:, 0]:
        axes.set_ylabel("y in cm")
    return _drawing(figure, tracks, _judged(SINGLE, results))


@figure(
    "fig12",
    "Paths of pairs in the first episode, and the distance of their centres in all (dotted: "
    "paper, solid: moves; line at 5 cm: contact), {style}",
    claim=(
        "sub-optimal paths of both robots are found from random starts, while a collision between "
        "them is avoided."
    ),
    claims=("Fig. 12: paths of pairs without collisions",),
    inputs=_needed(PAIRS),
)
def fig12(results: Path) -> Drawing:
    """Draw paths of pairs, a method in each row, and below them the distance of their centres."""
    tracks = _read(results, PAIRS)
    return _drawing(draw_pairs(tracks), tracks, _judged(PAIRS, results))


def _read(results: Path, scenarios: tuple[str, ...]) -> Tracks:
    return {
        (name, method): [
            read_track(path) for path in recordings(episodes_of(name, method), results)
        ]
        for method in DRIVEN_BY
        for name in scenarios
    }


def draw_pairs(tracks: Tracks) -> Figure:
    """Paths of the first episodes, a method in each row, and distances over time below."""
    figure, grid = plt.subplots(
        len(DRIVEN_BY) + 1, len(PAIRS), figsize=(WIDTH_IN, 7.2), squeeze=False,
        height_ratios=[*(3 for _ in DRIVEN_BY), 2],
    )  # fmt: skip
    for axes, ((name, method), found) in zip(grid.flat, tracks.items(), strict=False):
        draw_tracks(axes, find_scenario(name), found[:1])
        axes.set_title(f"{name}, {method}: {found[0].outcome.replace('_', ' ')}", loc="left")
        axes.set_xlabel("")
        distance = grid[-1, PAIRS.index(name)]
        for track in found:
            first, second = track.positions_m
            apart_cm = 100.0 * np.linalg.norm(first - second, axis=1)
            own: Any = {"label": method if track is found[0] else None, "linewidth": 0.8}
            distance.plot(track.times_s, apart_cm, STYLES[method], color=BLACK, **own)
    for name, axes in zip(PAIRS, grid[-1], strict=True):
        contact_cm = 100.0 * find_scenario(name).diameter_m
        axes.axhline(contact_cm, color=GREY, linestyle="--", linewidth=0.8, label="contact")
        axes.set(xlabel="time in s", ylim=(0.0, None))
    grid[-1, 0].legend(loc="upper right", fontsize=7)
    for axes in grid[:-1, 0]:
        axes.set_ylabel("y in cm")
        axes.legend(handles=_keys(2), loc="lower left", fontsize=7)
    grid[-1, 0].set_ylabel("distance in cm")
    return figure


def _keys(robots: int) -> list[Line2D]:
    """Return keys of what `draw_tracks` draws of some robots that arrive."""
    rim: Any = {"linestyle": "", "marker": "o", "fillstyle": "none", "color": BLACK}
    return [
        *(Line2D([], [], color=robot_colour(k), label=f"robot {k + 1}") for k in range(robots)),
        Line2D([], [], marker=".", linestyle="", color=BLACK, label=f"every {MARK_S:g} s"),
        Line2D([], [], **rim, alpha=0.35, label="start"),
        Line2D([], [], **rim, alpha=0.8, label="end"),
    ]


def draw_tracks(axes: Axes, scenario: Scenario, tracks: list[Track]) -> None:
    """Draw centres of robots as lines, marks of time as dots, rims at start and end as circles."""
    draw_board(axes, scenario)
    radius_cm = 50.0 * scenario.diameter_m
    for track in tracks:
        marks = np.searchsorted(track.times_s, np.arange(MARK_S, track.time_s, MARK_S))
        for robot, position in enumerate(track.positions_m):
            colour = robot_colour(robot)
            line = "-" if track.outcome == "success" else ":"
            axes.plot(*(100.0 * position.T), line, color=colour, linewidth=1.0)
            marked = position[np.minimum(marks, len(position) - 1)]
            axes.plot(*(100.0 * marked.T), ".", color=colour, markersize=4)
            for place, alpha in ((position[0], 0.35), (position[-1], 0.8)):
                centre = (100.0 * place[0], 100.0 * place[1])
                axes.add_patch(Circle(centre, radius_cm, fill=False, color=colour, alpha=alpha))


def _judged(scenarios: tuple[str, ...], results: Path) -> tuple[str, str]:
    """Return what the paper's method achieves in the study of methods, and a verdict.

    The recorded episodes, which are drawn, are few.
    """
    rows: tuple[Row, ...] = ()
    if RESULTS["transfer"].exists(results):
        rows = read_result("transfer", results, Report).rows
    parts, holds = [], {}
    for row in rows:
        if row.policy == "paper" and row.scenario in scenarios and not row.shield and row.episodes:
            reached = row.episodes - row.failing_starts
            _, ends = interval_text(row.interval("success"), 1, 100.0).split(" ", 1)
            parts.append(f"{row.scenario} in {reached} of {row.episodes} {ends}")
            holds[f"in {row.scenario}"] = reached == row.episodes
    if not parts:
        return "not evaluated: see `minirobots study docs/studies/methods.toml`", UNTESTED
    return (
        f"driven in the dynamics, without a shield: {', '.join(parts)} episodes",
        verdict(all(holds.values())) if len({*holds.values()}) == 1 else verdicts(holds),
    )


def _drawing(figure: Figure, tracks: Tracks, judged: tuple[str, str]) -> Drawing:
    numbers: dict[str, Any] = {}
    ours = []
    for (name, method), found in tracks.items():
        outcomes = [track.outcome for track in found]
        succeeded = [track for track in found if track.outcome == "success"]
        lengths = [100.0 * float(np.mean(track.path_length_m)) for track in succeeded]
        numbers[f"{name} {method}"] = {
            "outcomes": outcomes,
            "path_length_cm": lengths,
            "time_s": [track.time_s for track in found],
        }
        others = sorted({outcome.replace("_", " ") for outcome in outcomes} - {"success"})
        share = f"{len(succeeded)} of {len(found)}"
        text = f"Scenario {name}, method {method}: {share} co-simulated episodes end in success"
        if lengths:
            text += f", after {np.mean(lengths):.1f} cm a robot on average"
        ours.append(text + (f"; the others: {', '.join(others)}." if others else "."))
    style = (
        "with motors, mass and friction, of policies by the paper's method and by moves, with the "
        "same starts and noise; lines: centres (dotted where the episode failed), dots: every "
        f"{MARK_S:g} s, circles: rims at the start (light) and the end"
    )
    return Drawing(figure, tuple(ours), numbers, (judged,), {"style": style})

"""A video's frames: numbers of robots, and the outcome when it has happened."""

import contextlib
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from analysis import video
from cosim.model.scenario_file import find_scenario
from cosim.recording.reader import Signal


class Frames:
    """Takes a video's frames in place of a file."""

    @contextlib.contextmanager
    def saving(self, figure, path, dpi):
        """Begin."""
        self.axes, self.titles, self.texts, self.noses = figure.axes[0], [], [], []
        self.trails: list[np.ndarray] = []
        yield

    def grab_frame(self):
        """Take what the figure has."""
        self.titles.append(self.axes.get_title("left").split(maxsplit=2))
        self.texts.append([(t.get_text(), *t.get_position()) for t in self.axes.texts])
        self.trails.append(self.axes.lines[1].get_xydata())
        self.noses.append(np.diff(self.axes.lines[0].get_xydata(), axis=0)[0])


def driven(scenario: str, time_s: float) -> Any:
    """Return an episode on a high board: robots stand on their first starts and turn past π."""
    board = find_scenario(scenario)
    board = replace(board, rows=board.rows + 4)
    robots = [f"r{number + 1}" for number in range(board.robots)]
    times, signals = np.array([0.0, time_s]), {}
    for robot, starts in zip(robots, board.starts, strict=True):
        at = board.cell_m * (np.array(starts[0]) + 0.5)
        signals[f"{robot}/position"] = Signal(times, np.tile(at, (2, 1)), ("x", "y"), "m")
        signals[f"{robot}/heading"] = Signal(times, np.array([3.0, -3.0]), ("",), "rad")
    return SimpleNamespace(
        scenario=board, robots=robots, signals=signals, time_s=time_s, outcome="timeout",
        origin="", parameter=lambda _: 0.05,
    )  # fmt: skip


@pytest.mark.parametrize(("speed", "count"), [(1000.0, 2), (12.0, 5), (16.0, 4), (0.5, 97)])
def test_the_last_frame_alone_is_the_end_and_says_how(monkeypatch, tmp_path, speed, count):
    frames = Frames()
    monkeypatch.setattr(video, "_writer", lambda _: frames)
    assert video.write_video(driven("1a", 4.0), tmp_path / "a.gif", speed) == count
    assert [words[2] for words in frames.titles] == [f"{speed:g} x"] * (count - 1) + ["timeout"]
    times = [float(words[0]) for words in frames.titles]
    assert (times[0], times[-1]) == (0.0, 4.0)
    assert {text for text, *_ in frames.texts[-1]} == {""}  # a robot alone needs no number
    assert frames.axes.get_xlim() == pytest.approx((-2.5, 32.5))
    assert frames.axes.get_ylim() == pytest.approx((-2.5, 36.5))
    for time_s, nose in zip(times, frames.noses, strict=True):
        angle = 3.0 + (2.0 * np.pi - 6.0) * time_s / 4.0
        assert nose == pytest.approx((2.5 * np.cos(angle), 2.5 * np.sin(angle)), abs=0.05)


def test_more_robots_than_colours_have_numbers_and_so_have_their_targets(monkeypatch, tmp_path):
    frames = Frames()
    monkeypatch.setattr(video, "_writer", lambda _: frames)
    episode = driven("swarm-16", 1.0)
    video.write_video(episode, tmp_path / "a.gif", 100.0)
    texts = frames.texts[-1]
    for number, target in enumerate(episode.scenario.targets, 1):
        at = episode.signals[f"r{number}/position"].values[0]
        mine = [place for text, *place in texts if text == str(number)]
        wanted = [np.add(target, (1.7, 0.5)) * episode.scenario.cell_m, at]
        assert np.sort(mine, axis=0) == pytest.approx(100.0 * np.sort(wanted, axis=0))


def test_trails_are_those_of_the_last_half_minute(monkeypatch, tmp_path):
    frames, episode, times = Frames(), driven("1a", 80.0), np.arange(81.0)
    places = np.column_stack([0.003 * times, 0.1 + 0.0 * times])
    episode.signals["r1/position"] = Signal(times, places, ("x", "y"), "m")
    monkeypatch.setattr(video, "_writer", lambda _: frames)
    video.write_video(episode, tmp_path / "a.gif", 120.0)
    first, last = frames.trails[1][0], frames.trails[-1]
    np.testing.assert_allclose(first, (0.0, 10.0))
    np.testing.assert_allclose((last[0], last[-1]), ((15.0, 10.0), (24.0, 10.0)), atol=0.31)

"""Two episodes next to each other, and an episode as a video."""

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from PIL import Image

import minirobots as mr
from analysis.compare import compare, draw
from cosim.base.colours import robot_colour
from cosim.recording.reader import Signals


@pytest.fixture(scope="module")
def recordings(tmp_path_factory):
    """Recordings of two episodes that differ by friction only."""
    folder = tmp_path_factory.mktemp("compare")
    policy = mr.train("1a", method="shortest", progress=None)
    paths = []
    for mu in (0.15, 0.16):
        episode = mr.simulate("1a", policy, mu=mu, speed=3.0, time_limit=4.0, progress=None)
        paths.append(folder / f"{mu}.rrd")
        episode.save(paths[-1])
    return paths


@pytest.mark.long
def test_an_episode_does_not_differ_from_itself(recordings):
    episode = mr.open(recordings[0])
    found = compare(episode, episode)
    assert (found.differences, found.facts, found.parameters) == ({}, {}, {})
    assert found.values > 10_000


def test_what_differs_is_named_with_the_time(recordings, command, tmp_path):
    done = command("compare", *recordings, "--out", tmp_path / "a.png", "--json")
    found = json.loads(done.stdout.splitlines()[-1])
    assert done.returncode == 1
    assert found["parameters"]["mu"] == [0.15, 0.16]
    a, b = (mr.open(path).signals["r1/position"] for path in recordings)
    first = a.time_s[(a.values != b.values).any(axis=1)][0]
    assert found["differences"]["/sim/r1/position"] == first
    times = [time_s for time_s in found["differences"].values() if time_s is not None]
    assert times == sorted(times)
    with Image.open(tmp_path / "a.png") as image:
        assert image.width > 1000


@pytest.mark.parametrize("name", ["a.xyz", "a"])
def test_a_picture_of_another_format_is_refused_before_recordings_are_read(name, command):
    done = command("compare", "none.rrd", "none.rrd", "--out", name)
    fault = "its name must end in .png or .pdf or .svg; choose a.png"
    assert (done.returncode, done.stderr) == (2, f"error: {name}: {fault}\n")


def test_colours_are_robots_and_styles_episodes(recordings):
    a, b = map(mr.open, recordings)
    assert a.scenario is not None
    (target,) = a.scenario.targets
    figure: Any = draw(a, b, compare(a, b))
    board, *curves = figure.axes
    for axes in (board, *curves):
        assert {line.get_color() for line in axes.lines} == {robot_colour(0)}
    hollow, *paths = board.lines
    np.testing.assert_allclose(hollow.get_xydata(), [[target[0] + 0.5, target[1] + 0.5]])
    for lines in (paths, *(axes.lines for axes in curves)):
        assert [line.get_linestyle() for line in lines] == ["-", "--"]
    for line, episode in zip(paths, (a, b), strict=True):
        places = 100.0 * episode.signals["r1/position"].values[:, :2]
        np.testing.assert_array_equal(line.get_xydata(), places)
    (legend,) = figure.legends
    assert [text.get_text() for text in legend.get_texts()] == [*map(str, recordings)]
    assert [key.get_linestyle() for key in legend.get_lines()] == ["-", "--"]


def test_the_tenth_robot_has_its_own_colour(recordings):
    one = mr.open(recordings[0])
    position = one.signals["r1/position"]
    places = {f"/sim/r{k}/position": position for k in range(1, 13)}
    moved = position._replace(values=position.values + (position.time_s[:, None] > 1.0))
    a, b = (
        replace(one, robots=tuple(f"r{k}" for k in range(1, 13)), signals=Signals("", signals))
        for signals in (places, places | {"/sim/r10/position": moved})
    )
    figure: Any = draw(a, b, compare(a, b))
    _, curve = figure.axes
    assert curve.get_title(loc="left") == "r10/position in m"
    assert [line.get_color() for line in curve.lines] == 2 * [robot_colour(9)]
    assert robot_colour(9) != robot_colour(1)


@pytest.mark.long
def test_a_video_shows_the_robot_where_it_is(recordings, command, tmp_path):
    out = tmp_path / "a.gif"
    assert command("video", recordings[0], "--out", out, "--speed", "10").returncode == 0
    with Image.open(out) as image:
        assert getattr(image, "n_frames", 1) == 6  # every 10 / 12 s of 4 s, and the start
        colours = np.asarray(image.convert("RGB")).astype(int)
    episode = mr.open(recordings[0])
    # the disc is in the robot's colour, half transparent; starts are paler
    wanted = np.array([int(robot_colour(0)[i : i + 2], 16) for i in (1, 3, 5)])
    half = (wanted + 255) // 2
    rows, columns = np.nonzero(abs(colours - half).max(axis=2) < 12)
    ink = (colours < 60).all(axis=2)
    sides = np.flatnonzero(ink.sum(axis=0) > 200)  # the board's, and no text
    pixels_per_cm = (sides[-1] - sides[0]) / 30
    at = 100 * episode.signals["r1/position"].values[0, :2]
    edge = (columns.max() - sides[0]) / pixels_per_cm
    assert edge == pytest.approx(at[0] + 2.5, abs=0.2)
    # it is whole, though its centre is near the board's edge
    assert (rows.max() - rows.min()) / pixels_per_cm == pytest.approx(5.0, abs=0.2)


def test_a_video_of_another_format_is_refused(recordings, tmp_path, command):
    done = command("video", recordings[0], "--out", tmp_path / "a.avi")
    assert (done.returncode, ".mp4 or .gif" in done.stderr) == (2, True)

"""What looks wrong in an episode, and what robots that reach their targets do as well."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from analysis.reading.findings import find
from analysis.reading.inspection import inspect_episode
from cosim.recording.reader import DrivenMove, Episode, Parameter, Signal, Signals, Texts

TIME_S = 0.001 * np.arange(1.0, 1001.0)
NEAR, FAR = np.linspace(0.058, 0.062, 1000), np.full(1000, 1.0)


def made_up(
    x_m: dict[str, np.ndarray], touching=(), outcome="success", *, complete=True, more=None
) -> Episode:
    """Robots on a line, of which some touch something in the last sample."""
    values = dict(more or {})
    for robot, x in x_m.items():
        values[f"{robot}/position"] = np.column_stack([x, np.zeros_like(x)])
        touches = np.zeros(len(TIME_S))
        touches[-1] = robot in touching
        values[f"{robot}/contact/touching_share"] = touches
    signals = {f"/sim/{path}": Signal(TIME_S, v, ("D", "E"), "") for path, v in values.items()}
    known = {"diameter_m": 0.05, "V_s_max": 3.0}
    lacks = Texts(TIME_S[-1:], ("has not arrived",))
    return Episode(
        *(Path("made_up.rrd"), "id", complete, outcome, 1.0, tuple(x_m)),
        {"targets_m": [*([(0.0, 0.0)] * 2), (1.3, 0.4), *([(0.0, 0.0)] * 8), (1.0, 0.7)]},
        {name: Parameter(value, "", "", "") for name, value in known.items()},
        Signals("made up", signals),
        {f"/rl/{robot}/failure": lacks for robot in x_m} if outcome == "timeout" else {},
        dict.fromkeys(x_m, ()),
        None,
    )


def kinds(episode: Episode, *, wrong: bool = True) -> list[tuple[str, str]]:
    return [(found.kind, found.where) for found in find(episode) if found.wrong == wrong]


def test_only_robots_that_touch_each_other_collide():
    """A robot 9 mm apart watches, and one that hits a wall was only near the other before."""
    x_m = {"r1": np.zeros(1000), "r2": NEAR[::-1] - 0.0081, "r3": np.full(1000, 0.109)}
    collided = made_up(x_m, ("r1", "r2"), "collision")
    assert kinds(collided) == [("no success", "episode"), ("collision", "r1 and r2")]
    assert kinds(collided, wrong=False) == [("near miss", "r2 and r3")]
    against_a_wall = made_up({"r1": np.zeros(1000), "r2": NEAR}, ("r2",), "collision")
    assert kinds(against_a_wall) == [("no success", "episode")]
    assert kinds(against_a_wall, wrong=False) == [("near miss", "r1 and r2")]


@pytest.mark.parametrize(
    ("outcome", "complete", "said"),
    [
        ("", False, ["incomplete"]),
        ("", True, ["incomplete"]),
        ("collision", False, ["incomplete", "no success"]),
        ("success", True, []),
    ],
)
def test_an_episode_that_is_not_whole_looks_wrong(outcome, complete, said):
    episode = made_up({"r1": FAR}, (), outcome, complete=complete)
    assert [kind for kind, _ in kinds(episode)] == said


@pytest.mark.parametrize(
    ("saturated", "every", "wrong"), [(40, 1, False), (600, 1, True), (900, 3, False)]
)
def test_what_successful_robots_do_does_not_look_wrong(saturated, every, wrong):
    voltage = np.zeros((1000, 2))
    voltage[:saturated:every, 0] = -3.0  # without a pause, or again and again
    share = {f"r1/contact/{name}_share": np.full(1000, 0.4) for name in ("slipping", "lifted")}
    x_m = {"r1": np.zeros(1000), "r2": NEAR}
    episode = made_up(x_m, more=share | {"r1/motors/voltage": voltage})
    saturation = ("voltage saturation", "r1 D")
    assert kinds(episode) == [saturation] * wrong
    usual = [("slipping", "r1"), ("lift-off", "r1"), ("near miss", "r1 and r2")]
    assert kinds(episode, wrong=False) == [saturation] * (not wrong) + usual


@pytest.mark.parametrize(("speed_m_s", "wrong"), [(0.124, []), (0.126, [("slow", "episode")])])
def test_an_episode_of_four_times_the_straight_line_looks_wrong(speed_m_s, wrong):
    """It lasts 1 s; the second robot is 31 mm from its target, the first one nearer."""
    episode = made_up({"r1": np.full(1000, 0.02), "r2": np.full(1000, -0.031)}, (), "success")
    known = {**episode.parameters, "drive_speed_m_s": Parameter(speed_m_s, "", "", "")}
    assert kinds(replace(episode, parameters=known)) == wrong


def test_a_robot_lacks_its_own_target_where_others_are_not_recorded():
    found = find(made_up({"r3": FAR}, (), "timeout"))[-1]
    assert found.numbers["target_away_m"] == pytest.approx(0.5)
    assert find(made_up({"r12": FAR}, (), "timeout"))[-1].numbers["target_away_m"] == 0.7


def test_a_move_that_the_end_cuts_off_has_not_timed_out():
    moves = (
        DrivenMove(0.0, 4.0, "0°", ended=True, given_up=False),
        DrivenMove(4.0, 44.0, "90°", ended=False, given_up=True),
        DrivenMove(44.0, 45.0, "45°", ended=False, given_up=False),
    )
    summary = inspect_episode(replace(made_up({"r1": FAR}), moves={"r1": moves})).robots["r1"]
    assert (summary.moves, summary.moves_ended, summary.moves_timed_out) == (3, 1, 1)

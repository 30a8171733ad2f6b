"""Tasks of a user: the one of CONTRIBUTING.md, its rewards by name, and mistakes."""

import re
import textwrap
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

import agent.envs
from agent.envs.tasks import Task, draw_positions, is_free
from cosim.base.errors import UserError
from cosim.model.outcome import SUCCESS
from cosim.model.scenario import Scenario

PAGE = Path(__file__).parents[3] / "CONTRIBUTING.md"
START = {"starts": [[0.15, 0.15, 0.3]], "targets": [[0.25, 0.15]]}


@pytest.fixture
def facing(tmp_path, monkeypatch):
    """Name of the task of the page, in a module of the working folder."""
    (code,) = re.findall(
        r"^  ```python\n((?:(?!  ```).)*class Face.*?)^  ```$", PAGE.read_text("utf-8"), re.M | re.S
    )
    (tmp_path / "facing.py").write_text(textwrap.dedent(code))
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    return "facing:Face"


def test_a_task_is_one_file(facing):
    """Robots have arrived where the task says so, and earn its terms."""
    env = gym.make("MiniRobots/Drive-v0", task=facing)
    env.reset(seed=0, options=START)
    rows = [env.step(np.array([0.0, -1.0]))]
    while not rows[-1][2]:
        rows.append(env.step(np.array([0.0, -1.0])))
    earned = [{k: v for k, v in row[4].items() if k.startswith("reward_")} for row in rows]
    assert [sum(each.values()) for each in earned] == pytest.approx([row[1] for row in rows])
    turned = sum(each["reward_turned"] for each in earned)
    assert turned == pytest.approx(0.3, abs=0.06)
    assert rows[-1][4]["outcome"] == SUCCESS
    assert {"reward_turned", "reward_time", "reward_end"} == earned[0].keys()
    assert [each["reward_end"] for each in earned] == [0.0] * (len(rows) - 1) + [10.0]
    env.close()


def test_the_terms_of_a_vector_are_those_of_its_rows():
    env = gym.make_vec("MiniRobots/Drive-v0", num_envs=2)
    first = env.reset(seed=0)[1]
    assert not first["reward_progress"].any()
    for _ in range(3):
        _, rewards, *_, infos = env.step(np.ones((2, 2)))
        terms = infos["reward_progress"] + infos["reward_time"] + infos["reward_end"]
        assert terms.tolist() == rewards.tolist()
        assert infos["_reward_end"].all()
    env.close()
    pair = agent.envs.parallel_env("2", cosim=True, decision="period", time_limit=4.0)
    pair.reset(seed=0, options={"starts": [[15, 27], [15, 20]]})
    _, rewards, *_, infos = pair.step({"robot_1": 6, "robot_2": 2})
    for name, reward in rewards.items():
        info = infos[name]
        parts = info["reward_goal_or_failure"], info["reward_step"], info["reward_nearness"]
        assert sum(parts) == pytest.approx(reward)
        assert parts[1] == -1.0
        assert parts[2] < 0.0
    pair.close()


class Unweighted(Task):
    weights = {"speed": 1.0}  # noqa: RUF012


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"task": "none:Task"}, "task = 'none:Task' cannot be imported"),
        ({"task": "agent.envs.tasks:REACH_M"}, r"task = 0.2 is not one; give an .*Task"),
        ({"task": Task}, r"task = .* is not one"),
        ({"task": Task(), "reach": 0.1}, "reward and reach have no effect with task"),
    ],
)
def test_what_is_no_task_is_refused(options, words):
    with pytest.raises(UserError, match=words):
        gym.make("MiniRobots/Drive-v0", **options)


def test_a_weight_without_a_term_is_named():
    env = gym.make("MiniRobots/Drive-v0", task=Unweighted())
    env.reset(seed=0)
    with pytest.raises(UserError, match=r"task.weights.speed is unknown; choose one of progress"):
        env.step(np.zeros(2))
    env.close()


@pytest.mark.parametrize(("columns", "rows"), [(40, 20), (20, 40)])
def test_places_are_on_boards_that_are_not_square(columns, rows):
    board = Scenario("b", "", ((9, 9),), (((5, 5),),), columns, rows, zone=(0, 0, 0, 0))
    for x, y in ((0.3, 0.1), (0.1, 0.3)):
        free = x < 0.01 * columns and y < 0.01 * rows
        assert is_free(board, np.array([[x, y]])) == free
    rng = np.random.default_rng(0)
    drawn = np.concatenate([draw_positions(board, rng) for _ in range(100)])
    assert (drawn < board.size_m).all()
    assert (drawn.max(axis=0) > 0.9 * np.array(board.size_m)).all()

"""Many boards with several robots: the process of single environments, by rows."""

import json
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from agent import envs
from agent.envs.navigation import RobotsVectorEnv
from agent.mdp.config import ProcessConfig
from benchmarks import __main__ as benchmarks
from benchmarks import envs as benchmark
from cosim.base.errors import UserError
from cosim.model.outcome import OUT_OF_BOARD, RUNNING, TIMEOUT
from cosim.model.scenario import Scenario

FOUR_STARTS = ((10, 10), (12, 8)), ((19, 10), (17, 8)), ((10, 19), (12, 21)), ((19, 19), (17, 21))
FOUR = Scenario("four", "", ((5, 5), (24, 5), (5, 24), (24, 24)), FOUR_STARTS)
BOARDS = 5


# Next to the targets on some boards, so that robots wait for others; drawn for the rest.
NEAR = [[15, 20], [3, 3]]
NEAR_FOUR = [[5, 7], [24, 7], [9, 24], [20, 20]]


@pytest.mark.long
@pytest.mark.parametrize("slip", [0.0, 0.3])
@pytest.mark.parametrize(
    ("scenario", "near"),
    [("1b", None), ("2", NEAR), ("4", None), ("5-doorway", None), (FOUR, NEAR_FOUR)],
)
def test_boards_are_single_environments_bit_for_bit(scenario, near, slip):
    config = ProcessConfig(slip_probability=slip, step_limit=25, features=("x", "y", "d", "g", "b"))
    starts = near and [near] * BOARDS
    rows = RobotsVectorEnv(BOARDS, scenario, config, ends="own")
    robots = rows.scenario.robots
    rows.reset(seed=3)
    if starts is not None:
        rows.reset(options={"starts": np.array(starts)})
    # towards the targets that are near, and then at random
    joints = np.random.default_rng(0).integers(8, size=(150, BOARDS, robots))
    joints[:2] = 6
    steps = [rows.step(joint.ravel()) for joint in joints]
    ends = set()
    for board in range(BOARDS):
        env = envs.parallel_env(scenario, config)
        env.reset(seed=3 + board)
        if starts is not None:
            env.reset(options={"starts": near})
        for joint, (*arrays, infos) in zip(joints[:, board], steps, strict=True):
            if live := list(env.agents):
                results: Any = env.step(dict(zip(env.possible_agents, joint, strict=True)))
            else:
                live = env.possible_agents
                observations, begun = env.reset()
                still = dict.fromkeys(live, 0.0)
                results = observations, still, still, still, begun
            for k, agent in enumerate(env.possible_agents, board * robots):
                observation, *ours = (array[k].tolist() for array in arrays)
                active = infos["active"][k]
                assert active == (agent in env.agents)
                if agent not in live:
                    assert ours == [0.0, False, False]
                    ends.add("waits")
                    continue
                own, *single, info = (values[agent] for values in results)
                assert [observation, *ours] == [own.tolist(), *single]
                theirs = {name: value for name, value in info.items() if name != "action_mask"}
                assert theirs | {"active": active} == {name: infos[name][k] for name in theirs}
                ends.add(theirs["outcome"])
    assert ends >= {RUNNING, OUT_OF_BOARD, TIMEOUT} | ({"waits"} if starts else set())


def test_rows_are_robots_as_gymnasium_expects_them():
    env = gym.make_vec("MiniRobots/Pair-v0", num_envs=3)
    assert isinstance(env.unwrapped, RobotsVectorEnv)
    assert env.num_envs == 6
    assert env.metadata["autoreset_mode"] == AutoresetMode.NEXT_STEP
    assert env.single_observation_space == gym.spaces.MultiDiscrete([30, 30, 3, 3])
    env = gym.wrappers.vector.RecordEpisodeStatistics(env)
    first, infos = env.reset(seed=0)
    assert first in env.observation_space
    assert infos["active"].all()
    before, returns = first.copy(), np.zeros(6)
    env.action_space.seed(0)
    for _ in range(200):
        rows, rewards, terminated, truncated, infos = env.step(env.action_space.sample())
        assert rows in env.observation_space
        returns += rewards
        ended = terminated | truncated
        if ended.any():
            assert infos["episode"]["r"][ended].tolist() == pytest.approx(returns[ended].tolist())
            break
    else:
        raise AssertionError("no episode ended")
    assert np.array_equal(first, before)  # a copy


@pytest.mark.parametrize("ends", ["own", "together"])
def test_a_robot_that_has_arrived_waits_for_its_board(ends):
    config = ProcessConfig(step_limit=3)
    env = RobotsVectorEnv(2, "2", config, ends=ends, render_mode="rgb_array")
    env.reset(seed=0, options={"starts": [[[15, 19], [5, 5]], [[3, 3], [25, 25]]]})
    pictures = env.render()
    assert pictures is not None
    assert len(pictures) == 4
    steps = [env.step(np.array([6, 0, 0, 0])) for _ in range(4)]  # the last begins again
    observations, rewards, terminated, truncated, infos = zip(*steps, strict=True)
    first, others, nothing = [True, False, False, False], [False, True, True, True], [False] * 4
    waits, gone = [0.0, -1.0, -1.0, -1.0], [0.0] * 4
    assert [row.tolist() for row in rewards] == [[100.0, -1.0, -1.0, -1.0], waits, waits, gone]
    own = [first, nothing, nothing, nothing]
    together = [nothing, nothing, first, nothing]
    assert [row.tolist() for row in terminated] == (own if ends == "own" else together)
    assert [row.tolist() for row in truncated] == [nothing, nothing, others, nothing]
    active = [info["active"].tolist() for info in infos]
    assert active == [others, others, nothing, [True] * 4]
    assert observations[1][0, :2].tolist() == [15, 18]
    assert set(infos[2]["outcome"]) == {TIMEOUT}
    assert infos[3]["path_length"].tolist() == gone
    assert {observations[3][0, 1], observations[3][1, 1]} == {0, 29}


def test_a_single_environment_of_a_pair_names_the_one_to_use():
    with pytest.raises(UserError, match="parallel_env"):
        gym.make("MiniRobots/Pair-v0")


def test_benchmark_prints_the_ratio_of_its_two_rates(monkeypatch, command):
    monkeypatch.setattr(benchmark, "STEPS", 20)
    monkeypatch.setattr(benchmark, "DYNAMICS_S", 0.2)
    one = {"drive_1": benchmark.DYNAMICS["drive_1"]}
    monkeypatch.setattr(benchmark, "DYNAMICS", one)
    done = command(benchmarks, "envs", "--json", "--repeats", 1, "--boards", 64)
    figures = json.loads(done.stdout.splitlines()[-1])
    ratio = figures["agent_steps_per_s"] / figures["parallel_agent_steps_per_s"]
    assert figures["ratio_to_parallel_env"] == pytest.approx(ratio)
    assert ratio > 5.0
    assert figures["drive_1_robot_s_per_s"] > 1.0

"""Environments in the hands of other libraries: Gymnasium, PettingZoo, SuperSuit, SB3, TorchRL."""

# pyright: reportMissingImports=false

import itertools
from functools import partial
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import gymnasium as gym
import pytest
from gymnasium.wrappers.vector import RecordEpisodeStatistics
from pettingzoo.test import parallel_api_test, parallel_seed_test, render_test
from pettingzoo.test.max_cycles_test import max_cycles_test
from pettingzoo.utils import parallel_to_aec

import minirobots as mr
from agent import envs
from agent.envs.navigation import RobotsVectorEnv
from cosim.model.scenario import Scenario

EXAMPLES = Path(__file__).parents[3] / "docs" / "examples"
IDS = ("SingleA", "SingleB", "CoSim", "Drive")
# Robots that neither touch nor leave the board within a few moves.
MIDDLE = Scenario("middle", "", ((5, 5), (25, 25)), (((8, 15),), ((22, 15),)))


def parallel(**options) -> Any:
    return envs.parallel_env(MIDDLE, **options)


def aec(render_mode=None, **options) -> Any:
    """PettingZoo's tests ask for "human", too."""
    mode = None if render_mode == "human" else render_mode
    return parallel_to_aec(parallel(render_mode=mode, **options))


@pytest.mark.long
@pytest.mark.parametrize("name", [*IDS, "Pair", "CoSimPair"])
def test_vector_wrappers_count_and_rows_have_pictures(name):
    env = gym.make_vec(f"MiniRobots/{name}-v0", num_envs=2, render_mode="rgb_array")
    pictures = env.reset(seed=0) and env.render()
    assert pictures is not None
    assert len(pictures) == env.num_envs
    env = RecordEpisodeStatistics(env)
    env.reset(seed=0)
    env.action_space.seed(0)
    for _ in range(5):
        env.step(env.action_space.sample())
    env.close()


@pytest.mark.long
def test_pettingzoo_accepts_robots_in_the_dynamics():
    def make():
        return envs.parallel_env("2", cosim=True, time_limit=20.0)

    parallel_api_test(make(), num_cycles=12)
    parallel_seed_test(make, num_cycles=6)


@pytest.mark.parametrize("cosim", [False, pytest.param(True, marks=pytest.mark.long)])
def test_pettingzoo_counts_cycles_and_renders(cosim):
    serial = partial(aec, cosim=cosim)
    max_cycles_test(SimpleNamespace(parallel_env=partial(parallel, cosim=cosim), env=serial))
    render_test(serial)


def test_masks_say_which_moves_end_an_episode():
    env: Any = gym.make("MiniRobots/SingleA-v0").unwrapped
    env.reset(seed=0, options={"starts": [[0, 29]]})
    assert env.action_masks().tolist() == [1, 0, 0, 0, 0, 0, 1, 1]
    for action, free in enumerate(env.action_masks()):
        env.reset(options={"starts": [[0, 29]]})
        assert env.step(action)[2] == (not free)
    rows: Any = gym.make_vec("MiniRobots/Pair-v0", num_envs=3).unwrapped
    pair = envs.parallel_env("2")
    rows.reset(seed=4)
    _, infos = pair.reset(seed=4)
    assert rows.action_masks().shape == (6, 8)
    mask = infos["robot_2"]["action_mask"]
    assert rows.action_masks()[1].tolist() == mask.astype(bool).tolist()
    driven: Any = gym.make_vec("MiniRobots/CoSim-v0", num_envs=1).unwrapped
    driven.reset(options={"starts": [[[0, 29]]]})
    assert driven.action_masks().tolist() == [[True, *[False] * 5, True, True]]
    driven.close()


@pytest.mark.learners
@pytest.mark.parametrize("name", IDS)
def test_sb3_and_torchrl_accept_the_environments(name):
    from stable_baselines3.common.env_checker import check_env
    from torchrl.envs import GymWrapper
    from torchrl.envs.utils import check_env_specs

    check_env(gym.make(f"MiniRobots/{name}-v0"))
    check_env_specs(GymWrapper(gym.make(f"MiniRobots/{name}-v0")))


@pytest.mark.learners
def test_sb3_trains_in_forked_processes():
    from stable_baselines3 import PPO
    from stable_baselines3.common.env_util import make_vec_env
    from stable_baselines3.common.vec_env import SubprocVecEnv

    env = make_vec_env(
        "MiniRobots/Drive-v0", 2, vec_env_cls=SubprocVecEnv, vec_env_kwargs={"start_method": "fork"}
    )
    PPO("MlpPolicy", env, n_steps=8, batch_size=16, device="cpu").learn(32)
    env.close()


@pytest.mark.learners
def test_maskable_ppo_takes_the_masks():
    from sb3_contrib import MaskablePPO

    env = gym.wrappers.FlattenObservation(gym.make("MiniRobots/SingleA-v0"))
    model = MaskablePPO("MlpPolicy", env, n_steps=32, batch_size=32, device="cpu")
    assert model.learn(64).num_timesteps >= 64


@pytest.mark.learners
def test_supersuit_makes_rows_of_robots_for_sb3():
    import supersuit
    from stable_baselines3 import PPO

    spaces = gym.spaces
    env = supersuit.observation_lambda_v0(
        parallel(max_cycles=50),
        lambda observation, space: spaces.flatten(space, observation),
        spaces.flatten_space,
    )
    env = supersuit.black_death_v3(env)
    env = supersuit.pettingzoo_env_to_vec_env_v1(env)
    env = supersuit.concat_vec_envs_v1(env, 2, base_class="stable_baselines3")
    PPO("MlpPolicy", env, n_steps=8, batch_size=16, device="cpu").learn(32)


@pytest.mark.learners
@pytest.mark.parametrize("cosim", [False, True])
def test_torchrl_accepts_groups_of_robots(cosim):
    from torchrl.envs import PettingZooWrapper
    from torchrl.envs.utils import check_env_specs

    env = envs.parallel_env("2", cosim=cosim)
    check_env_specs(PettingZooWrapper(env, use_mask=True, done_on_any=False))


@pytest.mark.learners
@pytest.mark.parametrize(
    ("name", "boards"), [("SingleA", 0), ("Drive", 0), ("Pair", 2), ("Drive", 2), ("CoSimPair", 2)]
)
def test_gymnasium_films_single_robots_and_rows(name, boards, tmp_path):
    name, mode = f"MiniRobots/{name}-v0", "rgb_array"
    if boards:
        rows = gym.make_vec(name, num_envs=boards, render_mode=mode)
        env: Any = gym.wrappers.vector.RecordVideo(rows, str(tmp_path), video_length=3)
    else:
        single = gym.make(name, render_mode=mode, max_episode_steps=3)
        env = gym.wrappers.RecordVideo(single, str(tmp_path))
    env.reset(seed=0)
    for _ in range(4):
        _, _, terminated, truncated, _ = env.step(env.action_space.sample())
        if terminated is True or truncated is True:  # of a single environment
            break
    env.close()
    assert [path.stat().st_size > 1000 for path in tmp_path.glob("*.mp4")][:1] == [True]


@pytest.mark.learners
def test_the_single_file_learner_makes_a_policy(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(EXAMPLES)
    cleanrl: Any = import_module("cleanrl_drive")
    cleanrl.train(tmp_path / "drive.pt", 1e-9)
    episode = mr.simulate("1a", cleanrl.policy(tmp_path / "drive.pt"), time_limit=2, progress=None)
    assert episode.outcome == "timeout"


@pytest.mark.learners
def test_the_example_of_stable_baselines_trains_continues_and_drives(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(EXAMPLES)
    sb3: Any = import_module("sb3_drive")
    file, options = tmp_path / "drive.zip", {"time_limit": 2.0}
    for _ in range(2):
        sb3.train(file, 1e-9, options)
    assert sum(sb3.evaluate(file, 2, options).values()) == 2
    assert mr.simulate("1a", sb3.driver(file), time_limit=2, progress=None).outcome == "timeout"


@pytest.mark.learners
def test_minari_makes_the_environment_again(tmp_path, monkeypatch):
    import minari

    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    env = minari.DataCollector(gym.make("MiniRobots/SingleA-v0"))
    env.reset(seed=0, options={"starts": [[9, 9]]})
    for action in (0, 2, 4):
        env.step(action)
    data = env.create_dataset("minirobots/test-v0")
    again = data.recover_environment()
    assert again.reset(seed=3)[0].tolist() == env.reset(seed=3)[0].tolist()


@pytest.mark.parametrize("cosim", [False, True])
@pytest.mark.parametrize(("columns", "rows"), [(19, 11), (11, 19)])
def test_masks_keep_robots_on_boards_that_are_not_square(columns, rows, cosim):
    board = Scenario("b", "", ((5, 5),), (((8, 8),),), columns, rows, zone=(4, 4, 6, 6))
    cells = list(itertools.product((0, 7, columns - 1), (0, 7, rows - 1)))
    env = RobotsVectorEnv(len(cells), board, cosim=cosim)
    env.reset(seed=0, options={"starts": [[cell] for cell in cells]})
    turns = (1, 0), (1, 1), (0, 1), (-1, 1), (-1, 0), (-1, -1), (0, -1), (1, -1)
    kept = [[0 <= x + i < columns and 0 <= y + j < rows for i, j in turns] for x, y in cells]
    assert env.action_masks().astype(bool).tolist() == kept
    env.close()

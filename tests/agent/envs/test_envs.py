"""Environments: the process of the kernels, and the rules of Gymnasium and PettingZoo."""

from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from pettingzoo.test import parallel_api_test, parallel_seed_test

from agent import envs
from agent.envs.parallel import NavigationParallelEnv
from agent.envs.vector import RobotsVectorEnv
from agent.mdp import grid
from agent.mdp.config import ProcessConfig
from agent.mdp.readings import build_process
from agent.mdp.rng import seeded_state
from agent.training.policy import Policy, PolicyConfig, Seed
from agent.training.settings import LearningConfig
from agent.training.store import find_or_make
from cosim.base.arguments import ConfigError
from cosim.base.errors import UserError
from cosim.model.outcome import BY_RANK, COLLISION, OUT_OF_BOARD, RUNNING, TIMEOUT
from cosim.model.scenario import Scenario
from cosim.model.scenario_file import find_scenario

IDS = ("MiniRobots/SingleA-v0", "MiniRobots/SingleB-v0")


@pytest.mark.parametrize("name", IDS)
@pytest.mark.parametrize("mode", [None, "ansi", "rgb_array"])
def test_gymnasium_accepts_the_environments(name, mode):
    env = gym.make(name, render_mode=mode)
    check_env(env.unwrapped)
    env.close()


def kernel_episode(process, seed, actions):
    """Rewards, outcomes and worlds of an episode stepped by the kernels alone."""
    n = process.terrain.shape[0]
    world = np.zeros((n, grid.COLUMN_COUNT), dtype=np.int64)
    rewards = np.empty(n, dtype=np.float32)
    cells = np.empty((n, 2), dtype=np.int64)
    random = seeded_state(seed)
    grid.place_randomly(process, world, cells, random)
    for action in actions:
        executed = np.array(action, dtype=np.int64)
        for i in range(n):
            if world[i, grid.STATUS] == grid.MOVING and process.slip_threshold > 0:
                executed[i] = grid.slipped(process, executed[i], random)
        outcome = grid.move(process, world, executed, rewards)
        yield outcome, rewards.copy(), world.copy()
        if outcome != RUNNING:
            return


@pytest.mark.parametrize("slip", [0.0, 0.3])
@pytest.mark.parametrize("seed", range(5))
def test_gymnasium_steps_the_kernels_process(seed, slip):
    config = ProcessConfig(slip_probability=slip)
    process = build_process(find_scenario("1b"), config)
    actions = np.random.default_rng(seed).integers(8, size=(200, 1))
    env = gym.make("MiniRobots/SingleB-v0", process=config, outcome_names=True)
    env.reset(seed=seed)
    for action, (outcome, rewards, world) in zip(
        actions, kernel_episode(process, seed, actions), strict=False
    ):
        seen, reward, terminated, truncated, info = env.step(action[0])
        assert reward == rewards[0]
        assert info["outcome"] == outcome
        assert info["outcome_name"] == BY_RANK[outcome]
        assert terminated == (outcome != RUNNING)
        assert not truncated
        if not terminated:
            assert seen.tolist() == world[0, [grid.X, grid.Y]].tolist()


@pytest.mark.parametrize("slip", [0.0, 0.3])
def test_pettingzoo_steps_the_kernels_process(slip):
    config = ProcessConfig(slip_probability=slip, features=("x", "y", "d", "g", "b"))
    process = build_process(find_scenario("4"), config)
    env = envs.parallel_env("4", config)
    steps = 0
    for seed in range(20):
        env.reset(seed=seed)
        moving = np.ones(2, dtype=bool)
        # robot 1 comes down, robot 2 goes up, both at random: they meet, leave or continue for long
        actions = np.random.default_rng(seed).integers(3, size=(60, 2)) + np.array([5, 1])
        for action, (outcome, rewards, world) in zip(
            actions, kernel_episode(process, seed, actions), strict=False
        ):
            joint = {agent: action[int(agent[-1]) - 1] for agent in env.agents}
            observations, got, terminations, truncations, infos = env.step(joint)
            steps += 1
            for k in np.flatnonzero(moving):
                agent = f"robot_{k + 1}"
                assert got[agent] == rewards[k]
                still = world[k, grid.STATUS] == grid.MOVING
                assert terminations[agent] == (not still)
                assert truncations[agent] == (still and outcome != RUNNING)
                assert infos[agent]["outcome"] == outcome
                if outcome == RUNNING:
                    assert row(env, observations[agent]) == grid.state_index(process, world, int(k))
            moving = world[:, grid.STATUS] == grid.MOVING
        assert not env.agents
    assert steps > 100


def test_a_trained_policy_reaches_the_targets_in_the_environment():
    learning = LearningConfig(episodes=200_000, greedy_points=0)
    config = PolicyConfig(find_scenario("2"), ProcessConfig(), learning, Seed(0))
    tables: Policy = find_or_make(config)[0]
    env = envs.parallel_env("2")
    for seed in range(5):
        observations, infos = env.reset(seed=seed)
        total = dict.fromkeys(env.possible_agents, 0.0)
        while env.agents:
            actions = {
                agent: int(tables.values[int(agent[-1]) - 1, row(env, seen)].argmax())
                for agent, seen in observations.items()
            }
            observations, rewards, _, _, infos_now = env.step(actions)
            infos |= infos_now
            for agent, reward in rewards.items():
                total[agent] += reward
        assert all(value > 0.0 for value in total.values())
        assert any(info["is_success"] for info in infos.values())
        assert all(10.0 < info["path_length"] < 40.0 for info in infos.values())


def row(env, seen):
    sizes = env.observation_space("robot_1").nvec
    return np.ravel_multi_index(tuple(seen), sizes)


@pytest.mark.parametrize("scenario", ["1a", "1b", "2", "3", "4", "5-doorway", "4-cross", "6-swap"])
def test_pettingzoo_accepts_the_environment(scenario):
    parallel_api_test(envs.parallel_env(scenario), num_cycles=300)
    parallel_seed_test(lambda: envs.parallel_env(scenario), num_cycles=100)


def test_partner_of_a_failed_robot_is_truncated():
    env = envs.parallel_env("2")
    env.reset(options={"starts": [[0, 29], [5, 5]]})
    _, rewards, terminations, truncations, infos = env.step({"robot_1": 4, "robot_2": 0})
    assert rewards == {"robot_1": -100.0, "robot_2": -1.0}
    assert terminations == {"robot_1": True, "robot_2": False}
    assert truncations == {"robot_1": False, "robot_2": True}
    assert infos["robot_2"]["outcome"] == OUT_OF_BOARD


@pytest.mark.parametrize("slip", [0.0, 0.2])
def test_native_vector_environment_is_the_synchronous_one_bit_for_bit(slip):
    config = ProcessConfig(slip_probability=slip, step_limit=20)
    native = gym.make_vec("MiniRobots/SingleB-v0", num_envs=6, process=config)
    assert isinstance(native.unwrapped, RobotsVectorEnv)
    plain = SyncVectorEnv(
        [lambda: envs.NavigationEnv("1b", config)] * 6, autoreset_mode=AutoresetMode.NEXT_STEP
    )
    assert native.observation_space == plain.observation_space
    assert native.action_space == plain.action_space
    actions = np.random.default_rng(0).integers(8, size=(300, 6))
    outcomes = set()
    compare(native.reset(seed=5), plain.reset(seed=5))
    for action in actions:
        compare(native.step(action), plain.step(action))
        outcomes |= {*native.unwrapped._infos()["outcome"]}
    assert outcomes >= {RUNNING, OUT_OF_BOARD, TIMEOUT}
    native.close()
    plain.close()


def test_co_simulated_vector_environment_is_the_synchronous_one_bit_for_bit():
    native = gym.make_vec("MiniRobots/CoSim-v0", num_envs=3)
    assert isinstance(native.unwrapped, RobotsVectorEnv)
    plain = SyncVectorEnv(
        [lambda: gym.make("MiniRobots/CoSim-v0", decision="period")] * 3,
        autoreset_mode=AutoresetMode.NEXT_STEP,
    )
    assert native.observation_space == plain.observation_space
    compare(native.reset(seed=5), plain.reset(seed=5))
    # one leaves the board soon and begins again, the others continue
    starts = np.array([[[5, 0]], [[4, 4]], [[20, 9]]])
    options = {"starts": starts}
    native.reset(options=options)
    for env, cell in zip(plain.envs, starts, strict=True):
        env.reset(options={"starts": cell})
    outcomes = []
    for action in ([6, 1, 2], [6, 1, 3], [6, 2, 3], [6, 2, 4], [0, 1, 2]):
        ours = native.step(np.array(action))
        compare(ours, plain.step(np.array(action)))
        outcomes.append(ours[4]["outcome"].tolist())
    assert [OUT_OF_BOARD, RUNNING, RUNNING] in outcomes[:-1]
    native.close()
    plain.close()


def compare(ours, theirs):
    for a, b in zip(ours, theirs, strict=True):
        if not isinstance(a, dict):
            assert np.array_equal(a, b)
            assert a.dtype == b.dtype
            continue
        assert a.keys() == b.keys()
        for name in a:
            assert np.array_equal(a[name], b[name]), name


@pytest.mark.parametrize(
    ("reading", "cosim", "said"),
    [
        ({"reward_per": "time"}, False, "reward_per = time has no effect in environments on"),
        ({"partner_of_failed": "none"}, False, "environments on the grid: nothing is learnt there"),
        ({"step_limit": 5}, True, "step_limit = 5 has no effect in the co-simulation: episodes"),
        ({"slip_probability": 0.1}, True, "moves end where they end; leave it at 0.0"),
        ({"target_obstacle": "disk"}, True, "of the grid alone; leave it at cell"),
    ],
)
def test_readings_without_effect_are_refused(reading, cosim, said):
    with pytest.raises(UserError, match=said):
        envs.parallel_env("2", ProcessConfig(**reading), cosim=cosim)


@pytest.mark.parametrize("name", ["SingleA", "CoSim", "Pair", "CoSimPair"])
def test_interpretations_of_another_type_are_refused(name):
    make = gym.make_vec if "Pair" in name else gym.make
    with pytest.raises(UserError, match="process = 3 is invalid"):
        make(f"MiniRobots/{name}-v0", process=3)
    with pytest.raises(UserError, match="process = 3 is invalid"):
        envs.parallel_env("2", process=3)  # pyright: ignore[reportArgumentType]


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"reset_mask": np.ones(4, dtype=bool)}, "reset_mask = .*; give one to each of the 2"),
        ({"reset_mask": np.ones(2, dtype=int)}, r"reset_mask\[0\] = 1 is invalid: expected bool"),
        ({"reset_mask": np.array(True)}, "reset_mask = .*; give one to each of the 2 boards"),
        ({"starts": [[[4, 4], [9, 9]]]}, r"starts = .*; give one to each of the 2 boards"),
        ({"starts": [[[4, 4]], [[9, 9]]]}, r"starts = .* are not cells; .* \(2, 2\)"),
        ({"start": [[3, 3], [9, 9]]}, "no option 'start'; choose from starts, reset"),
        ({"starts": [[[4, 4], [9, 9]], [[1, 1], [2]]]}, "are not cells"),
        ({"starts": np.full((2, 2, 2), 3.9)}, "are not cells; give whole numbers"),
        ([7], "1 seeds; give one to each of the 2 boards"),
        ([1, 2, 3], "3 seeds"),
        ([1, -3], r"seed\[1\] = -3 is invalid: expected int >= 0"),
    ],
)
def test_resets_of_another_number_of_boards_are_refused(options, said):
    """Options, or a list of seeds."""
    arguments: Any = {"options": options} if isinstance(options, dict) else {"seed": options}
    with pytest.raises(ConfigError, match=said):
        RobotsVectorEnv(2, "2").reset(**arguments)


def test_a_refused_reset_changes_nothing():
    env, other = RobotsVectorEnv(2, "2"), RobotsVectorEnv(2, "2")
    assert np.array_equal(env.reset(seed=0)[0], other.reset(seed=0)[0])
    touching = [[[9, 9], [20, 20]], [[3, 3], [4, 4]]]
    with pytest.raises(ConfigError, match="touch"):
        env.reset(seed=1, options={"starts": touching})
    for _ in range(100):
        a, b = env.step(np.zeros(4, dtype=int)), other.step(np.zeros(4, dtype=int))
        assert np.array_equal(a[0], b[0])


@pytest.mark.parametrize("make", [envs.NavigationEnv, envs.parallel_env, RobotsVectorEnv])
def test_other_pictures_are_refused(make):
    with pytest.raises(UserError, match=r"render_mode = 'human' .*choose one of ansi, rgb_array"):
        make(render_mode="human")


@pytest.mark.parametrize("cosim", [False, True])
def test_a_single_environment_is_reset_before_and_after_an_episode(cosim):
    env = envs.NavigationEnv("1a", cosim=cosim)
    with pytest.raises(ConfigError, match=r"no episode .*; call reset"):
        env.step(0)
    with pytest.raises(ConfigError, match="no option 'reset_mask'; choose from starts"):
        env.reset(options={"reset_mask": [True]})
    env.reset(options={"starts": [[0, 4]]})
    while not env.step(4)[2]:  # off the board
        pass
    with pytest.raises(ConfigError, match=r"no episode .*; call reset"):
        env.step(4)
    env.close()


def test_co_simulated_environments_begin_together():
    env = RobotsVectorEnv(2, "1a", cosim=True)
    with pytest.raises(ConfigError, match="have not begun; reset all"):
        env.reset(options={"reset_mask": np.array([True, False])})
    with pytest.raises(ConfigError, match="off the 30 x 30 board"):
        env.reset(options={"starts": [[[0, 4]], [[40, 0]]]})
    observations, *_, infos = env.step(np.zeros(2, dtype=int))  # begins
    assert observations.shape == (2, 2)
    assert list(infos["path_length"]) == [0.0, 0.0]
    env.close()


def test_a_reset_of_some_seeds_them_alone():
    """As Gymnasium's does: the boards that continue are not disturbed."""
    slippery = ProcessConfig(slip_probability=0.5)

    def paths(env):
        env.reset(seed=0)
        found = []
        for step in range(12):
            if step == 4:
                mask = {"reset_mask": np.array([False, True])}
                found.append(env.reset(seed=7, options=mask)[0].tolist())
            found.append(env.step(np.array([0, 0]))[0].tolist())
        return found

    single = [lambda: envs.NavigationEnv("1a", slippery)] * 2
    theirs = SyncVectorEnv(single, autoreset_mode=AutoresetMode.NEXT_STEP)
    assert paths(RobotsVectorEnv(2, "1a", slippery)) == paths(theirs)


def test_vector_environment_restarts_some_and_takes_starts():
    env = RobotsVectorEnv(3, "1a")
    cells = np.array([[[4, 4]], [[5, 5]], [[6, 6]]])
    seen, _ = env.reset(options={"starts": cells})
    assert seen.tolist() == [[4, 4], [5, 5], [6, 6]]
    env.step(np.array([0, 0, 0]))
    seen, _ = env.reset(options={"starts": cells, "reset_mask": np.array([True, False, False])})
    assert seen.tolist() == [[4, 4], [6, 5], [7, 6]]


def beginnings(env, count=20):
    """Start cells of many episodes of a Gymnasium environment that is not seeded."""
    return [env.reset()[0].tolist() for _ in range(count)]


def test_environments_never_seeded_differ():
    first, second = beginnings(gym.make(IDS[0])), beginnings(gym.make(IDS[0]))
    assert first != second
    assert len({tuple(cell) for cell in first}) > 1
    several = gym.make_vec(IDS[1], num_envs=8, vectorization_mode="sync")
    assert len({tuple(cell) for cell in several.reset()[0].tolist()}) > 1
    pairs = [envs.parallel_env("4") for _ in range(8)]
    assert len({str(pair.reset()[0]["robot_1"]) for pair in pairs}) > 1


def test_entropy_of_an_environment_can_be_given_to_another():
    env, again = envs.NavigationEnv("1b"), envs.NavigationEnv("1b")
    first = env.reset()[0].tolist()
    assert again.reset(seed=env.np_random_seed)[0].tolist() == first
    assert beginnings(env) == beginnings(again)
    many, same = RobotsVectorEnv(5, "1b"), RobotsVectorEnv(5, "1b")
    assert np.array_equal(many.reset()[0], same.reset(seed=many.np_random_seed)[0])
    assert same.np_random_seed == many.np_random_seed


@pytest.mark.parametrize(
    "make", [lambda: envs.NavigationEnv("1b"), lambda: RobotsVectorEnv(3, "1b")]
)
def test_a_reset_without_seed_goes_on_with_the_stream(make):
    first, second = make(), make()
    begun = [env.reset(seed=7)[0].tolist() for env in (first, second)]
    assert begun[0] == begun[1]
    cells = beginnings(first)
    assert cells == beginnings(second)
    assert any(cell != begun[0] for cell in cells)


@pytest.mark.parametrize("action", [-1, 8, 1.5, None, [0], [[0], [1, 2]]])
def test_actions_that_are_no_directions_are_refused(action):
    env = envs.NavigationEnv("1a")
    env.reset(options={"starts": [[5, 5]]})
    with pytest.raises(ConfigError, match=r"not (a direction|directions); .*from 0 to 7"):
        env.step(action)
    assert env.step(0)[0].tolist() == [6, 5]


@pytest.mark.parametrize(
    ("actions", "message"),
    [
        ([0, 8], "action 8 of robot_1 on board 1 is not a direction"),
        ([-1, 0], "action -1 of robot_1 on board 0"),
        ([0], "for each of the 2 robots"),
        ([0.0, 1.0], "are not directions; choose one whole number"),
    ],
)
def test_vector_environment_names_the_one_with_a_wrong_action(actions, message):
    env = RobotsVectorEnv(2, "1a")
    env.reset(seed=0)
    with pytest.raises(ConfigError, match=message):
        env.step(np.array(actions))


@pytest.mark.parametrize(
    ("actions", "message"),
    [
        ({"robot_1": 0}, "robot_2 has no action"),
        ({}, "robot_1 has no action"),
        ({"robot_1": 0, "robot_2": 0, "robot_3": 0}, "robot_3 is not an agent; choose from robot"),
        ({"robot_1": 0, "robot_2": 8}, "action 8 of robot_2 is not a direction"),
        ({"robot_1": 0, "robot_2": None}, "action None of robot_2"),
    ],
)
def test_every_agent_needs_an_action_and_nobody_else_has_one(actions, message):
    env = envs.parallel_env("2")
    env.reset(options={"starts": [[0, 29], [5, 5]]})
    with pytest.raises(ConfigError, match=message):
        env.step(actions)
    observations, *_ = env.step({"robot_1": 0, "robot_2": 0})
    assert [seen.tolist()[:2] for seen in observations.values()] == [[1, 29], [6, 5]]


def test_action_of_a_robot_that_has_arrived_is_ignored():
    env = envs.parallel_env("2")
    env.reset(options={"starts": [[15, 19], [5, 5]]})
    env.step({"robot_1": 6, "robot_2": 0})
    assert env.agents == ["robot_2"]
    for action in ({"robot_1": 6, "robot_2": 0}, {"robot_1": None, "robot_2": 0}, {"robot_2": 0}):
        observations, *_ = env.step(action)
        assert list(observations) == ["robot_2"]
    assert observations["robot_2"].tolist()[:2] == [9, 5]
    assert env._boards.scenes()[0][1][0] == pytest.approx([0.155, 0.185])


def test_step_limit_truncates():
    env = gym.make("MiniRobots/SingleA-v0", process=ProcessConfig(step_limit=2))
    env.reset(options={"starts": [[5, 5]]})
    assert env.step(0)[2:4] == (False, False)
    _, _, terminated, truncated, info = env.step(0)
    assert (terminated, truncated) == (False, True)
    ended = {"outcome": TIMEOUT, "is_success": False, "active": False}
    assert info == {**ended, "path_length": pytest.approx(2.0)}


@pytest.mark.parametrize(
    ("starts", "message"),
    [
        ([[40, 0], [0, 0]], "off the 30 x 30 board"),
        ([[15, 18], [0, 0]], "target"),
        ([[3, 3], [4, 4]], "touch"),
        ([[3, 3]], r"of shape \(2, 2\)"),
        ([[3.0, 3.0], [9.0, 9.0]], "whole numbers"),
    ],
)
def test_unusable_starts_are_refused(starts, message):
    with pytest.raises(ConfigError, match=message):
        envs.parallel_env("2").reset(options={"starts": starts})


def test_pictures_show_robots_targets_and_zone():
    env = envs.parallel_env("2", render_mode="ansi")
    env.reset(options={"starts": [[0, 29], [3, 0]]})
    lines = env.render().splitlines()
    assert [len(line) for line in lines] == [30] * 30
    assert lines[0][0] == "1"
    assert lines[29][3] == "2"
    assert lines[29 - 18][15] == "a"
    assert lines[29 - 12][15] == "b"
    assert sum(line.count(":") for line in lines) == 47
    env = envs.parallel_env("2", render_mode="rgb_array")
    env.reset(options={"starts": [[5, 29], [3, 0]]})
    picture = env.render()
    assert picture.shape == (360, 360, 3)
    scale = 12
    top_left = picture[: 4 * scale, 2 * scale : 9 * scale].reshape(-1, 3)
    assert len(np.unique(top_left, axis=0)) > 2
    assert (picture[11 * scale + 5, 15 * scale + 5] == (0, 114, 178)).all()


def test_pictures_show_obstacles():
    scenario, scale = find_scenario("5-doorway"), 12
    env = envs.parallel_env(scenario, render_mode="ansi")
    env.reset(seed=0)
    lines = env.render().splitlines()[::-1]
    dark = {(x, y) for y, line in enumerate(lines) for x, cell in enumerate(line) if cell == "#"}
    assert dark == set(scenario.obstacles)
    env = envs.parallel_env(scenario, render_mode="rgb_array")
    env.reset(seed=0)
    middles = env.render()[::-1][scale // 2 :: scale, scale // 2 :: scale]
    rows, columns = np.nonzero((middles == 90).all(axis=2))
    assert set(zip(columns.tolist(), rows.tolist(), strict=True)) == set(scenario.obstacles)


def test_cosim_has_the_same_interface():
    env = gym.make("MiniRobots/CoSim-v0", render_mode="rgb_array", decision="period")
    check_env(env.unwrapped, skip_render_check=True)
    paths, seen = [], np.zeros(2)
    for _ in range(2):
        seen, _ = env.reset(seed=3, options={"starts": [[15, 29]]})
        assert seen.tolist() == [15, 29]
        for _ in range(4):
            seen, reward, _, _, info = env.step(6)
            assert reward == -1.0  # a cell takes some steps of 2 s, each of which costs 1
            paths.append((seen.tolist(), info["path_length"]))
    assert paths[:4] == paths[4:]
    assert min(length for _, length in paths) > 0.1
    assert seen[0] == 15
    assert 26 <= seen[1] < 29
    picture = env.render()
    assert isinstance(picture, np.ndarray)
    assert picture.shape == (360, 360, 3)
    env.close()


def test_cosim_pair_is_a_parallel_environment():
    env, other = (envs.parallel_env("2", cosim=True) for _ in range(2))
    first, second = (
        [pair.reset()[0]["robot_1"].tolist() for _ in range(5)] for pair in (env, other)
    )
    assert first != second
    other.close()
    assert isinstance(env, NavigationParallelEnv)
    observations, _ = env.reset(seed=0, options={"starts": [[15, 29], [15, 0]]})
    assert observations["robot_1"].tolist() == [15, 29, 2, 1]
    _, rewards, terminations, _, _ = env.step({"robot_1": 6, "robot_2": 2})
    assert set(rewards) == {"robot_1", "robot_2"}
    assert not any(terminations.values())
    env.close()


WALL = Scenario("wall", "", ((8, 14),), (((8, 5),),), obstacles=tuple((x, 9) for x in range(4, 12)))


@pytest.mark.parametrize("cosim", [False, True])
def test_a_wall_ends_an_episode_as_a_collision(cosim):
    north = 2
    env = envs.NavigationEnv(WALL, cosim=cosim)
    env.reset(seed=0)
    reward, terminated, info = 0.0, False, {}
    while not terminated:
        assert reward in (0.0, -1.0, -2.0)
        _, reward, terminated, truncated, info = env.step(north)
        assert not truncated
    assert reward in {-100.0, -101.0}  # a step of the dynamics may take two RL steps
    assert info["outcome"] == COLLISION
    env.close()


@pytest.mark.parametrize("cosim", [False, True])
def test_a_bystander_of_a_collision_is_truncated_without_penalty(cosim):
    row = Scenario("row", "", ((5, 20), (11, 20), (25, 20)), (((5, 5),), ((11, 5),), ((25, 5),)))
    env = envs.parallel_env(row, cosim=cosim)
    env.reset(seed=0)
    rewards, terminations, truncations, infos = {}, {}, {}, {}
    while env.agents:
        _, rewards, terminations, truncations, infos = env.step(
            {"robot_1": 0, "robot_2": 4, "robot_3": 2}
        )
    assert rewards == {"robot_1": -100.0, "robot_2": -100.0, "robot_3": -1.0} or cosim
    assert terminations == {"robot_1": True, "robot_2": True, "robot_3": False}
    assert truncations == {"robot_1": False, "robot_2": False, "robot_3": True}
    assert infos["robot_3"]["outcome"] == COLLISION
    env.close()

"""Environments: the process of the kernels, the rules of the libraries, and what is refused."""

import doctest
from dataclasses import replace
from functools import partial
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from hypothesis import given, settings
from hypothesis import strategies as st
from pettingzoo.test import parallel_api_test, parallel_seed_test

from agent import envs
from agent.envs import drive, navigation
from agent.envs.drive import DriveVectorEnv
from agent.envs.navigation import RobotsVectorEnv
from agent.mdp import grid
from agent.mdp.config import ProcessConfig
from agent.mdp.interpretations import build_process
from agent.mdp.rng import seeded_state
from cosim.base.arguments import ConfigError
from cosim.base.errors import UserError
from cosim.model.outcome import BY_RANK, COLLISION, OUT_OF_BOARD, RUNNING, SUCCESS, TIMEOUT
from cosim.model.scenario import Scenario
from cosim.model.scenario_file import find_scenario

IDS = ("MiniRobots/SingleA-v0", "MiniRobots/SingleB-v0")
MAKERS = (envs.NavigationEnv, envs.parallel_env, RobotsVectorEnv)
driven_rows = partial(RobotsVectorEnv, scenario="1a", cosim=True)  # as of `CoSim-v0`


@pytest.mark.parametrize("module", [navigation, drive])
def test_examples_of_contracts_hold(module):
    found = doctest.testmod(module)
    assert found.attempted > 6
    assert found.failed == 0


@pytest.mark.parametrize("name", [*IDS, "MiniRobots/Drive-v0"])
@pytest.mark.parametrize("mode", [None, "ansi", "rgb_array"])
def test_gymnasium_accepts_the_environments(name, mode):
    env = gym.make(name, render_mode=mode)
    check_env(env.unwrapped, skip_render_check="Drive" in name)
    env.close()


@pytest.mark.long
@pytest.mark.parametrize("scenario", ["1a", "1b", "2", "3", "4", "5-doorway", "4-cross", "6-swap"])
def test_pettingzoo_accepts_the_environment(scenario):
    parallel_api_test(envs.parallel_env(scenario), num_cycles=300)
    parallel_seed_test(lambda: envs.parallel_env(scenario), num_cycles=100)


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


@pytest.mark.long
@pytest.mark.parametrize("slip", [0.0, 0.3])
@pytest.mark.parametrize("scenario", ["1b", "4"])
def test_an_episode_is_that_of_the_kernels(scenario, slip):
    """Of a parallel environment; the others have its bits."""
    config = ProcessConfig(slip_probability=slip, features=("x", "y", "d", "g", "b"))
    process = build_process(find_scenario(scenario), config)
    env = envs.parallel_env(scenario, config, outcome_names=True)
    robots, steps, ends = len(env.possible_agents), 0, set()
    for seed in range(20):
        env.reset(seed=seed)
        moving = np.ones(robots, dtype=bool)
        # robot 1 comes down, robot 2 goes up, both at random: they meet, leave or continue for long
        actions = np.random.default_rng(seed).integers(3, size=(60, robots)) + [5, 1][:robots]
        for action, (outcome, rewards, world) in zip(
            actions, kernel_episode(process, seed, actions), strict=False
        ):
            joint = {agent: action[int(agent[-1]) - 1] for agent in env.agents}
            observations, got, terminations, truncations, infos = env.step(joint)
            steps += 1
            for k in np.flatnonzero(moving):
                agent = f"robot_{k + 1}"
                still = world[k, grid.STATUS] == grid.MOVING
                assert got[agent] == rewards[k]
                assert terminations[agent] == (not still)
                assert truncations[agent] == (still and outcome != RUNNING)
                assert infos[agent]["outcome"] == outcome
                assert infos[agent]["outcome_name"] == BY_RANK[outcome]
                if outcome == RUNNING:
                    assert row(env, observations[agent]) == grid.state_index(process, world, int(k))
                ends.add((terminations[agent], truncations[agent]))
            moving = world[:, grid.STATUS] == grid.MOVING
    assert steps > 100
    assert len(ends) == 1 + robots  # a robot alone is not cut by another's failure


def row(env, observation):
    sizes = env.observation_space("robot_1").nvec
    return np.ravel_multi_index(tuple(observation), sizes)


def compare(ours, theirs):
    for a, b in zip(ours, theirs, strict=True):
        if not isinstance(a, dict):
            assert np.array_equal(a, b)
            assert a.dtype == b.dtype
            continue
        assert a.keys() == b.keys()
        for name in a:
            assert np.array_equal(a[name], b[name]), name


SHORT = ProcessConfig(step_limit=20)
RANDOM = np.random.default_rng(0)
MOVES = RANDOM.integers(8, size=(300, 3))
ONE_LEAVES = np.tile([6, 1, 2], (6, 1))
DRIVES = RANDOM.uniform(-1.0, 1.0, (5, 3, 2)).astype(np.float32)


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "options", "start", "actions", "outcomes"),
    [
        ("SingleB", {"process": SHORT}, [5, 0], MOVES, {RUNNING, OUT_OF_BOARD, TIMEOUT}),
        ("SingleB", {"process": replace(SHORT, slip_probability=0.2)}, [5, 0], MOVES, {TIMEOUT}),
        ("CoSim", {"decision": "period"}, [5, 0], ONE_LEAVES, {RUNNING, OUT_OF_BOARD}),
        ("Drive", {"time_limit": 0.3}, [0.1, 0.1, 0.0], DRIVES, {RUNNING, TIMEOUT}),
    ],
)
def test_native_rows_are_synchronous_environments(name, options, start, actions, outcomes):
    make: Any = partial(gym.make_vec, f"MiniRobots/{name}-v0", num_envs=3, **options)
    native, plain = make(), make(vectorization_mode="sync")
    assert isinstance(native.unwrapped, RobotsVectorEnv | DriveVectorEnv)
    assert isinstance(plain.unwrapped, SyncVectorEnv)
    assert native.observation_space == plain.observation_space
    assert native.action_space == plain.action_space
    compare(native.reset(seed=5), plain.reset(seed=5))
    native.reset(options={"starts": [[start]] * 3})
    plain.reset(options={"starts": [start]})
    found = set()
    for action in actions:
        ours = native.step(action)
        compare(ours, plain.step(action))
        found |= {*ours[4]["outcome"]}
    assert found >= outcomes
    native.close()
    plain.close()


# Options, starts and further options of a reset: robots 1 and 2 arrive, robot 3 may leave.
NEAR_CELLS = [[15, 19]], [[15, 20]], [[1, 0]]
ON_ROAD = [[0.15, 0.15, 0.0]], [[0.15, 0.15, 0.0]], [[0.296, 0.15, 0.0]]
AHEAD = {"targets": [[[0.1575, 0.15]], [[0.16, 0.15]], [[0.25, 0.15]]]}
LIMITED = {
    "SingleA": ({}, NEAR_CELLS, {}),
    "SingleB": ({}, NEAR_CELLS, {}),
    "CoSim": ({"decision": "period", "time_limit": 8.0}, NEAR_CELLS, {}),
    "Drive": ({"time_limit": 0.6, "control_interval": 0.2}, ON_ROAD, AHEAD),
}


def limited(name, limit, **how) -> Any:
    options = LIMITED[name][0]
    make: Any = gym.make_vec
    return make(f"MiniRobots/{name}-v0", num_envs=3, max_episode_steps=limit, **options, **how)


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "examples"), [("SingleA", 50), ("SingleB", 50), ("CoSim", 3), ("Drive", 6)]
)
def test_limits_cut_rows_as_gymnasium_cuts_single_environments(name, examples):
    _, starts, more = LIMITED[name]

    @settings(max_examples=examples)
    @given(limit=st.integers(1, 5), seed=st.integers(0, 2**32))
    def compare_both(limit, seed):
        native, plain = limited(name, limit), limited(name, limit, vectorization_mode="sync")
        compare(native.reset(seed=seed), plain.reset(seed=seed))
        native.reset(options={"starts": starts, **more})
        rows = [{key: value[k] for key, value in more.items()} for k in range(3)]
        for k, env in enumerate(plain.unwrapped.envs):
            env.reset(options={"starts": starts[k], **rows[k]})
        rng = np.random.default_rng(seed)
        for _ in range(2 * limit):
            if name == "Drive":
                actions = rng.uniform([0.5, -0.1], [1.0, 0.1], (3, 2)).astype(np.float32)
            else:
                actions = rng.choice([6, 6, 6, 5], 3)
            compare(native.step(actions), plain.step(actions))
        native.close()
        plain.close()

    compare_both()


@pytest.mark.parametrize("mode", ["vector_entry_point", "sync"])
def test_an_arrival_at_the_limit_is_a_success_that_is_cut(mode):
    env = limited("SingleA", 1, vectorization_mode=mode)
    env.reset(options={"starts": NEAR_CELLS if mode != "sync" else NEAR_CELLS[0]})
    _, _, terminated, truncated, infos = env.step(np.array([6, 2, 2]))
    assert (terminated[0], truncated[0], infos["outcome"][0]) == (True, True, SUCCESS)
    others = slice(1, 3)
    assert not terminated[others].any()
    assert truncated[others].all()
    assert set(infos["outcome"][others]) == {RUNNING}  # nothing but the limit ended it


@pytest.mark.parametrize("cosim", [False, True])
def test_limits_cut_groups_as_pettingzoo_s_cycles(cosim):
    starts = [[15, 19], [5, 5]]
    rows = RobotsVectorEnv(1, "2", cosim=cosim, ends="own", max_episode_steps=3)
    decision: Any = {"decision": "period"} if cosim else {}
    our_ends: list[Any] = []
    env = envs.parallel_env("2", cosim=cosim, max_cycles=3, **decision)
    rows.reset(seed=0)
    env.reset(seed=0)
    rows.reset(options={"starts": [starts]})
    env.reset(options={"starts": starts})
    for _ in range(3):
        live = [*env.agents]
        _, rewards, *ends, infos = env.step(dict.fromkeys(live, 6))
        _, ours, *our_ends, our_infos = rows.step(np.array([6, 6]))
        for k, agent in enumerate(env.possible_agents):
            if agent in live:
                assert ours[k] == rewards[agent]
                assert [end[k] for end in our_ends] == [end[agent] for end in ends]
                assert our_infos["outcome"][k] == infos[agent]["outcome"]
    assert env.agents == []
    assert our_ends[1][1]
    rows.close()
    env.close()


@pytest.mark.parametrize(
    ("process", "cosim", "words"),
    [
        ({"reward_per": "time"}, False, "reward_per = time has no effect .* grid"),
        ({"partner_of_failed": "none"}, False, "partner_of_failed .* nothing is learnt"),
        ({"step_limit": 5}, True, "step_limit = 5 has no effect in the co-simulation"),
        ({"slip_probability": 0.1}, True, "slip_probability .* leave it at 0.0"),
        ({"target_obstacle": "disk"}, True, "target_obstacle .* leave it at cell"),
        (3, False, "process = 3 is invalid"),
        (3, True, "process = 3 is invalid"),
    ],
)
def test_interpretations_without_effect_are_refused(process, cosim, words):
    config: Any = ProcessConfig(**process) if isinstance(process, dict) else process
    with pytest.raises(UserError, match=words):
        envs.parallel_env("2", config, cosim=cosim)
    for make, name in ((gym.make, "SingleA"), (gym.make, "CoSim"), (gym.make_vec, "Pair")):
        if cosim == (name == "CoSim"):
            with pytest.raises(UserError, match=words):
                make(f"MiniRobots/{name}-v0", process=config)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"reset_mask": np.ones(4, dtype=bool)}, "reset_mask = .* each of the 2 boards"),
        ({"reset_mask": np.array(True)}, "reset_mask = .* each of the 2 boards"),
        ({"reset_mask": np.ones(2, dtype=int)}, r"reset_mask\[0\] = 1 .*bool"),
        ({"starts": [[[4, 4], [9, 9]]]}, r"starts = .* each of the 2 boards"),
        ({"starts": [[[4, 4]], [[9, 9]]]}, r"starts = .* not cells; .* \(2, 2\)"),
        ({"start": [[3, 3], [9, 9]]}, "no option 'start'; choose from starts, reset"),
        ({"starts": [[[4, 4], [9, 9]], [[1, 1], [2]]]}, "not cells"),
        ({"starts": np.full((2, 2, 2), 3.9)}, "not cells; .* whole numbers"),
        ({"starts": [[[9, 9], [20, 20]], [[3, 3], [4, 4]]]}, "touch"),
        ({"starts": [[[40, 0], [0, 0]], [[3, 3], [9, 9]]]}, "off the 30 x 30 board"),
        ({"starts": [[[15, 18], [0, 0]], [[3, 3], [9, 9]]]}, "target"),
        ([7], "1 seeds; .* each of the 2 boards"),
        ([1, 2, 3], "3 seeds"),
        ([1, -3], r"seed\[1\] = -3 .*>= 0"),
    ],
)
def test_a_refused_reset_of_boards_on_the_grid_changes_nothing(options, words):
    """Options, or a list of seeds."""
    env, other = RobotsVectorEnv(2, "2"), RobotsVectorEnv(2, "2")
    compare(env.reset(seed=0), other.reset(seed=0))
    arguments: Any = {"seed": 1, "options": options}
    with pytest.raises(ConfigError, match=words):
        env.reset(**(arguments if isinstance(options, dict) else {"seed": options}))
    for _ in range(40):  # some boards begin again
        compare(env.step(np.zeros(4, dtype=int)), other.step(np.zeros(4, dtype=int)))


@pytest.mark.parametrize("kind", [DriveVectorEnv, driven_rows])
def test_a_refused_reset_of_boards_in_the_dynamics_changes_nothing(kind):
    env, twin = kind(2), kind(2)
    with pytest.raises(ConfigError, match="have not begun; reset all"):
        env.reset(options={"reset_mask": [True, False]})
    compare(env.reset(seed=0), twin.reset(seed=0))
    drives = kind is DriveVectorEnv
    starts = [[[0.1, 0.1, 0.0]], [[9, 9, 0]]] if drives else [[[5, 5]], [[99, 5]]]
    for options in ({"starts": starts}, {"mu": [0.2]}, {"mu": 0.2}, {"mu": [0.2, -1.0]}):
        with pytest.raises(UserError):
            env.reset(options=options)
    for seed in (1.5, [1], [1, 2.5], "ab", [1, -2]):
        with pytest.raises(ConfigError, match="seed"):
            env.reset(seed=seed)
    actions = np.zeros_like(env.action_space.sample())
    compare(env.step(actions), twin.step(actions))
    # a reset of some seeds them alone
    env.reset(seed=7, options={"reset_mask": [False, True]})
    assert np.array_equal(env.reset()[0][0], twin.reset()[0][0])
    env.close()
    twin.close()


def test_co_simulated_environments_begin_without_a_reset():
    env = RobotsVectorEnv(2, "1a", cosim=True)
    observations, *_, infos = env.step(np.zeros(2, dtype=int))
    assert observations.shape == (2, 2)
    assert list(infos["path_length"]) == [0.0, 0.0]
    env.close()


@pytest.mark.parametrize("make", MAKERS)
def test_other_pictures_are_refused(make):
    with pytest.raises(UserError, match=r"render_mode = 'human' .* ansi, rgb_array"):
        make(render_mode="human")


def test_interpretations_by_name_are_known_ones():
    env: Any = envs.NavigationEnv("1a", process={"step_limit": 2})
    env.reset(seed=0)
    assert [env.step(a)[3] for a in (0, 4)] == [False, True]
    with pytest.raises(ConfigError, match=r"process.step_limitt is unknown; .*mean step_limit\?"):
        envs.NavigationEnv("1a", process={"step_limitt": 2})
    with pytest.raises(ConfigError, match="cosim = 'no' is invalid: expected bool"):
        envs.NavigationEnv("1a", cosim="no")


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

    singles = [lambda: envs.NavigationEnv("1a", slippery)] * 2
    theirs = SyncVectorEnv(singles, autoreset_mode=AutoresetMode.NEXT_STEP)
    assert paths(RobotsVectorEnv(2, "1a", slippery)) == paths(theirs)
    env = RobotsVectorEnv(3, "1a")
    cells = np.array([[[4, 4]], [[5, 5]], [[6, 6]]])
    assert env.reset(options={"starts": cells})[0].tolist() == cells.reshape(3, 2).tolist()
    env.step(np.array([0, 0, 0]))
    some = {"starts": cells, "reset_mask": np.array([True, False, False])}
    assert env.reset(options=some)[0].tolist() == [[4, 4], [6, 5], [7, 6]]


def beginnings(env, count=20):
    """Observations at the start of many episodes of an environment that is not seeded."""
    return [str(env.reset()[0]) for _ in range(count)]


@pytest.mark.parametrize(
    "make",
    [
        partial(gym.make, IDS[0]),
        partial(gym.make_vec, IDS[1], num_envs=8, vectorization_mode="sync"),
        partial(envs.parallel_env, "4"),
        partial(RobotsVectorEnv, 8, "4"),
        partial(envs.parallel_env, "2", cosim=True),
    ],
)
def test_environments_never_seeded_differ(make):
    first, second = make(), make()
    assert beginnings(first) != beginnings(second)
    assert len({*beginnings(first)}) > 1
    first.close()
    second.close()


def test_boards_never_seeded_differ_and_seeds_count_up():
    assert len(np.unique(RobotsVectorEnv(8, "4").reset()[0].reshape(8, -1), axis=0)) > 4
    observations = RobotsVectorEnv(3, "4").reset(seed=5)[0]
    assert np.array_equal(RobotsVectorEnv(3, "4").reset(seed=[5, 6, 7])[0], observations)
    assert np.array_equal(RobotsVectorEnv(2, "4").reset(seed=6)[0], observations[2:])


@pytest.mark.parametrize("make", [partial(envs.NavigationEnv, "1b"), partial(RobotsVectorEnv, 3)])
def test_entropy_can_be_given_to_another_and_a_reset_continues_the_stream(make):
    env, again = make(), make()
    entropy = env.np_random_seed
    assert str(env.reset()[0]) == str(again.reset(seed=entropy)[0])
    assert again.np_random_seed == entropy
    begun = [str(each.reset(seed=7)[0]) for each in (env, again)]
    assert begun[0] == begun[1]
    starts = beginnings(env)
    assert starts == beginnings(again)
    assert {*starts} != {begun[0]}


@pytest.mark.parametrize(
    ("actions", "words"),
    [
        *((action, "not (a direction|directions); .*0 to 7") for action in (-1, 8, 1.5, None, [0])),
        ([[0], [1, 2]], "not directions; .*from 0 to 7"),
        (np.array([0, 8]), "action 8 of robot_1 on board 1 is not a direction"),
        (np.array([-1, 0]), "action -1 of robot_1 on board 0"),
        (np.array([0]), "each of the 2 robots"),
        (np.array([0.0, 1.0]), "action 0.0 of robot_1 on board 0 .* whole number"),
        ({"robot_1": 0}, "robot_2 has no action"),
        ({}, "robot_1 has no action"),
        ({"robot_1": 0, "robot_2": 0, "robot_3": 0}, "robot_3 is not an agent; .* robot_1"),
        ({"robot_1": 0, "robot_2": 8}, "action 8 of robot_2 is not a direction"),
        ({"robot_1": 0, "robot_2": None}, "action None of robot_2"),
    ],
)
def test_a_refused_action_is_named_and_moves_no_robot(actions, words):
    """Of a parallel environment (a dict), of boards (a list), and of one robot."""
    starts, good = [[0, 29], [5, 5]], np.zeros(2, dtype=int)
    if isinstance(actions, dict):
        env: Any = envs.parallel_env("2")
        env.reset(options={"starts": starts})
        good = dict.fromkeys(env.agents, 0)
    elif isinstance(actions, np.ndarray):
        env = RobotsVectorEnv(2, "1a")
        env.reset(options={"starts": [[start] for start in starts]})
    else:
        env, good = envs.NavigationEnv("1a"), 0
        env.reset(options={"starts": starts[:1]})
    with pytest.raises(ConfigError, match=words):
        env.step(actions)
    observations = env.step(good)[0]
    rows = observations.values() if isinstance(observations, dict) else np.atleast_2d(observations)
    assert [each.tolist()[:2] for each in rows] == [[1, 29], [6, 5]][: len(rows)]


def test_action_of_a_robot_that_has_arrived_is_ignored():
    env = envs.parallel_env("2")
    env.reset(options={"starts": [[15, 19], [5, 5]]})
    env.step({"robot_1": 6, "robot_2": 0})
    assert env.agents == ["robot_2"]
    for action in ({"robot_1": 6, "robot_2": 0}, {"robot_1": None, "robot_2": 0}, {"robot_2": 0}):
        observations, *_ = env.step(action)
        assert list(observations) == ["robot_2"]
    assert observations["robot_2"].tolist()[:2] == [9, 5]
    assert env.state()[:2].tolist() == [15, 18]


def test_pictures_have_robots_targets_zone_and_obstacles():
    doorway, scale = find_scenario("5-doorway"), 12
    env = envs.parallel_env("2", render_mode="ansi")
    env.reset(options={"starts": [[0, 29], [3, 0]]})
    lines = env.render().splitlines()
    assert [len(line) for line in lines] == [30] * 30
    assert (lines[0][0], lines[29][3]) == ("1", "2")
    assert (lines[29 - 18][15], lines[29 - 12][15]) == ("a", "b")
    assert sum(line.count(":") for line in lines) == 47
    env = envs.parallel_env(doorway, render_mode="ansi")
    env.reset(seed=0)
    lines = env.render().splitlines()[::-1]
    dark = {(x, y) for y, line in enumerate(lines) for x, cell in enumerate(line) if cell == "#"}
    assert dark == set(doorway.obstacles)
    env = envs.parallel_env("2", render_mode="rgb_array")
    env.reset(options={"starts": [[5, 29], [3, 0]]})
    picture = env.render()
    assert picture.shape == (360, 360, 3)
    top_left = picture[: 4 * scale, 2 * scale : 9 * scale].reshape(-1, 3)
    assert len(np.unique(top_left, axis=0)) > 2
    assert (picture[11 * scale + 5, 15 * scale + 5] == (0, 114, 178)).all()
    env = envs.parallel_env(doorway, render_mode="rgb_array")
    env.reset(seed=0)
    middles = env.render()[::-1][scale // 2 :: scale, scale // 2 :: scale]
    rows, columns = np.nonzero((middles == 90).all(axis=2))
    assert set(zip(columns.tolist(), rows.tolist(), strict=True)) == set(doorway.obstacles)


def test_cosim_has_the_same_interface():
    env = gym.make("MiniRobots/CoSim-v0", render_mode="rgb_array", decision="period")
    check_env(env.unwrapped, skip_render_check=True)
    observation, _ = env.reset(seed=3, options={"starts": [[15, 29]]})
    assert observation.tolist() == [15, 29]
    for _ in range(4):
        observation, reward, _, _, info = env.step(6)
        assert reward == -1.0  # a cell takes some steps of 2 s, each of which costs 1
        assert info["path_length"] > 0.1
    assert observation[0] == 15
    assert 26 <= observation[1] < 29
    picture: Any = env.render()
    assert picture.shape == (360, 360, 3)
    env.close()


WALL = Scenario("wall", "", ((8, 14),), (((8, 5),),), obstacles=tuple((x, 9) for x in range(4, 12)))
ROW = Scenario("row", "", ((5, 20), (11, 20), (25, 20)), (((5, 5),), ((11, 5),), ((25, 5),)))


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


@pytest.mark.long
@pytest.mark.parametrize("cosim", [False, True])
def test_a_bystander_of_a_collision_is_truncated_without_penalty(cosim):
    env = envs.parallel_env(ROW, cosim=cosim)
    assert env.reset(seed=0)[0]["robot_1"].tolist() == [5, 5, 0, 1]
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

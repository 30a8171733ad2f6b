"""Copies, saved states and closed environments: the same bits, or a refusal."""

import copy
import multiprocessing
import pickle
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.wrappers.vector import RecordEpisodeStatistics

from agent import envs
from agent.envs.drive import DriveEnv, DriveVectorEnv
from agent.envs.dynamics import CoSimBoards
from agent.envs.vector import RobotsVectorEnv
from agent.mdp.config import ProcessConfig
from cosim.base.arguments import ConfigError
from cosim.base.errors import UserError
from cosim.fmi.fmu import FmuError
from cosim.model.outcome import TIMEOUT
from cosim.model.scenario import Scenario

MAKERS = {
    "single grid": lambda: envs.NavigationEnv("1a", ProcessConfig(slip_probability=0.3)),
    "single dynamics": lambda: envs.NavigationEnv("1a", cosim=True),
    "vector grid": lambda: gym.make_vec("MiniRobots/SingleB-v0", num_envs=3).unwrapped,
    "pairs grid": lambda: gym.make_vec("MiniRobots/Pair-v0", num_envs=2).unwrapped,
    "pairs dynamics": lambda: gym.make_vec("MiniRobots/CoSimPair-v0", num_envs=1).unwrapped,
    "parallel grid": lambda: envs.parallel_env("2"),
    "drive": lambda: DriveEnv(observe="estimated", context=True),
    "drive vector": lambda: DriveVectorEnv(2, "2", worlds=envs.ROBUST_WORLDS),
}


def step(env, action=2):
    """One step in which every robot goes in a direction; what it returned, comparable."""
    if isinstance(env, DriveEnv | DriveVectorEnv):
        actions = np.full_like(env.action_space.sample(), action / 4.0 - 0.5)
    elif isinstance(env, gym.vector.VectorEnv):
        actions = np.full(env.num_envs, action)
    elif hasattr(env, "possible_agents"):
        actions = dict.fromkeys(env.agents, action)
    else:
        actions = action
    return repr(env.step(actions))  # pyright: ignore[reportArgumentType]


def begin(env):
    """Robots in the middle of their boards."""
    if isinstance(env, DriveEnv | DriveVectorEnv):
        env.reset(seed=3)
        return
    robots, boards = len(getattr(env, "possible_agents", [0])), 0
    if isinstance(env, RobotsVectorEnv):
        robots, boards = env.scenario.robots, env.boards
    starts = np.array([[5, 20], [25, 9]])[:robots]
    env.reset(seed=3, options={"starts": np.stack([starts] * boards) if boards else starts})


@pytest.mark.long
@pytest.mark.parametrize("name", MAKERS)
def test_copies_pickles_and_restored_states_go_on_with_the_same_bits(name):
    env = MAKERS[name]()
    begin(env)
    step(env)
    saved = pickle.loads(pickle.dumps(env.get_state()))
    twins = [copy.deepcopy(env), pickle.loads(pickle.dumps(env))]
    expected = [step(env, k) for k in (3, 4, 3)]
    env.set_state(saved)
    for twin in (env, *twins):
        assert [step(twin, k) for k in (3, 4, 3)] == expected
        twin.close()
    assert len(set(expected)) == 3  # they move


@pytest.mark.parametrize("name", MAKERS)
def test_a_closed_environment_is_not_used_but_can_be_reset(name):
    env = MAKERS[name]()
    first = repr(env.reset(seed=1))
    env.close()
    env.close()
    with pytest.raises(ConfigError, match="closed; call reset"):
        step(env)
    for method in (env.get_state, getattr(env, "render", env.get_state)):
        with pytest.raises(ConfigError, match="closed; call reset"):
            method()
    assert repr(env.reset(seed=1)) == first
    step(env)
    env.close()


@pytest.mark.parametrize(
    ("make", "other"),
    [
        (envs.NavigationEnv, {"scenario": "1b"}),
        (envs.NavigationEnv, {"process": ProcessConfig(slip_probability=0.3)}),
        (partial(envs.NavigationEnv, cosim=True), {"speed": 2.0}),
        (DriveEnv, {"observe": "estimated"}),
        (DriveEnv, {"control_interval": 0.2}),
        (lambda boards=2: RobotsVectorEnv(boards, "2"), {"boards": 3}),
        (lambda scenario="2": RobotsVectorEnv(2, scenario), {"scenario": "4-cross"}),
    ],
)
def test_states_of_environments_with_other_options_are_refused(make, other):
    env, different = make(), make(**other)
    different.reset(seed=0)
    env.reset(seed=0)
    before = env._seen()
    said = r"with this scenario and these options|\d boards of \d robots does not fit 2 of 2"
    with pytest.raises(ConfigError, match=said):
        env.set_state(different.get_state())
    assert np.array_equal(env._seen(), before)
    env.close()
    different.close()


def test_an_fmu_that_cannot_save_its_state_is_named(monkeypatch):
    env = MAKERS["single dynamics"]()
    env.reset(seed=0)
    motor = env._boards._batch._motors.array
    monkeypatch.setattr(motor.fmu.interface, "canSerializeFMUstate", False)
    with pytest.raises(FmuError, match=r"fmu cannot save its state.*canSerializeFMUState"):
        copy.deepcopy(env)
    env.close()


def first_step(seed):
    env = gym.make("MiniRobots/CoSim-v0")
    env.reset(seed=seed)
    return env.step(2)[0].tolist()


@pytest.mark.parametrize(
    "method",
    ["fork", *(pytest.param(name, marks=pytest.mark.long) for name in ("spawn", "forkserver"))],
)
def test_environments_work_in_processes(method):
    expected = first_step(5)  # kernels, FMU and locks are in use before the fork
    with multiprocessing.get_context(method).Pool(1) as pool:
        assert pool.map(first_step, [5]) == [expected]


def test_environments_work_in_forked_vectors_and_threads():
    expected = first_step(5)
    with ThreadPoolExecutor(2) as pool:
        assert list(pool.map(first_step, [5, 5])) == [expected] * 2
    env = gym.make_vec("MiniRobots/CoSim-v0", 1, "async", vector_kwargs={"context": "fork"})
    env.reset(seed=5)
    assert env.step(np.array([2]))[0].tolist() == [expected]
    env.close()


def test_a_row_of_a_pair_ends_once_per_episode_and_has_a_picture():
    starts = np.array([[[15, 20], [3, 3]]])
    env = gym.make_vec(
        "MiniRobots/Pair-v0",
        num_envs=1,
        process=ProcessConfig(step_limit=6),
        render_mode="rgb_array",
    )
    env = RecordEpisodeStatistics(env)
    env.reset(options={"starts": starts})
    pictures = env.render()
    assert pictures is not None
    assert len(pictures) == env.num_envs
    lengths = []
    for _ in range(14):  # two episodes of 6, of which the first robot arrives after one or two
        *_, ends, cuts, infos = env.step(np.array([6, 2]))
        if "episode" in infos:
            lengths.append(infos["episode"]["l"].tolist())
            assert (ends | cuts).all()
        else:
            assert not (ends | cuts).any()
    env.close()
    assert all(row == [row[0]] * 2 for row in lengths)
    assert len(lengths) >= 2
    assert lengths[0] == [6, 6]


def test_an_action_of_the_dynamics_counts_whatever_it_is():
    """A robot under way took no notice of every second action."""
    seen = {}
    for second in (6, 2):
        env = gym.make("MiniRobots/CoSim-v0", time_limit=20.0)
        env.reset(seed=0, options={"starts": [[15, 25]]})
        rows = [env.step(action) for action in (6, second)]
        assert all(row[4]["active"] for row in rows)
        assert rows[0][1] == -2.0  # RL steps that the move took
        seen[second] = rows[-1][0].tolist()
        env.close()
    assert seen == {6: [15, 23], 2: [15, 25]}


def test_physics_are_options_of_environments():
    env = envs.parallel_env("1a", cosim=True, decision="period", time_limit=2.0)
    boards = env._boards
    assert isinstance(boards, CoSimBoards)
    env.reset(seed=0, options={"mu": 0.3, "targets": [[3, 3]]})
    running = boards._episodes()[0]
    assert (running.config.robot.mu, running.scenario.targets) == (0.3, ((3, 3),))
    *_, truncated, infos = env.step({"robot_1": 0})
    assert (truncated["robot_1"], infos["robot_1"]["outcome"]) == (True, TIMEOUT)
    env.reset(seed=0)
    assert boards._episodes()[0].config.robot.mu == 0.15
    env.close()
    with pytest.raises(
        ConfigError, match=r"option friction is unknown; choose one of world, worlds, .* mu,"
    ):
        gym.make("MiniRobots/CoSim-v0", friction=0.2)
    makers: Any = gym.make, gym.make_vec
    for make in makers:
        for name, value in (("mu", 0.2), ("decision", "period")):
            with pytest.raises(ConfigError, match=f"{name} has no effect on the grid"):
                make("MiniRobots/SingleA-v0", **{name: value})
    with pytest.raises(ConfigError, match=r"decision = arrival .*"):
        gym.make_vec("MiniRobots/CoSim-v0", decision="arrival")


def test_worlds_are_drawn_with_the_seed():
    env = RobotsVectorEnv(2, "1a", cosim=True, worlds=envs.WorldRange(mu=(0.1, 0.12)))
    boards: Any = env._boards

    def drawn(seed):
        env.reset(seed=seed)
        return [episode.config for episode in boards._batch.episodes]

    first = drawn(0)
    assert first == drawn(0)
    assert first[0] != first[1]
    assert all(0.1 <= config.robot.mu <= 0.12 for config in first)
    env.close()
    with pytest.raises(UserError, match=r"give agent\.envs\.WorldRange"):
        RobotsVectorEnv(1, "1a", cosim=True, worlds={"mu": (0.1, 0.2)})


def test_a_shield_is_for_the_world_that_it_was_measured_in():
    with pytest.raises(UserError, match=r"shield is measured in one world.* leave out worlds"):
        RobotsVectorEnv(1, "1a", cosim=True, shield=True, worlds=envs.WorldRange(mu=(0.1, 0.12)))
    env = RobotsVectorEnv(1, "1a", cosim=True, shield=True)
    with pytest.raises(UserError, match="shield is measured on one floor"):
        env.reset(options={"mu": [0.1]})
    env.close()


@pytest.mark.parametrize("make", [gym.make, lambda *a, **k: gym.make_vec(*a, num_envs=1, **k)])
def test_time_limits_are_those_of_gymnasium(make):
    env = make("MiniRobots/SingleA-v0", max_episode_steps=3)
    many = isinstance(env, gym.vector.VectorEnv)
    env.reset(options={"starts": [[[9, 9]]] if many else [[9, 9]]})
    cut = [env.step(np.array([0]) if many else 0)[3] for _ in range(3)]
    assert [bool(one) for one in cut] == [False, False, True]
    assert gym.spec("MiniRobots/CoSim-v0").max_episode_steps == 300


def test_environments_can_be_made_again():
    env = gym.make("MiniRobots/SingleA-v0")
    assert env.spec is not None
    again = gym.make(EnvSpec.from_json(env.spec.to_json()))
    assert again.observation_space == env.observation_space
    assert again.reset(seed=4)[0].tolist() == env.reset(seed=4)[0].tolist()


@pytest.mark.parametrize("cosim", [False, True])
def test_starts_that_all_touch_are_refused(cosim):
    touching = Scenario("touching", "", ((5, 5), (20, 20)), (((9, 9),), ((10, 9),)))
    with pytest.raises((UserError, ConfigError), match="hardly any combination of starts"):
        envs.parallel_env(touching, cosim=cosim).reset(seed=0)


@pytest.mark.parametrize("name", ["CoSim", "Drive"])
@pytest.mark.parametrize("make", [gym.make, gym.make_vec])
def test_environments_are_in_the_world_of_a_scenario_file(make, name, tmp_path):
    path = tmp_path / "rough.toml"
    path.write_text('[[robots]]\ntarget = [15, 18]\nstarts = "top"\n[world]\nmu = 0.2\n')
    env = make(f"MiniRobots/{name}-v0", scenario=str(path))
    env.reset(seed=0)
    boards: Any = env.unwrapped._boards
    assert boards._episodes()[0].config.robot.mu == 0.2
    env.close()
    with pytest.raises(UserError, match="world"):
        make("MiniRobots/SingleA-v0", scenario=str(path))


@pytest.mark.parametrize("name", ["CoSim", "Drive"])
def test_a_picture_needs_an_episode(name):
    env = gym.make_vec(f"MiniRobots/{name}-v0", render_mode="rgb_array")
    with pytest.raises(UserError, match=r"no episode has begun; call reset"):
        env.render()
    env.close()

"""Copies, saved states, closed environments and processes; options of the dynamics."""

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

from agent import envs
from agent.envs.drive import DriveEnv, DriveVectorEnv
from agent.envs.navigation import RobotsVectorEnv
from agent.mdp.config import ProcessConfig
from cosim.base.arguments import ConfigError
from cosim.base.errors import UserError
from cosim.fmi.fmu import FmuError
from cosim.model.config import CoSimConfig
from cosim.model.outcome import RUNNING, TIMEOUT
from cosim.model.scenario import Scenario
from cosim.model.scenario_file import find_scenario
from cosim.simulation.batch import Batch
from tests.alone import edited

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
both = pytest.mark.parametrize("make", [gym.make, partial(gym.make_vec, num_envs=1)])


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
def test_copies_pickles_and_restored_states_continue_with_the_same_bits(name):
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


def test_a_state_has_the_agents_that_remain():
    env = envs.parallel_env("2")
    env.reset(options={"starts": [[15, 19], [5, 5]]})
    begun = env.get_state()
    env.step({"robot_1": 6, "robot_2": 0})
    arrived = env.get_state()
    for state, agents in ((begun, ["robot_1", "robot_2"]), (arrived, ["robot_2"])):
        env.set_state(state)
        assert env.agents == agents


@pytest.mark.parametrize("name", MAKERS)
def test_a_closed_environment_is_not_used_but_can_be_reset(name):
    env = MAKERS[name]()
    first = repr(env.reset(seed=1))
    env.close()
    env.close()
    for use in (partial(step, env), env.get_state, partial(env.set_state, {}), env.render):
        with pytest.raises(ConfigError, match="closed; call reset"):
            use()
    assert repr(env.reset(seed=1)) == first
    step(env)
    env.close()


@pytest.mark.parametrize(
    ("make", "other", "words"),
    [
        (envs.NavigationEnv, {"scenario": "1b"}, "this scenario and these options"),
        (envs.NavigationEnv, {"process": ProcessConfig(slip_probability=0.3)}, "these options"),
        (partial(envs.NavigationEnv, cosim=True), {"speed": 2.0}, "these options"),
        (DriveEnv, {"observe": "estimated"}, "these options"),
        (DriveEnv, {"control_interval": 0.2}, "these options"),
        (lambda boards=2: RobotsVectorEnv(boards, "2"), {"boards": 3}, "3 boards .* not fit 2"),
        (lambda boards=2: DriveVectorEnv(boards), {"boards": 3}, "3 boards .* not fit 2"),
        (lambda scenario="2": RobotsVectorEnv(2, scenario), {"scenario": "4-cross"}, "of 4 robots"),
    ],
)
def test_states_of_environments_with_other_options_are_refused(make, other, words):
    env, twin, different = make(), make(), make(**other)
    for each in (env, twin, different):
        each.reset(seed=0)
    with pytest.raises(ConfigError, match=words):
        env.set_state(different.get_state())
    for state in ({}, None):
        with pytest.raises(ConfigError, match="not a state of this kind"):
            env.set_state(state)
    assert step(env) == step(twin)
    for each in (env, twin, different):
        each.close()


def test_an_fmu_that_cannot_save_its_state_is_named(array_fmu, tmp_path):
    able = b'canSerializeFMUState="true"'
    path = tmp_path / "stateless.fmu"
    edited(array_fmu, path, lambda _, content: content.replace(able, b""))
    batch = Batch(path, CoSimConfig(), 1, 1)
    batch.begin(0, find_scenario("1a"), ((5, 5),), np.random.SeedSequence(0))
    with pytest.raises(FmuError, match=r"stateless.fmu cannot save .*canSerializeFMUState"):
        copy.deepcopy(batch)
    batch.close()


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


def test_an_action_of_the_dynamics_counts_whatever_it_is():
    """A robot under way took no notice of every second action."""
    cells = {}
    for second in (6, 2):
        env = gym.make("MiniRobots/CoSim-v0", time_limit=20.0)
        env.reset(seed=0, options={"starts": [[15, 25]]})
        rows = [env.step(action) for action in (6, second)]
        assert all(row[4]["active"] for row in rows)
        assert rows[0][1] == -2.0  # RL steps that the move took
        cells[second] = rows[-1][0].tolist()
        env.close()
    assert cells == {6: [15, 23], 2: [15, 25]}


def test_physics_are_options_of_environments():
    options: Any = {"decision": "period", "time_limit": 4.0, "render_mode": "ansi"}
    env = envs.parallel_env("1a", cosim=True, **options)
    lengths_cm = []
    for episode in ({}, {"mu": 0.3, "targets": [[3, 3]]}, {}):
        env.reset(seed=0, options={"starts": [[9, 9]], **episode})
        assert (env.render().splitlines()[29 - 3][3] == "a") == bool(episode)
        assert not any(env.step({"robot_1": 0})[3].values())
        *_, truncated, infos = env.step({"robot_1": 0})
        assert (truncated["robot_1"], infos["robot_1"]["outcome"]) == (True, TIMEOUT)
        lengths_cm.append(infos["robot_1"]["path_length"])
    assert lengths_cm[0] == lengths_cm[2] != lengths_cm[1]  # for one episode alone
    env.close()


@both
def test_unusable_options_are_refused(make):
    for name, options, words in (
        ("CoSim", {"friction": 0.2}, "friction is unknown; choose one of worlds, .* mu, .* world,"),
        ("SingleA", {"mu": 0.2}, "mu has no effect on the grid"),
        ("SingleA", {"decision": "period"}, "decision has no effect on the grid"),
        ("CoSim", {"worlds": {"mu": (0.1, 0.2)}}, r"give agent\.envs\.WorldRange"),
    ):
        with pytest.raises(UserError, match=words):
            make(f"MiniRobots/{name}-v0", **options)
    with pytest.raises(ConfigError, match=r"decision = arrival .*"):
        gym.make_vec("MiniRobots/CoSim-v0", decision="arrival")


def test_worlds_are_drawn_with_the_seed():
    env = RobotsVectorEnv(2, "1a", cosim=True, worlds=envs.WorldRange(mu=(0.1, 0.26)))

    def lengths_cm(seed):
        env.reset(seed=seed, options={"starts": [[[9, 9]], [[9, 9]]]})
        return env.step(np.array([0, 0]))[4]["path_length"].tolist()

    first = lengths_cm(0)
    assert first == lengths_cm(0)
    assert len({*first, *lengths_cm(7)}) == 4
    env.close()


def test_a_shield_is_for_the_world_that_it_was_measured_in():
    with pytest.raises(UserError, match=r"shield is measured in one world.* leave out worlds"):
        RobotsVectorEnv(1, "1a", cosim=True, shield=True, worlds=envs.WorldRange(mu=(0.1, 0.12)))
    env = RobotsVectorEnv(1, "1a", cosim=True, shield=True)
    with pytest.raises(UserError, match="shield is measured on one floor"):
        env.reset(options={"mu": [0.1]})
    env.close()


@both
@pytest.mark.parametrize(
    "limit", [{"max_episode_steps": 3}, {"process": ProcessConfig(step_limit=3)}]
)
def test_limits_of_steps_truncate(make, limit):
    env = make("MiniRobots/SingleA-v0", **limit)
    many = isinstance(env, gym.vector.VectorEnv)
    env.reset(options={"starts": [[[9, 9]]] if many else [[9, 9]]})
    steps = [env.step(np.array([0]) if many else 0) for _ in range(3)]
    assert [(bool(row[2]), bool(row[3])) for row in steps] == [(False, False)] * 2 + [(False, True)]
    ended = {"outcome": TIMEOUT, "is_success": False, "active": False, "path_length": 3.0}
    if "process" not in limit:  # which cuts, and is no outcome
        ended |= {"outcome": RUNNING, "active": True}
    assert {name: np.ravel(steps[-1][4][name])[0] for name in ended} == pytest.approx(ended)
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
    with pytest.raises(UserError, match="hardly any combination of starts"):
        envs.parallel_env(touching, cosim=cosim).reset(seed=0)


@both
def test_environments_are_in_the_world_of_a_scenario_file(make, tmp_path):
    path = tmp_path / "rough.toml"
    path.write_text('[[robots]]\ntarget = [15, 18]\nstarts = "top"\n[world]\nmu = 0.2\n')
    drive = make("MiniRobots/Drive-v0", scenario=str(path), context=True)
    assert np.ravel(drive.reset(seed=0)[0])[13] == pytest.approx(0.2)
    drive.close()
    steps = []
    for options in ({"scenario": str(path)}, {"mu": 0.2}, {}):
        env = make("MiniRobots/CoSim-v0", **options)
        env.reset(seed=0)
        steps.append(step(env))
        env.close()
    assert steps[0] == steps[1] != steps[2]
    with pytest.raises(UserError, match="world"):
        make("MiniRobots/SingleA-v0", scenario=str(path))


@pytest.mark.parametrize("name", ["CoSim", "Drive"])
def test_a_picture_needs_an_episode(name):
    env = gym.make_vec(f"MiniRobots/{name}-v0", render_mode="rgb_array")
    with pytest.raises(UserError, match=r"no episode has begun; call reset"):
        env.render()
    env.close()

"""Systems of FMUs as environments: the interface, the same bits, refusals, and a controller."""

from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.wrappers.vector import RecordEpisodeStatistics

import minirobots as mr
from cosim.fmi.fmu import FmuError
from cosim.system.env import SystemEnv, SystemVectorEnv
from cosim.system.graph import Component, Connection, GraphError
from cosim.system.system import System

SEEN = ("first.x", "first.v", "second.x", "second.v")


@pytest.fixture(scope="module")
def masses(small):
    """A mass that is pushed, and one that hangs on it by a spring."""
    first = Component("first", small("oscillator"), {"k": 10.0, "x": 0.0})
    second = Component("second", small("oscillator", 2), {"k": 50.0, "k_c": 50.0, "x": 1.0})
    return [first, second], [Connection("first.x", "second.x_in")]


def rest(before, action, after):
    return -float(after[2] ** 2 + 0.1 * after[3] ** 2)


def make(masses, kind: Any = SystemEnv, *arguments, **options) -> Any:
    given = {"actions": {"first.F_in": (-50.0, 50.0)}, "observations": SEEN, "reward": rest}
    return kind(*arguments, masses, **{**given, "step": 0.05, "duration": 3.0, **options})


def returns(env, gains, seed=0):
    seen, total, ended = env.reset(seed=seed)[0], 0.0, False
    while not ended:
        seen, reward, terminated, truncated, _ = env.step([float(gains @ seen)])
        total, ended = total + reward, terminated or truncated
    return total


def test_steps_are_those_of_the_master(masses):
    env = make(masses)
    check_env(env, skip_render_check=True)
    env.reset(seed=0)
    seen = [env.step([force])[0] for force in (3.0, -2.0)]
    times = [0.0, 0.05, 0.05, 0.1]
    with System(*masses, inputs={"first.F_in": (times, [3.0, 3.0, -2.0, -2.0])}) as system:
        run = system.run(0.1, progress=None)
    rows = np.array([run.signals[name] for name in SEEN], dtype=np.float32).T
    assert np.array_equal(seen, rows[[50, 100]])
    env.close()


def test_a_reset_restores_every_bit_and_parameters_are_drawn(masses):
    env = make(masses)
    first = returns(env, np.array([0.0, -5.0, 0.0, 0.0]))
    assert returns(env, np.array([0.0, -5.0, 0.0, 0.0])) == first
    env.close()
    drawn = make(masses, parameters={"second.k": (40.0, 60.0)})
    spread = [returns(drawn, np.zeros(4), seed) for seed in (1, 2, 1)]
    assert spread[0] == spread[2] != spread[1]
    given = drawn.reset(seed=1, options={"parameters": {"second.k": 50.0}})[1]
    assert given["parameters"] == {"second.k": 50.0}
    drawn.close()
    one = make(masses)
    usual = returns(one, np.zeros(4))
    one.reset(options={"parameters": {"second.k": 60.0}})
    assert returns(one, np.zeros(4)) == usual  # nothing is left of the episode before
    one.close()


def test_without_saved_states_systems_are_made_again(small):
    stateless = Component("plant", small("dahlquist", 2, able=False))
    options = {"actions": {"plant.u": (0.0, 1.0)}, "observations": ["plant.x"], "step": 0.1}
    env = SystemEnv(([stateless], []), reward="plant.x", duration=0.3, **options)
    runs = []
    for _ in range(2):
        env.reset()
        runs.append([env.step([1.0])[:4] for _ in range(3)])
    assert runs[0] == runs[1]
    assert [row[1] for row in runs[0]] == [float(row[0][0]) for row in runs[0]]
    assert runs[0][-1][2:] == (False, True)
    with pytest.raises(GraphError, match="no episode is running"):
        env.step([1.0])
    env.close()


def test_rows_in_threads_have_the_bits_of_single_environments(masses):
    rows = make(masses, SystemVectorEnv, 3, duration=0.1, parameters={"first.k": (5.0, 15.0)})
    single = [make(masses, duration=0.1, parameters={"first.k": (5.0, 15.0)}) for _ in range(3)]
    seen, _ = rows.reset(seed=4)
    assert np.array_equal(seen, [env.reset(seed=4 + k)[0] for k, env in enumerate(single)])
    for _ in range(5):
        actions = np.array([[1.0], [2.0], [3.0]])
        seen, _, _, truncated, _ = rows.step(actions)
        for k, env in enumerate(single):
            alone = env.step(actions[k]) if env._running else (env.reset()[0],)
            assert np.array_equal(alone[0], seen[k])
            assert truncated[k] == (len(alone) > 1 and alone[3])
    assert all(env.close() is None for env in single)
    counted = RecordEpisodeStatistics(rows)
    counted.reset(seed=0)
    ends = [counted.step(np.zeros((3, 1)))[4] for _ in range(5)]
    assert [info["episode"]["l"].max() for info in ends if "episode" in info] == [2, 2]
    rows.close()


def test_what_fails_ends_an_episode_and_the_next_one_is_whole(small):
    failing = Component("plant", small("dahlquist"), {"fails_at": 0.15})
    options = {"actions": {"plant.u": (0.0, 1.0)}, "observations": ["plant.x"], "step": 0.1}
    env = SystemEnv(([failing], []), reward="plant.x", **options)
    seen, _ = env.reset()
    env.step([0.0])
    with pytest.raises(FmuError, match="plant"):
        env.step([0.0])
    assert np.array_equal(env.reset()[0], seen)
    stair = SystemEnv(
        ([Component("stair", small("stair"))], []),
        actions=[], observations=["stair.counter"], reward="stair.counter", step=1.0, step_s=1.0,
    )  # fmt: skip
    stair.reset()
    ends = [stair.step([])[2] for _ in range(9)]
    assert ends == [False] * 8 + [True]


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"actions": ["first.F_in"]}, "first.F_in: its FMU declares no min and max"),
        ({"actions": {"first.F_in": (1.0, -1.0)}}, "the lower one first"),
        ({"actions": {"first.F_in": 1.0}}, "bounds of first.F_in = 1.0 is invalid"),
        ({"actions": {"second.x_in": (0.0, 1.0)}}, "second.x_in is set by a connection"),
        ({"actions": {"first.m": (0.0, 1.0)}}, "first.m is of causality parameter"),
        ({"observations": ["first.y"]}, "first has no variable 'y'"),
        ({"parameters": {"first.y": (0.0, 1.0)}}, "first has no variable 'y'"),
        ({"step": 0.0505}, "step = 0.0505 s is not a whole multiple"),
        ({"step": np.nan}, "step nan: choose one above 0"),
        ({"step": "fast"}, "step = 'fast' is invalid"),
        ({"actions": {"first.F_in": (0.0, 1e39)}}, "must be finite"),
        ({"actions": [1]}, r"actions = \[1\] is invalid: expected str"),
        ({"observations": [1]}, r"observations = \[1\] is invalid: expected str"),
        ({"parameters": {"first.F_in": (0.0, 1.0)}}, "parameter first.F_in has no effect"),
        ({"reward": None}, "give a function or a variable as reward"),
        ({"algorithm": "euler"}, "algorithm = 'euler' is unknown; choose one of jacobi"),
        ({"loops": "solved"}, "loops = 'solved' is unknown; choose one of solve, explicit"),
        ({"step_control": "power"}, "step_control = 'power' is unknown"),
        ({"fmu_log": "none"}, "fmu_log = 'none' is unknown"),
        ({"longest_step_s": 0.1}, "longest step 0.1 has no effect without a tolerance"),
        ({"inputs": {}}, "inputs is not for environments"),
        ({"parameters": ["first.m"]}, r"parameters = \['first.m'\] is invalid: expected object"),
    ],
)
def test_what_does_not_fit_is_refused(masses, options, said):
    with pytest.raises(mr.UserError, match=said):
        make(masses, **options)


def test_what_is_no_system_and_no_option_of_a_reset_is_named(masses):
    components, connections = masses
    for system, said in (
        (None, "system = None: give a file"),
        ((components[0], []), r"components = .* give a list of Component"),
        ((components, ["first.x"]), r"connections = \['first.x'\]: give a list of Connection"),
        (([components[0]._replace(fmu=5)], []), "component first: fmu = 5 is invalid"),
    ):
        with pytest.raises(mr.UserError, match=said):
            make(system)
    text = [part._replace(fmu=str(getattr(part.fmu, "path", part.fmu))) for part in components]
    env = make((text, connections), reward=lambda before, action, after: None)
    for options, said in (
        (["a"], "options = .* is invalid: expected object"),
        ({1: 2}, "options = .* is invalid: expected str"),
    ):
        with pytest.raises(mr.UserError, match=said):
            env.reset(options=options)
    env.reset()
    with pytest.raises(mr.UserError, match="reward = None: return a finite number"):
        env.step([1.0])


def test_what_is_done_to_an_observation_does_not_change_rewards(masses):
    env = make(masses, reward=lambda before, action, after: float(before[2] - after[2]))
    twin = make(masses, reward=lambda before, action, after: float(before[2] - after[2]))
    env.reset()[0][:] = 9.0
    twin.reset()
    for _ in range(2):
        seen, reward, *_ = env.step([1.0])
        assert reward == twin.step([1.0])[1]
        seen[:] = 9.0


def test_environments_and_threads_are_counted_from_1(masses):
    for options in ({"threads": 0}, {"threads": "2"}, {"num_envs": 2.5}, {"num_envs": 0}):
        with pytest.raises(mr.UserError, match=f"{next(iter(options))} = "):
            SystemVectorEnv(**{"num_envs": 2, "system": masses, **options})


def test_unusable_actions_are_refused(masses):
    env = make(masses)
    env.reset()
    for action in (None, [np.nan], [1.0, 2.0], "x", [[1.0]], [[1.0], [1.0, 2.0]]):
        with pytest.raises(GraphError, match="give 1 finite numbers"):
            env.step(action)
    with pytest.raises(GraphError, match="reset has no option mu"):
        env.reset(options={"mu": 1.0})
    rows = make(masses, SystemVectorEnv, 2)
    rows.reset(seed=np.int64(0))
    for action in ([[1.0]], [[1.0]] * 3, 1.0, [[1.0], [1.0, 2.0]], [[1.0], [np.nan]]):
        with pytest.raises(GraphError, match="give a row to each of 2 instances"):
            rows.step(action)
    assert [env._steps for env in rows.envs] == [0, 0]
    with pytest.raises(GraphError, match="3 seeds: give one to each of 2 instances"):
        rows.reset(seed=[1, 2, 3])
    rows.close()


def test_a_controller_learns_to_calm_the_second_mass(masses):
    """Cross-entropy search over linear controllers, on parallel instances."""
    rows = make(masses, SystemVectorEnv, 16)
    assert isinstance(rows, gym.vector.VectorEnv)
    rng = np.random.default_rng(0)
    mean, spread = np.zeros(4), np.full(4, 20.0)
    for _ in range(6):
        gains = mean + spread * rng.standard_normal((16, 4))
        seen, _ = rows.reset(seed=0)
        totals, cut = np.zeros(16), np.zeros(16, dtype=bool)
        while not cut.all():
            seen, rewards, _, cut, _ = rows.step((gains * seen).sum(axis=1, keepdims=True))
            totals += rewards
        best = gains[np.argsort(totals)[-4:]]
        mean, spread = best.mean(axis=0), best.std(axis=0)
    rows.close()
    env = make(masses)
    assert returns(env, mean) > 0.6 * returns(env, np.zeros(4))  # less than 0.6 of the squares
    env.close()

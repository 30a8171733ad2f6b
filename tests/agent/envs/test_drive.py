"""The control-level environment: bits, bounds, rewards, and a controller that plans with it."""

import copy
import math
import pickle
from functools import partial
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import agent.envs
from agent.envs.drive import DriveBoards, DriveEnv, DriveVectorEnv
from agent.envs.vector import RobotsVectorEnv
from cosim.base.arguments import ConfigError
from cosim.base.errors import UserError
from cosim.model.config import CoSimConfig
from cosim.model.outcome import OUT_OF_BOARD, SUCCESS, TIMEOUT

AHEAD = np.array([1.0, 0.0])
driven_rows = partial(RobotsVectorEnv, scenario="1a", cosim=True)  # as of `CoSim-v0`


def test_rows_have_the_bits_of_the_single_environment_and_of_a_restored_one():
    env = gym.make("MiniRobots/Drive-v0").unwrapped
    check_env(env, skip_render_check=True)
    many = gym.make_vec("MiniRobots/Drive-v0", num_envs=2).unwrapped
    assert isinstance(env, DriveEnv)
    assert isinstance(many, DriveVectorEnv)
    one, both = env.reset(seed=4)[0], many.reset(seed=4)[0]
    assert one in env.observation_space
    assert np.array_equal(one, both[0])
    saved = many.get_state()
    random = np.random.default_rng(0)
    actions = random.uniform(-1.0, 1.0, (5, 2, 2))
    rows = [many.step(action) for action in actions]
    for action, row in zip(actions, rows, strict=True):
        seen, reward, *_ = env.step(action[0])
        assert np.array_equal(seen, row[0][0])
        assert reward == row[1][0]
    many.set_state(saved)
    again = [many.step(action) for action in actions]
    assert all(np.array_equal(a[0], b[0]) for a, b in zip(rows, again, strict=True))
    assert not np.array_equal(rows[0][0], rows[-1][0])
    env.close()
    many.close()


def test_robots_drive_as_they_are_told_and_rewards_say_how_far():
    env = DriveEnv()
    start = {"starts": [[0.15, 0.15, 0.0]], "targets": [[0.25, 0.15]]}
    seen, _ = env.reset(seed=0, options=start)
    assert seen[:6].tolist() == pytest.approx([1.0, 0.0, 0.0, 1.0, 0.5, 0.5])
    assert seen[11:].tolist() == pytest.approx([1.0, 0.0])
    ahead = [env.step(AHEAD) for _ in range(20)]
    moved, boards = 0.1 * (1.0 - ahead[-1][0][0]), env._boards
    assert isinstance(boards, DriveBoards)
    steering = boards._config.steering
    assert moved / 2.0 == pytest.approx(steering.drive_speed_m_s, rel=0.15)
    assert sum(row[1] for row in ahead) == pytest.approx(100.0 * moved - 0.2, abs=0.05)
    env.reset(seed=0, options=start)
    turned = [env.step(np.array([0.0, 1.0])) for _ in range(20)][-1][0]
    assert math.atan2(turned[2], turned[3]) == pytest.approx(0.4, rel=0.15)
    env.close()


def test_episodes_end_at_the_target_at_the_edge_and_in_time():
    env = DriveVectorEnv(3, reward="sparse", max_episode_steps=4)
    poses = np.array([[[0.15, 0.15, 0.0]], [[0.2995, 0.1, 0.0]], [[0.1, 0.1, 0.0]]])
    targets = np.array([[[0.156, 0.15]], [[0.2, 0.1]], [[0.2, 0.1]]])
    env.reset(seed=0, options={"starts": poses, "targets": targets})
    ends = [env.step(np.array([[1.0, 0.0]] * 3)) for _ in range(4)]
    outcomes = np.array([row[4]["outcome"] for row in ends])
    assert outcomes[-1, 2] == TIMEOUT
    assert SUCCESS in outcomes[:, 0]
    assert OUT_OF_BOARD in outcomes[:, 1]
    for k, (_, rewards, terminated, truncated, infos) in enumerate(ends):
        wins = infos["is_success"]
        lost = infos["outcome"] == OUT_OF_BOARD
        assert rewards.tolist() == (1.0 * wins - lost).tolist(), k
        assert terminated.tolist() == (wins | lost).tolist()
        assert truncated.tolist() == (infos["outcome"] == TIMEOUT).tolist()
    env.close()


def test_pairs_see_each_other_and_worlds_are_observed():
    env = DriveVectorEnv(1, "2", context=True, worlds=agent.envs.ROBUST_WORLDS, observe="estimated")
    seen, _ = env.reset(seed=1)
    assert seen.shape == (2, 20)
    assert env.step(np.zeros((2, 2)))[0] in env.observation_space
    assert 0.1 <= seen[0, 15] <= 0.26
    assert np.hypot(*seen[:, 13:15].T).tolist() == pytest.approx([np.hypot(*seen[0, 13:15])] * 2)
    env.close()


@pytest.mark.parametrize("ends", ["together", "own"])
def test_a_row_of_a_pair_ends_once(ends):
    env = DriveVectorEnv(1, "2", ends=ends, max_episode_steps=3)
    starts, targets = [[[0.1, 0.1, 0.0], [0.2, 0.2, 0.0]]], [[[0.1, 0.1], [0.25, 0.2]]]
    env.reset(seed=0, options={"starts": starts, "targets": targets})
    steps = [env.step(np.zeros((2, 2))) for _ in range(4)]
    terminated, truncated = ([np.asarray(row[k]).tolist() for row in steps] for k in (2, 3))
    nothing, first, second = [False, False], [True, False], [False, True]
    assert truncated == [nothing, nothing, second, nothing]
    at_last = [nothing, nothing, first, nothing]
    assert terminated == ([first, nothing, nothing, nothing] if ends == "own" else at_last)
    env.close()


def test_a_controller_plans_with_saved_states():
    """Random shooting: of some short plans, the one that gets closest is begun."""
    env = DriveEnv(control_interval=0.5)
    env.reset(seed=0, options={"starts": [[0.15, 0.15, 0.0]], "targets": [[0.13, 0.15]]})
    random = np.random.default_rng(0)
    total = 0.0
    for _ in range(3):
        state, gains = env.get_state(), []
        plans = random.choice([-1.0, 0.0, 1.0], (4, 2))
        for plan in plans:
            gains.append(sum(env.step(plan)[1] for _ in range(2)))
            env.set_state(state)
        total += env.step(plans[int(np.argmax(gains))])[1]
    assert total > 0.05
    env.close()


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"action": "torque"}, "action"),
        ({"reward": "none"}, "reward"),
        ({"reach": -1.0}, "reach = -1.0 is invalid: expected float > 0"),
        ({"reach": "far"}, "reach = 'far' is invalid: expected float"),
        ({"control_interval": math.nan}, "control_interval = nan is invalid: expected float > 0"),
        ({"control_interval": "x"}, "control_interval = 'x' is invalid"),
        ({"control_interval": 0.00015}, "control_interval = 0.00015 s is not a whole multiple"),
        ({"context": "yes"}, "context = 'yes' is invalid: expected bool"),
        ({"max_episode_steps": 0}, "max_episode_steps = 0 is invalid: expected int >= 1"),
        ({"shield": True}, "shield has no effect where a learner drives"),
        ({"open_loop": ("heading",)}, "open_loop = heading has no effect where a learner drives"),
    ],
)
def test_unusable_options_are_refused(options, said):
    with pytest.raises(ConfigError, match=said):
        DriveEnv(**options)


@pytest.mark.parametrize("count", [0, -1, 1.5, "3", True, None])
@pytest.mark.parametrize("kind", [DriveVectorEnv, driven_rows, RobotsVectorEnv])
def test_other_numbers_of_boards_are_refused(kind, count):
    with pytest.raises(ConfigError, match="num_envs = "):
        kind(count)


@pytest.mark.parametrize(
    ("ranges", "said"),
    [
        ({"mu": 0.2}, "worlds.mu = 0.2 is invalid"),
        ({"mu": (0.3, 0.1)}, "worlds.mu = .* must be ascending"),
        ({"mu": (-1.0, 0.1)}, "world.mu = -1"),
        ({"motor_spread": ("a", 1)}, "worlds.motor_spread.* = "),
        ({"patches": -1}, "worlds.patches = -1"),
        ({"floor_tilt_deg": (0.0, 80.0)}, "floor_tilt_deg = 80"),
    ],
)
def test_ranges_that_no_world_can_have_are_refused_at_once(ranges, said):
    with pytest.raises(UserError, match=said):
        DriveEnv(worlds=agent.envs.WorldRange(**ranges))


def test_a_range_draws_what_it_names_and_nothing_else():
    with pytest.raises(TypeError, match="friction"):
        agent.envs.WorldRange(friction=(0.1, 0.2))  # pyright: ignore[reportCallIssue]
    env = DriveVectorEnv(3, worlds=agent.envs.WorldRange(mu=(0.1, 0.12)))
    env.reset(seed=0)
    boards: Any = env._boards
    configs = [episode.config for episode in boards._batch.episodes]
    assert len({config.robot.mu for config in configs}) == 3
    usual, *others = (
        [leaf.value for leaf in config.leaves().values() if leaf.path.startswith("world.")]
        for config in (CoSimConfig(), *configs)
    )
    assert others == [usual] * 3
    ranges = agent.envs.WorldRange(mu=(0.1, 0.12))
    with pytest.raises(ConfigError, match=r"worlds .* given world"):
        DriveVectorEnv(1, worlds=ranges, world={"mu": 0.2})
    assert copy.deepcopy(ranges) == pickle.loads(pickle.dumps(ranges)) == ranges
    env.close()


def test_unusable_starts_and_actions_are_refused():
    env = DriveEnv()
    with pytest.raises(ConfigError, match="no episode is running"):
        env.step(AHEAD)
    for starts in ([[0.15, 0.15]], [[0.5, 0.15, 0.0]], [[0.15, 0.15, math.nan]], "here"):
        with pytest.raises(ConfigError, match="must be of shape"):
            env.reset(options={"starts": starts})
    with pytest.raises(ConfigError, match="mu = 0 is invalid"):
        env.reset(options={"mu": 0.0})
    with pytest.raises(ConfigError, match="no option 'reset_mask'"):
        env.reset(options={"reset_mask": False})
    env.reset(seed=0)
    for action in ([1.0], [math.nan, 0.0], "ahead", [[1.0], 2.0], None):
        with pytest.raises(ConfigError, match="two finite numbers"):
            env.step(action)
    with pytest.raises(ConfigError, match="is not a state of this kind"):
        env.set_state({})
    with pytest.raises(ConfigError, match="is not a state of this kind"):
        env.set_state(None)  # pyright: ignore[reportArgumentType]
    env.close()


@pytest.mark.parametrize("kind", [DriveVectorEnv, driven_rows])
def test_a_board_at_its_limit_of_steps_begins_again_while_others_continue(kind):
    env = kind(2, max_episode_steps=2)
    env.reset(seed=0)
    actions = np.zeros_like(env.action_space.sample())
    env.step(actions)
    env.reset(options={"reset_mask": [False, True]})
    cut = [env.step(actions)[3].tolist() for _ in range(4)]
    assert cut == [[True, False], [False, True], [False, False], [True, False]]
    env.close()


@pytest.mark.parametrize("kind", [DriveVectorEnv, driven_rows])
def test_a_reset_of_some_dynamics_seeds_them_alone(kind):
    env, twin = kind(2), kind(2)
    for one in (env, twin):
        one.reset(seed=0)
    env.reset(seed=7, options={"reset_mask": [False, True]})
    assert np.array_equal(env.reset()[0][0], twin.reset()[0][0])
    env.close()
    twin.close()


@pytest.mark.parametrize("kind", [DriveVectorEnv, driven_rows])
def test_a_refused_reset_changes_nothing(kind):
    env = kind(2)
    with pytest.raises(ConfigError, match="have not begun"):
        env.reset(options={"reset_mask": [True, False]})
    before = env.reset(seed=0)[0]
    drive = kind is DriveVectorEnv
    starts = [[[0.1, 0.1, 0.0]], [[9, 9, 0]]] if drive else [[[5, 5]], [[99, 5]]]
    for options in ({"starts": starts}, {"mu": [0.2]}, {"mu": 0.2}, {"mu": [0.2, -1.0]}):
        with pytest.raises(UserError):
            env.reset(options=options)
    for seed in (1.5, [1], [1, 2.5], "ab", [1, -2]):
        with pytest.raises(ConfigError, match="seed"):
            env.reset(seed=seed)
    assert np.array_equal(env._seen(), before)
    other = kind(3)
    other.reset(seed=0)
    with pytest.raises(UserError, match=r"state of 3 boards .* does not fit 2"):
        env.set_state(other.get_state())
    assert np.array_equal(env._seen(), before)
    env.close()
    other.close()

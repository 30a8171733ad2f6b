"""The control-level environment: motions, rewards, ends, drawn worlds, and what is refused."""

import copy
import math
import pickle

import numpy as np
import pytest

import agent.envs
from agent.envs.drive import DriveEnv, DriveVectorEnv
from agent.envs.navigation import RobotsVectorEnv
from agent.moves.worlds import draw_world
from cosim.base.arguments import ConfigError
from cosim.base.errors import UserError
from cosim.model.config import CoSimConfig
from cosim.model.outcome import OUT_OF_BOARD, SUCCESS, TIMEOUT
from cosim.model.params import STEERING

AHEAD = np.array([1.0, 0.0])


def driven_rows(count, **options):
    """Rows of `CoSim-v0`."""
    return RobotsVectorEnv(count, "1a", cosim=True, **options)


def test_robots_drive_as_commanded_and_rewards_are_of_progress():
    env, speed_m_s = DriveEnv(), STEERING.drive_speed_m_s
    start = {"starts": [[0.15, 0.15, 0.0]], "targets": [[0.25, 0.15]]}
    observation, _ = env.reset(seed=0, options=start)
    assert observation[:6].tolist() == pytest.approx([1.0, 0.0, 0.0, 1.0, 0.5, 0.5])
    assert observation[11:].tolist() == pytest.approx([1.0, 0.0])
    ahead = [env.step(AHEAD) for _ in range(20)]
    moved = 0.1 * (1.0 - ahead[-1][0][0])
    assert moved / 2.0 == pytest.approx(speed_m_s, rel=0.15)
    assert sum(row[1] for row in ahead) == pytest.approx(100.0 * moved - 0.2, abs=0.05)
    env.reset(seed=0, options=start)
    turned = [env.step(np.array([0.0, 1.0])) for _ in range(20)][-1][0]
    assert math.atan2(turned[2], turned[3]) == pytest.approx(0.4, rel=0.15)
    env.close()


def test_episodes_end_at_the_target_at_the_edge_and_in_time():
    env = DriveVectorEnv(3, reward="sparse", time_limit=0.4)
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


@pytest.mark.parametrize("reward", ["dense", "sparse"])
def test_targets_are_drawn_within_reach(reward):
    for reach in (0.05, 0.12):
        env = DriveVectorEnv(40, reward=reward, reach=reach)
        rows, _ = env.reset(seed=4)
        distances_m = 0.1 * np.hypot(rows[:, 0], rows[:, 1])
        assert 0.8 * reach < distances_m.max() <= reach + 1e-6
        env.close()


def test_pairs_see_each_other_and_worlds_are_observed():
    env = DriveVectorEnv(1, "2", context=True, worlds=agent.envs.ROBUST_WORLDS, observe="estimated")
    rows, _ = env.reset(seed=1)
    assert rows.shape == (2, 20)
    assert env.step(np.zeros((2, 2)))[0] in env.observation_space
    assert 0.1 <= rows[0, 15] <= 0.26
    assert np.hypot(*rows[:, 13:15].T).tolist() == pytest.approx([np.hypot(*rows[0, 13:15])] * 2)
    env.close()


def test_robots_of_a_group_see_the_nearest_of_the_others():
    env = DriveVectorEnv(1, "4-cross")
    rows, _ = env.reset(seed=3)
    wide_m = np.array(env.scenario.size_m)
    places = rows[:, 4:6] * wide_m
    for row, place in zip(rows, places, strict=True):
        apart = places - place
        offset = min(apart[np.hypot(*apart.T) > 1e-6], key=lambda vector: np.hypot(*vector))
        sine, cosine = row[2:4]
        turned = offset @ np.array([[cosine, -sine], [sine, cosine]])
        assert 0.1 * row[-2:] == pytest.approx(turned, abs=1e-6)
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


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"action": "torque"}, "action"),
        ({"reward": "none"}, "reward"),
        ({"reach": -1.0}, "reach = -1.0 .*> 0"),
        ({"reach": "far"}, "reach = 'far' .*float"),
        ({"control_interval": math.nan}, "control_interval = nan .*> 0"),
        ({"control_interval": "x"}, "control_interval = 'x'"),
        ({"control_interval": 0.00015}, "control_interval = 0.00015 .* whole multiple"),
        ({"context": "yes"}, "context = 'yes' .*bool"),
        ({"max_episode_steps": 0}, "max_episode_steps = 0 .*>= 1"),
        ({"shield": True}, "shield has no effect"),
        ({"open_loop": ("heading",)}, "open_loop = heading has no effect"),
        ({"worlds": agent.envs.WorldRange(mu=0.2)}, "worlds.mu = 0.2"),  # pyright: ignore[reportArgumentType]
        ({"worlds": agent.envs.WorldRange(mu=(0.3, 0.1))}, "worlds.mu = .* ascending"),
        ({"worlds": agent.envs.WorldRange(mu=(-1.0, 0.1))}, "world.mu = -1"),
        ({"worlds": agent.envs.WorldRange(motor_spread=("a", 1))}, "worlds.motor_spread.* = "),  # pyright: ignore[reportArgumentType]
        ({"worlds": agent.envs.WorldRange(patches=-1)}, "worlds.patches = -1"),
        ({"worlds": agent.envs.WorldRange(floor_tilt_deg=(0.0, 80.0))}, "floor_tilt_deg = 80"),
    ],
)
def test_unusable_options_are_refused_at_once(options, words):
    with pytest.raises(UserError, match=words):
        DriveEnv(**options)


@pytest.mark.parametrize("count", [0, -1, 1.5, "3", True, None])
@pytest.mark.parametrize("kind", [DriveVectorEnv, driven_rows, RobotsVectorEnv])
def test_other_numbers_of_boards_are_refused(kind, count):
    with pytest.raises(ConfigError, match="num_envs = "):
        kind(count)


def test_a_range_draws_what_it_names_and_nothing_else():
    with pytest.raises(TypeError, match="friction"):
        agent.envs.WorldRange(friction=(0.1, 0.2))  # pyright: ignore[reportCallIssue]
    ranges = agent.envs.WorldRange(mu=(0.1, 0.12))
    assert copy.deepcopy(ranges) == pickle.loads(pickle.dumps(ranges)) == ranges
    drawn = CoSimConfig().in_world(draw_world(ranges, 30, 15, np.random.default_rng(0)))
    others, usual = (
        [leaf.value for leaf in config.leaves().values() if leaf.path.startswith("world.")]
        for config in (drawn, CoSimConfig())
    )
    assert others == usual
    env = DriveVectorEnv(3, worlds=ranges, context=True)
    worlds = env.reset(seed=0)[0][:, 13:]
    assert len({*worlds[:, 0].tolist()}) == 3
    assert (np.abs(worlds[:, 0] - 0.11) <= 0.01).all()
    assert not worlds[:, 1:].any()
    env.close()
    with pytest.raises(ConfigError, match=r"worlds .* given world"):
        DriveVectorEnv(1, worlds=ranges, world={"mu": 0.2})


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
        with pytest.raises(ConfigError, match="2 finite numbers"):
            env.step(action)
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

"""The control-level environment: bits, bounds, rewards, and a controller that plans with it."""

import math

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import agent.envs
from agent.envs.drive import DriveEnv, DriveVectorEnv
from agent.envs.grid_episode import ActionError, StartsError
from cosim.base.arguments import ConfigError
from cosim.model.outcome import OUT_OF_BOARD, SUCCESS, TIMEOUT

AHEAD = np.array([1.0, 0.0])


def test_rows_have_the_bits_of_the_single_environment_and_of_a_restored_one():
    assert agent.envs
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
    ahead = [env.step(AHEAD) for _ in range(20)]
    moved = 0.1 * (1.0 - ahead[-1][0][0])
    assert moved / 2.0 == pytest.approx(env._rows.boards._steering.drive_speed_m_s, rel=0.15)
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
    assert seen.shape == (2, 18)
    assert env.step(np.zeros((2, 2)))[0] in env.observation_space
    assert 0.1 <= seen[0, 13] <= 0.26
    assert np.hypot(*seen[:, 11:13].T).tolist() == pytest.approx([np.hypot(*seen[0, 11:13])] * 2)
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
        ({"reach": -1.0}, "reach = -1.0 must be a positive distance"),
        ({"shield": True}, "shield has no effect where a learner drives"),
    ],
)
def test_unusable_options_are_refused(options, said):
    with pytest.raises(ConfigError, match=said):
        DriveEnv(**options)


def test_unusable_starts_and_actions_are_refused():
    env = DriveEnv()
    with pytest.raises(ActionError, match="no episode is running"):
        env.step(AHEAD)
    for starts in ([[0.15, 0.15]], [[0.5, 0.15, 0.0]], "here"):
        with pytest.raises(StartsError, match="must be of shape"):
            env.reset(options={"starts": starts})
    env.reset(seed=0)
    for action in ([1.0], [math.nan, 0.0]):
        with pytest.raises(ActionError, match="two finite numbers"):
            env.step(action)
    env.close()

"""The training loop: Eq. (7) by hand and against a C program, the schedule, determinism."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agent.mdp.config import ProcessConfig
from agent.mdp.interpretations import build_process
from agent.mdp.rng import next_word
from agent.training.learning import (
    PATH_CELLS,
    STEPS,
    build_learning,
    epsilon_of_episodes,
    initial_state,
)
from agent.training.methods import METHODS
from agent.training.qlearning import advance
from agent.training.rules import RECORDS, largest
from agent.training.settings import LearningConfig
from cosim.model.scenario import Scenario
from cosim.model.scenario_file import find_scenario
from tests.references.qlearning_c import build_reference, reference_state, train_reference

CORRIDOR = Scenario("corridor", "", ((2, 0),), (((0, 0),),), columns=3, rows=1, zone=(0, 0, 2, 0))


def briefly(**options):
    """Greedy episodes of which each is in the curve."""
    return LearningConfig(**{"exploration": 0.0, "log_episodes": 1, "log_window": 1} | options)


def prepared(scenario, config, seed=0, method="paper", **interpretations):
    """The state at the beginning, and what trains it to the end."""
    process = build_process(scenario, ProcessConfig(**interpretations))
    rule, tables = RECORDS[METHODS[method].update], METHODS[method].tables
    state = initial_state(process, config, seed, tables)
    learning = build_learning(config, rule, tables)
    return state, lambda until=config.episodes: advance(process, learning, state, until)


def test_splitmix64_gives_its_published_numbers():
    # first outputs for seed 1234567, as in the reference implementation's test vector
    state = np.array([1234567], dtype=np.uint64)
    published = [6457827717110365317, 3203168211198807973, 9817491932198370423]
    assert [int(next_word(state)) for _ in published] == published


def test_eq_7_on_a_corridor_by_hand():
    config = briefly(episodes=3, eta=0.5, gamma=0.9, epsilon=0.0)
    state, learn = prepared(CORRIDOR, config, goal_reward=10.0)
    state.q[..., 1:] = -1000.0  # so that greedy drives east: two moves to the goal per episode
    learn()
    first = second = 0.0
    for _ in range(3):
        first += 0.5 * (-1.0 + 0.9 * second - first)
        second += 0.5 * (10.0 - second)
    assert state.q[0, 0, [0, 1], 0] == pytest.approx([first, second], rel=1e-6)
    assert (state.q[..., 1:] == -1000.0).all()
    assert state.visits.tolist() == [[3, 3, 0]]
    assert state.curve[:, 1].tolist() == [1, 1, 1]
    assert state.agent_steps == 6


@given(st.lists(st.integers(-2, 2), min_size=8, max_size=8))
def test_the_greedy_direction_is_the_first_of_the_largest_values(values):
    assert largest(np.array(values, dtype=np.float32)) == (np.argmax(values), max(values))


def test_one_table_of_double_q_learning_picks_and_the_other_values():
    config = briefly(episodes=1, eta=0.5, gamma=0.9)
    updated = []
    for seed in range(20):
        state, learn = prepared(CORRIDOR, config, seed, "double_q", step_limit=1)
        state.q[:, 0, 0, 0] = 1.0  # so that greedy drives east
        state.q[0, 0, 1, [0, 3]] = 4.0, 9.0
        state.q[1, 0, 1, [3, 5]] = 2.0, 7.0
        learn()
        of_first, of_second = state.q[:, 0, 0, 0].tolist()
        updated.append(int(of_first == 1.0))
        # the first picks 3, worth 2 to the second; the second picks 5, worth 0 to the first
        learnt = 0.5 * (1.0 + [-1.0 + 0.9 * 2.0, -1.0][updated[-1]])
        assert (of_second, of_first)[updated[-1]] == 1.0
        assert (of_first, of_second)[updated[-1]] == pytest.approx(learnt)
    assert 4 <= sum(updated) <= 16


@pytest.mark.parametrize(("action", "learnt"), [(1, 10.0), (4, -10.0)], ids=["goal", "failure"])
def test_eq_8_is_learnt_and_diagonal_moves_are_longer(action, learnt):
    zone = (0, 0, 1, 1)
    square = Scenario("square", "", ((1, 1),), (((0, 0),),), columns=2, rows=2, zone=zone)
    state, learn = prepared(square, briefly(episodes=1, eta=1.0), goal_reward=10.0)
    state.q[..., action] = 1.0
    learn()
    assert state.q[0, 0, 0, action] == learnt
    arrived = np.array([np.sqrt(2.0), 1.0]) if learnt > 0.0 else np.zeros(2)
    assert state.curve[0, [PATH_CELLS, STEPS]] == pytest.approx(arrived)


@pytest.mark.parametrize("method", ["paper", "double_q"])
@pytest.mark.parametrize("epsilon", [0.0, 0.4, 1.0])
def test_robots_explore_with_probability_epsilon(epsilon, method):
    """Next to its target a robot chooses it with 1 − ε + ε / 8, each other direction with ε / 8.

    With γ = 0 and rewards that do not change, a value tells how often its action was tried.
    """
    zone = (0, 0, 2, 2)
    room = Scenario("room", "", ((2, 1),), (((1, 1),),), columns=3, rows=3, zone=zone)
    config = LearningConfig(
        episodes=20_000, eta=1e-4, gamma=0.0, epsilon=epsilon, epsilon_decay=1.0, exploration=1.0
    )  # fmt: skip
    state, learn = prepared(room, config, 0, method, goal_reward=10.0, step_limit=1)
    start = np.array([1e-3] + [0.0] * 7)  # the goal is the greedy direction from the beginning
    state.q[:] = start
    learn()
    reward = np.array([10.0] + [-1.0] * 7)
    middle = state.q[:, 0, 4]  # of cell (1, 1), in each table
    tried = np.log((reward - middle) / (reward - start)).sum(axis=0) / np.log(1.0 - config.eta)
    expected = np.full(8, epsilon / 8.0) + np.array([1.0 - epsilon] + [0.0] * 7)
    assert tried / config.episodes == pytest.approx(expected, abs=0.01)


def test_a_learning_rate_that_falls_is_that_of_its_episode():
    learning = briefly(episodes=4, eta=0.5, eta_end=0.1, epsilon_episodes=1, epsilon=0.0)
    assert build_learning(learning).eta == pytest.approx([0.5, 0.4, 0.3, 0.2])
    assert build_learning(replace(learning, eta_end=None)).eta.tolist() == [0.5] * 4
    state, learn = prepared(CORRIDOR, learning, goal_reward=10.0)
    state.q[..., 1:] = -1000.0
    learn()
    second = 0.0
    for eta in (0.5, 0.4, 0.3, 0.2):
        second += eta * (10.0 - second)
    assert state.q[0, 0, 1, 0] == pytest.approx(second, rel=1e-6)


def test_cut_episode_bootstraps_and_counts_as_a_failure():
    state, learn = prepared(CORRIDOR, briefly(episodes=1, eta=1.0), step_limit=1)
    state.q[0, 0, 1, 3] = 7.0
    learn()
    assert state.q[0, 0, 0, 0] == np.float32(-1.0) + np.float32(0.99) * np.float32(7.0)
    assert state.curve[0, :2].tolist() == [1, 0]


def test_epsilon_follows_section_v():
    config = LearningConfig()
    epsilon = epsilon_of_episodes(config, np.array([0, 499, 500, 1000, 2_999_999, 3_000_000]))
    expected = [0.9, 0.9, 0.9 * 0.999, 0.9 * 0.999**2, 0.9 * 0.999**5999, 0.0]
    assert epsilon == pytest.approx(expected, rel=1e-12)
    linear = epsilon_of_episodes(
        LearningConfig(schedule="linear"), np.array([0, 1_500_000, 3_000_000])
    )
    assert linear == pytest.approx([0.9, 0.45, 0.0])


@pytest.mark.parametrize("episodes", [999, 1000, 1234])
def test_kernel_schedule_is_the_documented_one_in_every_episode(episodes):
    config = LearningConfig(episodes=episodes, epsilon_episodes=100)
    learning = build_learning(config)
    all_episodes = np.arange(episodes)
    kernel = learning.epsilon_thresholds[all_episodes // learning.block] / 2.0**53
    assert kernel == pytest.approx(epsilon_of_episodes(config, all_episodes), abs=1e-15)


@pytest.mark.parametrize("name", ["1a", "2"])
@pytest.mark.parametrize("method", ["paper", "double_q"])
def test_cutting_a_run_into_chunks_changes_no_bit(name, method):
    config, states = LearningConfig(episodes=3000, epsilon_episodes=10), []
    for seed, stops in ((0, [3000]), (0, [1, 2, 777, 1000, 3000]), (1, [3000])):
        state, learn = prepared(find_scenario(name), config, seed, method, slip_probability=0.1)
        states.append(state)
        for until in stops:
            learn(until)
    names = ("q", "visits", "random", "curve", "episode", "agent_steps")
    whole, cut, other = ([np.array(getattr(state, n)).tolist() for n in names] for state in states)
    assert whole == cut != other
    whole = states[0]
    assert (whole.q != 0).any(axis=(1, 2, 3)).all()


@pytest.mark.parametrize("update", ["ordinary", "penalty", "none"])
def test_partner_of_a_failed_robot(update):
    # robot 1 leaves the board at once (its only values point west), robot 2 continues
    pair = Scenario("p", "", ((15, 18), (15, 12)), (((0, 5),), ((9, 9),)))
    state, learn = prepared(pair, briefly(episodes=1, eta=1.0), partner_of_failed=update)
    state.q[0, 0, :, 4] = 1.0
    learn()
    learnt = state.q[0, 1][state.q[0, 1] != 0].tolist()
    assert learnt == {"ordinary": [-1.0], "penalty": [-100.0], "none": []}[update]


def test_features_that_hide_a_move_still_pick_from_the_updated_row():
    # with no position in the state every move stays in one row: greedy must be of the new values
    config = briefly(episodes=1, eta=0.5)
    state, learn = prepared(find_scenario("2"), config, features=("d",), step_limit=8)
    learn()
    # every move costs 1, so each of the eight directions is tried once
    assert (state.visits.sum(axis=1) <= 8).all()
    assert (state.q[0].min(axis=(1, 2)) < 0).all()
    assert np.count_nonzero(state.q[0, 0]) == state.visits[0].sum()


def test_three_robots_learn():
    starts = tuple(tuple((x, y) for x in range(0, 12, 2)) for y in (0, 11))
    trio = Scenario(
        "trio", "", ((1, 6), (10, 6), (5, 2)), (starts[0][:2], starts[1][4:], starts[0][4:]),
        columns=12, rows=12, robot_diameter_m=0.015, zone=(4, 4, 7, 7),
    )  # fmt: skip
    state, learn = prepared(trio, LearningConfig(episodes=60_000, epsilon_episodes=10))
    learn()
    assert state.curve[-1, 1] / state.curve[-1, 0] > 0.9


EPISODES = 100_000


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    return build_reference(tmp_path_factory.mktemp("reference"))


@pytest.mark.parametrize("name", ["1a", "2", "4"])
@pytest.mark.parametrize("budget", [EPISODES, 5_000_000])
def test_tables_agree_bit_for_bit_after_100_000_episodes(library, name, budget):
    # the budget sets the schedule: all of it, and the first fiftieth of Section V's
    config = LearningConfig(episodes=budget)
    scenario, learning = find_scenario(name), build_learning(config)
    process = build_process(scenario, ProcessConfig())
    ours = initial_state(process, config, seed=7)
    reference = reference_state(scenario, ours.random)
    advance(process, learning, ours, EPISODES)
    train_reference(library, scenario, learning, reference, EPISODES)
    q, visits = reference.q, reference.visits
    if scenario.robots == 1:  # we leave out what a lone robot cannot see: large, same
        seen = np.arange(process.state_count) * 9 + 2 * 3 + 1
        assert np.count_nonzero(np.delete(visits, seen, axis=1)) == 0
        q, visits = q[:, :, seen], visits[:, seen]
    assert np.array_equal(ours.q, q)
    assert np.array_equal(ours.visits, visits)
    assert np.array_equal(ours.random, reference.random)
    assert ours.agent_steps == reference.agent_steps
    assert np.count_nonzero(q) > 1000

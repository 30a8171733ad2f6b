"""The least time of two robots together: against Dijkstra's algorithm over the joint states."""

import heapq
import itertools
from dataclasses import replace
from functools import cache

import msgspec
import numpy as np
import pytest

from agent.mdp.config import ProcessConfig
from agent.mdp.greedy import PolicyError
from agent.mdp.readings import build_process
from agent.method import method_of, moves_of
from agent.moves import pair
from agent.moves.bound import mean_seconds
from agent.moves.model import NO_DIRECTION, Move, ObservedMoves, move_kind
from agent.moves.pair import moves_of_pair
from agent.policies import load_policy
from agent.training.learning import SUCCESSES, build_learning
from agent.training.loop import fresh_state, move_model
from agent.training.pair_learning import FAILURE_S, advance_pair, first_delay, of_both
from agent.training.pair_policy import PairPolicy
from agent.training.policy import PolicyConfig, Seed
from agent.training.settings import LearningConfig
from agent.training.store import train_policy
from cosim.base.errors import UserError
from cosim.model.outcome import Outcome
from cosim.model.scenario import Scenario
from cosim.model.scenario_file import find_scenario
from cosim.onboard.features import DIRECTIONS, Observation

SIDE = 9  # cells: room for two robots that keep six cells apart
BOARD = Scenario(
    "board", "", ((1, 1), (7, 7)), (((8, 1), (8, 0)), ((0, 7),)), columns=SIDE, rows=SIDE,
    zone=(0, 0, 0, 0),
)  # fmt: skip
SECONDS = (3.0, 5.0, 9.0, 5.5, 3.9, 6.5, 11.0, 7.9)  # by kind
MOVES = ObservedMoves(
    "", 0,
    tuple(
        Move(k // 4, (k // 4 + k) % 4, NO_DIRECTION, 1, k // 4, 0.5, s, 0, 0, 0, 0)
        for k, s in enumerate(SECONDS)
    ),
    rl_step_s=0.1,
    through=True,
)  # fmt: skip
STEPS = DIRECTIONS.tolist()
MEAN_S = mean_seconds(MOVES).tolist()
PROCESS = ProcessConfig(features=("x", "y", "h", "p"))


@pytest.fixture(scope="module")
def policy() -> PairPolicy:
    config = PolicyConfig(BOARD, PROCESS, LearningConfig(), Seed(0), MOVES, objective="fastest")
    return PairPolicy.computed(config)


@cache
def keep_apart(before, after):
    """Whether robots may go from one displacement between them to another."""
    on_the_way = before + np.linspace(0.0, 1.0, 201)[:, None] * np.subtract(after, before)
    squared = (on_the_way**2).sum(axis=1)
    return squared.min() > min(pair.KEPT_CELLS, squared[0]) - 0.01 and (
        squared[-1] >= pair.KEPT_CELLS or squared[-1] > squared[0]
    )


def next_states(state):
    """Joint moves from cells and axes of both robots, with the time that they cost both."""
    options = []
    for i, (x, y, axis) in enumerate(state):
        if (x, y) == BOARD.targets[i]:
            options.append([((x, y, axis), 0.0)])
            continue
        options.append([])
        for direction, (dx, dy) in enumerate(STEPS):
            other_x, other_y = BOARD.targets[1 - i]
            beside = max(abs(x + dx - other_x), abs(y + dy - other_y)) <= 1
            if 0 <= x + dx < SIDE and 0 <= y + dy < SIDE and not beside:
                after = x + dx, y + dy, direction % 4
                options[i].append((after, MEAN_S[move_kind(direction, axis)]))
    before = tuple(a - b for a, b in zip(*state, strict=True))[:2]
    for (first, first_s), (second, second_s) in itertools.product(*options):
        if keep_apart(before, (first[0] - second[0], first[1] - second[1])):
            yield (first, second), first_s + second_s


def least_time(state):
    best, queue = {state: 0.0}, [(0.0, state)]
    while queue:
        time, state = heapq.heappop(queue)
        if all(cell[:2] == target for cell, target in zip(state, BOARD.targets, strict=True)):
            return time
        for after, seconds in next_states(state):
            if time + seconds < best.get(after, np.inf) - 1e-9:
                best[after] = time + seconds
                heapq.heappush(queue, (time + seconds, after))
    return np.inf


def seen(state):
    cells, axes = np.array([cell[:2] for cell in state]), np.array([cell[2] for cell in state])
    none = np.zeros(2, dtype=np.int64)
    return Observation(cells, none, none, axes, np.array(BOARD.targets))


@pytest.mark.parametrize("state", [((8, 1, 2), (0, 7, 2)), ((7, 4, 1), (2, 3, 3))])
def test_moves_lead_to_the_least_time(policy, state):
    expected, taken = least_time(state), 0.0
    alone = policy.times.alone
    assert expected > sum(alone[i, x * SIDE + y, axis] for i, (x, y, axis) in enumerate(state)) - 1
    for _ in range(40):
        values = policy.q_values(seen(state))
        assert values.max() == pytest.approx(taken - expected, abs=1.5 * pair.GRAIN_S + 1e-3)
        chosen = policy.act(seen(state)).action.tolist()
        reached = {
            tuple(after): seconds
            for after, seconds in next_states(state)
            if all(
                cell[:2] == target or tuple(np.subtract(new, cell)[:2]) == tuple(DIRECTIONS[a])
                for cell, target, new, a in zip(state, BOARD.targets, after, chosen, strict=True)
            )
        }
        assert len(reached) == 1
        state, seconds = reached.popitem()
        taken += seconds
        if all(cell[:2] == target for cell, target in zip(state, BOARD.targets, strict=True)):
            break
    assert taken == pytest.approx(expected, abs=0.5)


def test_it_is_read_back_and_drives_from_all_starts(policy, tmp_path):
    policy.save(tmp_path / "policy.npz")
    again = load_policy(tmp_path / "policy.npz", BOARD)
    assert again.digest() == policy.digest()
    found = again.evaluate()
    assert found.rate(Outcome.SUCCESS) == 1.0
    assert found.steps.tolist() == policy.evaluate().steps.tolist()
    values = [layer.value for layer in policy.maps()]
    assert [v[t] for v, t in zip(values, BOARD.targets, strict=True)] == [0.0, 0.0]
    with pytest.raises(PolicyError, match="was trained on scenario board"):
        load_policy(tmp_path / "policy.npz", find_scenario("2"))
    np.savez(
        tmp_path / "other.npz", **dict(np.load(tmp_path / "policy.npz")) | {"delay": values[0]}
    )
    with pytest.raises(PolicyError, match="do not fit"):
        load_policy(tmp_path / "other.npz")


def test_robots_that_are_too_near_move_apart(policy):
    near = (4, 4, 0), (6, 8, 0)
    after = policy.act(seen(near)).action
    moved = np.array([cell[:2] for cell in near]) + DIRECTIONS[after]
    assert ((moved[0] - moved[1]) ** 2).sum() > 20


def test_a_pair_knows_moves_of_robots_that_drive_through_cells(policy):
    driven = moves_of("fastest", BOARD)
    assert driven is not None
    assert driven.through
    assert method_of(policy.config) == "fastest"


def test_a_state_off_the_board_is_refused(policy):
    with pytest.raises(ValueError, match="off the board"):
        policy.q_values(seen(((9, 1, 2), (0, 7, 2))))


def test_every_joint_state_has_values_that_its_process_allows(policy):
    process = build_process(BOARD, PROCESS)
    assert policy.delay.shape == (SIDE**2, 4, SIDE**2, 4)
    reached = policy.delay != pair.UNREACHABLE
    free, end = pair.joint_states(process)
    assert reached[:, 0, :, 0][end].all()
    assert not reached[:, 0, :, 0][~free & ~end].any()


def test_a_robot_that_waits_keeps_away_from_a_move_under_way(policy):
    """On the way, and once the other one has arrived."""
    rng, free = np.random.default_rng(0), 0
    for _ in range(300):
        cells = rng.integers(SIDE, size=(2, 2))
        direction = rng.integers(8)
        goals = np.stack([cells[0], cells[1] + DIRECTIONS[direction]])
        if (goals[1] < 0).any() or (goals[1] >= SIDE).any() or tuple(cells[0]) == BOARD.targets[0]:
            continue
        state = [(*cell, axis) for cell, axis in zip(cells, rng.integers(4, size=2), strict=True)]
        values = policy.q_values(seen(state)._replace(goals=goals))
        assert (values[1] == values[1, 0]).all()  # it does not decide
        if values[0].max() < -1e5:  # no move keeps apart
            continue
        free += 1
        after = cells[0] + DIRECTIONS[values[0].argmax()]
        for other in (cells[1], goals[1]):
            assert keep_apart(tuple(cells[0] - other), tuple(after - goals[1]))
    assert free > 50


LEARNING = LearningConfig(
    8000, eta=0.5, eta_end=0.02, gamma=1.0, epsilon=0.2, exploration=0.8, schedule="linear",
    algorithm="pair", log_episodes=100, greedy_points=2,
)  # fmt: skip


@pytest.fixture(scope="module")
def trained():
    return train_policy(PolicyConfig(BOARD, PROCESS, LEARNING, Seed(3), MOVES))


def test_a_pair_learns_to_take_little_more_than_the_least_time(policy, trained):
    learnt, log = trained
    starts = [((x, y, 2), (0, 7, 2)) for x, y in BOARD.starts[0]]
    least = np.mean([-policy.q_values(seen(state)).max() for state in starts])
    taken = -log.returns.sum(axis=1)
    assert log.success[-1] == 1.0
    assert 0.99 * least < taken[-10:].mean() < 1.01 * least
    known = np.mean([-learnt.q_values(seen(state)).max() for state in starts])
    assert 0.97 * least < known < 1.03 * least  # values begin at 1.1 times those of robots alone
    assert learnt.evaluate().rate(Outcome.SUCCESS) == 1.0


def test_a_learnt_pair_is_the_same_for_the_same_seed_and_is_read_back(trained, tmp_path):
    learnt, _ = trained
    again, _ = train_policy(learnt.config)
    other, _ = train_policy(msgspec.structs.replace(learnt.config, seed=Seed(4)))
    assert again.digest() == learnt.digest() != other.digest()
    learnt.save(tmp_path / "policy.npz")
    read = load_policy(tmp_path / "policy.npz", BOARD)
    assert (read.digest(), read.episodes) == (learnt.digest(), LEARNING.episodes)
    assert repr(read) == "PairPolicy(scenario board, 8000 episodes on moves)"
    maps, again = ([part.visits for part in one.maps()] for one in (learnt, read))
    assert np.array_equal(maps, again)
    assert np.min(np.max(maps, axis=(1, 2))) > 1000.0  # both have decided often somewhere


def test_what_was_never_met_is_raised_when_exploration_ends_however_a_run_is_cut():
    config = PolicyConfig(BOARD, PROCESS, replace(LEARNING, episodes=3000), Seed(3), MOVES)
    process, learning = build_process(BOARD, PROCESS), build_learning(config.learning)
    model = move_model(config)
    assert model is not None
    times = moves_of_pair(process, MOVES)
    unseen = of_both(first_delay(process, times))
    states = []
    for cuts in ((3000,), (1, 1200, 2500, 2999, 3000)):
        states.append(fresh_state(config))
        first = states[-1].q.copy()
        for until in cuts:
            advance_pair(process, model, learning, times, states[-1], until, unseen=unseen)
    whole, cut = states
    assert np.array_equal(whole.q, cut.q)
    assert np.array_equal(whole.visits, cut.visits)
    never = whole.visits == 0
    assert (whole.q[never] == unseen[never]).all()
    assert (first[never] < unseen[never]).any()
    assert (whole.q[~never] != first[~never]).mean() > 0.9


def test_a_failure_next_to_the_targets_is_forgotten_when_others_succeed():
    config = PolicyConfig(BOARD, PROCESS, replace(LEARNING, epsilon=0.0), Seed(3), MOVES)
    process, model, state = build_process(BOARD, PROCESS), move_model(config), fresh_state(config)
    assert model is not None
    first, second = (x * SIDE + y for x, y in BOARD.targets)
    state.q[first, :, second] = FAILURE_S / pair.GRAIN_S
    learning, times = build_learning(config.learning), moves_of_pair(process, MOVES)
    advance_pair(process, model, learning, times, state, 500)
    ended = state.visits[first, :, second]
    assert ended.sum() == state.curve[:5, SUCCESSES].sum()
    assert (state.q[first, :, second][ended > 0] < FAILURE_S / pair.GRAIN_S / 2).all()
    assert state.curve[4, SUCCESSES] > 90  # of 100


def test_directions_that_fail_have_no_value_in_recordings(policy):
    state = ((7, 1, 0), (8, 8, 0))
    values, shown = policy.q_values(seen(state)), policy.act(seen(state)).values
    assert shown is not None
    assert np.isnan(shown[values < -1e5]).all()
    assert np.array_equal(shown[values > -1e5], values[values > -1e5])
    assert np.isnan(shown).any()


@pytest.mark.parametrize(
    ("changed", "problem"),
    [
        ({"scenario": find_scenario("1b")}, "scenario 1b has 1 robots; choose one of two"),
        ({"moves": None}, "it learns on observed moves"),
        ({"moves": msgspec.structs.replace(MOVES, walks=(8,))}, "observe moves of one world"),
        ({"process": ProcessConfig()}, "choose the features x, y, h and p"),
    ],
)
def test_what_a_pair_cannot_learn_on_is_refused(changed, problem):
    config = PolicyConfig(BOARD, PROCESS, LEARNING, Seed(0), MOVES)
    with pytest.raises(PolicyError, match=f"algorithm = pair is for two robots: .*{problem}"):
        msgspec.structs.replace(config, **changed)


def test_a_board_on_which_a_robot_cannot_arrive_is_not_learnt():
    walled = replace(BOARD, robot_diameter_m=0.02, obstacles=tuple((4, y) for y in range(9)))
    with pytest.raises(UserError, match="there is no path to the targets"):
        train_policy(PolicyConfig(walled, PROCESS, LEARNING, Seed(0), MOVES))

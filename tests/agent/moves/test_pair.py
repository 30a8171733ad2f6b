"""Least time of two robots against Dijkstra's algorithm over joint states; clearances of plans."""

import heapq
import itertools
import math
from dataclasses import replace
from functools import cache
from typing import Any

import msgspec
import numpy as np
import pytest

from agent.mdp.config import ProcessConfig
from agent.mdp.interpretations import build_process
from agent.moves import pair
from agent.moves.model import NO_DIRECTION, Move, ObservedMoves
from agent.moves.observe import move_rows
from agent.moves.times import board_of, mean_seconds
from agent.training.loop import learn, move_model
from agent.training.methods import METHODS
from agent.training.policy import GroupPolicy, PairPolicy, PolicyConfig, Seed, load_policy
from agent.training.settings import LearningConfig
from cosim.base.errors import UserError
from cosim.model.outcome import Outcome
from cosim.model.scenario import Scenario
from cosim.onboard.features import DIRECTIONS, Observation

SIDE = 9  # cells: room for two robots that keep six cells apart
BOARD = Scenario(
    "board", "", ((1, 1), (7, 7)), (((8, 1), (8, 0)), ((0, 7),)), columns=SIDE, rows=SIDE,
    zone=(0, 0, 0, 0),
)  # fmt: skip
KEPT_CELLS = 34  # squared, of robots of 5 cm with a gap of 8.3 mm
SECONDS = (3.0, 5.0, 9.0, 5.5, 3.9, 6.5, 11.0, 7.9)  # by kind
ONE_WAY = (3.0, 5.0, 9.0, 13.0, 17.0, 13.5, 9.5, 5.5, 3.9, 6.5, 11.0, 15.0, 19.0, 15.5, 12.0, 7.9)


def lasting(*seconds, **options):
    """A move of every kind, heading east or north-east first."""
    facings: Any = len(seconds) // 2
    moves = [
        Move(
            k // facings,
            (k // facings + k) % facings,
            NO_DIRECTION,
            1,
            k // facings,
            0.5,
            s,
            *[0] * 4,
        )
        for k, s in enumerate(seconds)
    ]
    return ObservedMoves("", 0, tuple(moves), **options, facings=facings)


MOVES = lasting(*SECONDS, rl_step_s=0.1, through=True)
STEPS = DIRECTIONS.tolist()
PROCESS = ProcessConfig(features=("x", "y", "h", "p"))


def computed(moves) -> PairPolicy:
    config = PolicyConfig(BOARD, PROCESS, LearningConfig(), Seed(0), moves, method="fastest")
    return PairPolicy.computed(config)


@pytest.fixture(scope="module")
def policy() -> PairPolicy:
    return computed(MOVES)


@cache
def keep_apart(before, after):
    """Whether robots may go from one displacement between them to another."""
    on_the_way = before + np.linspace(0.0, 1.0, 201)[:, None] * np.subtract(after, before)
    squared = (on_the_way**2).sum(axis=1)
    return squared.min() > min(KEPT_CELLS, squared[0]) - 0.01 and (
        squared[-1] >= KEPT_CELLS or squared[-1] > squared[0]
    )


def next_states(state, mean_s):
    """Joint moves from cells and facings of both robots, with the time that they cost both."""
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
                after = x + dx, y + dy, direction % mean_s.shape[1]
                options[i].append((after, mean_s[direction, axis]))
    before = tuple(a - b for a, b in zip(*state, strict=True))[:2]
    for (first, first_s), (second, second_s) in itertools.product(*options):
        if keep_apart(before, (first[0] - second[0], first[1] - second[1])):
            yield (first, second), first_s + second_s


def least_time(state, mean_s):
    best, queue = {state: 0.0}, [(0.0, state)]
    while queue:
        time, state = heapq.heappop(queue)
        if all(cell[:2] == target for cell, target in zip(state, BOARD.targets, strict=True)):
            return time
        for after, seconds in next_states(state, mean_s):
            if time + seconds < best.get(after, np.inf) - 1e-9:
                best[after] = time + seconds
                heapq.heappush(queue, (time + seconds, after))
    return np.inf


def observe(scenario, cells, directions, goals=None):
    cells = np.array(cells)
    none = np.zeros(len(cells), dtype=np.int64)
    goals = cells if goals is None else np.array(goals)
    return Observation(cells, none, none, np.array(directions), np.array(scenario.targets), goals)


def seen(state):
    return observe(BOARD, [cell[:2] for cell in state], [cell[2] for cell in state])


@pytest.mark.long
@pytest.mark.parametrize("state", [((8, 1, 2), (0, 7, 2)), ((7, 4, 1), (2, 3, 3))])
@pytest.mark.parametrize("seconds", [SECONDS, ONE_WAY, SECONDS[2:6]], ids=len)
def test_moves_lead_to_the_least_time(policy, seconds, state):
    if seconds != SECONDS:
        policy = computed(lasting(*seconds, rl_step_s=0.1, through=True))
    assert policy.config.moves is not None
    mean_s, taken = mean_seconds(policy.config.moves), 0.0
    state = tuple((x, y, facing % mean_s.shape[1]) for x, y, facing in state)
    expected = least_time(state, mean_s)
    alone = policy.times.alone
    assert expected > sum(alone[i, x * SIDE + y, axis] for i, (x, y, axis) in enumerate(state)) - 1
    for _ in range(40):
        values = policy.q_values(seen(state))
        assert values.max() == pytest.approx(taken - expected, abs=1.5 * pair.GRAIN_S + 1e-3)
        chosen = policy.act(seen(state)).action.tolist()
        reached = {
            tuple(after): seconds
            for after, seconds in next_states(state, mean_s)
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
    found = again.evaluate_on_grid()
    assert found.rate(Outcome.SUCCESS) == 1.0
    assert found.steps.tolist() == policy.evaluate_on_grid().steps.tolist()
    values = [layer.value for layer in policy.maps()]
    assert [v[t] for v, t in zip(values, BOARD.targets, strict=True)] == [0.0, 0.0]
    np.savez(
        tmp_path / "other.npz", **dict(np.load(tmp_path / "policy.npz")) | {"delay": values[0]}
    )
    with pytest.raises(UserError, match="do not fit"):
        load_policy(tmp_path / "other.npz")


def test_robots_that_are_too_near_move_apart(policy):
    near = (4, 4, 0), (6, 8, 0)
    after = policy.act(seen(near)).action
    moved = np.array([cell[:2] for cell in near]) + DIRECTIONS[after]
    assert ((moved[0] - moved[1]) ** 2).sum() > 20


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


def test_directions_that_fail_have_no_value_in_recordings_and_states_off_the_board_none(policy):
    state = ((7, 1, 0), (8, 8, 0))
    assert policy.act(seen(state)).unit == "s"
    values, shown = policy.q_values(seen(state)), policy.act(seen(state)).values
    assert shown is not None
    assert np.isnan(shown[values < -1e5]).all()
    assert np.array_equal(shown[values > -1e5], values[values > -1e5])
    assert np.isnan(shown).any()
    with pytest.raises(ValueError, match="off the board"):
        policy.q_values(seen(((9, 1, 2), (0, 7, 2))))


PAIRS = ProcessConfig(features=("x", "y", "h", "p"))


def config(scenario, method):
    joint = method == "fastest" and scenario.robots == 2
    process = PAIRS if joint else ProcessConfig(features=("x", "y", "h"))
    moves = msgspec.structs.replace(MOVES, cell_m=scenario.cell_m)
    return PolicyConfig(scenario, process, LearningConfig(), Seed(0), moves, method=method)


def made(given):
    compute = METHODS[given.method].compute
    assert compute is not None
    return compute(given)


def near(gap):
    targets = (2, 2), (2 + gap[0], 2 + gap[1])
    return replace(BOARD, name="near", targets=targets, starts=(((0, 7),), ((8, 8), (8, 0))))


@pytest.mark.parametrize("method", ["fastest", "planned"])
@pytest.mark.parametrize("gap", [(5, 1), (5, 2), (5, 3), (4, 4)])
def test_robots_park_at_targets_that_are_near(gap, method):
    policy = made(config(near(gap), method))
    assert policy.evaluate_on_grid().rate(Outcome.SUCCESS) == 1.0


def test_training_counts_no_contact_where_robots_park():
    for gap, contact_cells in (((5, 1), 0.5 * (5 + np.hypot(5, 1))), ((6, 0), 5.2)):
        process = ProcessConfig(features=("x", "y", "d", "g", "b"))
        model = move_model(PolicyConfig(near(gap), process, LearningConfig(), Seed(0), MOVES))
        assert model is not None
        assert np.sqrt(model.contact_cells) == pytest.approx(contact_cells)


@pytest.mark.parametrize(("diameter_m", "cell_m"), [(0.05, 0.01), (0.07, 0.01), (0.05, 0.02)])
def test_clearances_follow_diameter_and_cells(diameter_m, cell_m):
    scenario = Scenario(
        "sizes", "", ((0, 0), (9, 9)), (((9, 0),), ((0, 9),)), columns=10, rows=10,
        zone=(0, 0, 0, 0), robot_diameter_m=diameter_m, cell_m=cell_m,
    )  # fmt: skip
    process = build_process(scenario, PAIRS)
    kept_m = PairPolicy.computed(config(scenario, "fastest")).times.board.kept ** 0.5 * cell_m
    assert kept_m == pytest.approx(diameter_m + 0.0083)
    assert board_of(process, MOVES).kept ** 0.5 * cell_m == pytest.approx(kept_m)


@pytest.mark.parametrize("method", ["fastest", "planned", None])
@pytest.mark.parametrize("robots", [1, 2])
def test_targets_that_cannot_be_reached_are_refused(robots, method):
    board = Scenario(
        "walled", "", ((24, 10), (3, 3))[:robots], (((5, 7), (20, 8)), ((5, 16),))[:robots],
        30, 20, obstacles=tuple((14, y) for y in range(20)),
    )  # fmt: skip
    with pytest.raises(UserError, match="there is no path to"):
        if method is None:
            learn(PolicyConfig(board, ProcessConfig(), LearningConfig(episodes=1), Seed(0)))
        else:
            made(config(board, method))


def test_first_moves_of_plans_keep_the_gap():
    """The lines of two moves that begin at once, which may begin and end at any time."""
    board = replace(BOARD, name="wide", targets=((1, 1), (14, 14)), columns=16, rows=16)
    policy, rng = GroupPolicy.computed(config(board, "planned")), np.random.default_rng(0)
    share, apart = np.linspace(0.0, 1.0, 101)[:, None], []
    for cells in rng.integers(16, size=(400, 2, 2)):
        if not 5.83 <= math.dist(*cells) < 9.0 or (cells == board.targets).all(axis=1).any():
            continue
        asked = observe(board, cells, [0, 0])
        if policy.q_values(asked).max(axis=1).min() > -1e4:  # both have a plan
            steps = DIRECTIONS[policy.act(asked).action]
            first, second = cells[:, None] + share * steps[:, None]
            apart.append(np.linalg.norm(first[:, None] - second, axis=2).min())
    nearest, *others = sorted(apart)
    assert nearest > 0.8**0.5 * 5.83  # there is no other plan
    assert others[:5] == pytest.approx([34**0.5] * 5)


def test_kinds_of_moves_are_named_by_how_the_robot_turns_before_them():
    """Each turn takes a time of its own here."""

    def turned(move: Move) -> int:
        return (move.direction - move.heading) % MOVES.facings

    moves = tuple(
        msgspec.structs.replace(move, turn_s=float(turned(move)) + 0.25) for move in MOVES.moves
    )
    _, rows = move_rows(msgspec.structs.replace(MOVES, moves=moves))
    assert len(rows) == len({(move.direction % 2, turned(move)) for move in moves})
    for name, count, turn_s, *_ in rows:
        kind, _, degrees, _ = name.split()
        own = [
            move
            for move in moves
            if (move.direction % 2 == 1) == (kind == "diagonal")
            and turned(move) == int(degrees) // 45 % MOVES.facings
        ]
        assert (count, turn_s) == (str(len(own)), f"{own[0].turn_s:.2f}")

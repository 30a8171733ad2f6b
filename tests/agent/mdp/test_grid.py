"""Moves, rewards and starts of the process against those computed by hand."""

import itertools
import math
from dataclasses import replace
from functools import partial
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agent.mdp import grid
from agent.mdp.config import ProcessConfig
from agent.mdp.exact import MAX_STARTS, joint_starts
from agent.mdp.interpretations import OBSTACLE, build_process
from agent.mdp.rewards import reward_parts
from agent.mdp.rng import seeded_state
from agent.study.grid import grid_row
from agent.training.learning import initial_state
from agent.training.policy import Policy, PolicyConfig, Seed
from agent.training.settings import LearningConfig
from cosim.base.errors import UserError
from cosim.model.outcome import COLLISION, OUT_OF_BOARD, RUNNING, SUCCESS
from cosim.model.scenario import Scenario
from cosim.model.scenario_file import find_scenario
from cosim.onboard.features import DIRECTIONS, LARGE, MEDIUM, NEAR, Observation

E, NE, N, NW, W, SW, S, SE = range(8)
OBSTACLE_AT_10 = Scenario("b", "", ((25, 25),), (((0, 29),),), obstacles=((10, 10),))


def world_at(process, *cells):
    world = np.zeros((len(cells), grid.COLUMN_COUNT), dtype=np.int64)
    assert grid.place(process, world, np.array(cells, dtype=np.int64))
    return world


def step(process, world, *actions):
    rewards = np.empty(len(actions), dtype=np.float32)
    outcome = grid.move(process, world, np.array(actions, dtype=np.int64), rewards)
    return outcome, rewards.tolist()


def eq_11(distance_cells, c_or_1):
    return np.float32(-c_or_1 * (1.0 - min(distance_cells, 10.0) / 10.0) - 1.0)


def process_of(scenario, **interpretations):
    scenario = find_scenario(scenario) if isinstance(scenario, str) else scenario
    return build_process(scenario, ProcessConfig(**interpretations))


pair = partial(process_of, "2")


@pytest.mark.parametrize("diagonal_cost", [1.0, math.sqrt(2)])
@pytest.mark.parametrize("action", range(8))
def test_each_direction_moves_one_cell_at_its_cost(action, diagonal_cost):
    process = process_of("1a", diagonal_cost=diagonal_cost)
    world, cost = world_at(process, (5, 5)), diagonal_cost if action % 2 else 1.0
    assert step(process, world, action) == (RUNNING, [-np.float32(cost)])
    assert world[0, : grid.VX].tolist() == [5 + DIRECTIONS[action, 0], 5 + DIRECTIONS[action, 1]]


def test_lone_robot_reaches_goal_and_leaves_board_with_eq_8():
    process = process_of("1a")
    assert step(process, world_at(process, (15, 19)), S) == (SUCCESS, [100.0])
    for cell, action in [((0, 5), W), ((29, 5), E), ((5, 0), S), ((5, 29), N), ((29, 29), NE)]:
        assert step(process, world_at(process, cell), action) == (OUT_OF_BOARD, [-100.0])


def test_reward_and_features_when_a_pair_closes_in():
    process = pair()
    world = world_at(process, (5, 10), (14, 10))
    assert world[:, grid.CLASS].tolist() == [MEDIUM, MEDIUM]
    outcome, rewards = step(process, world, E, W)  # distance 9 → 7
    assert (outcome, rewards) == (RUNNING, [eq_11(7, 1.5)] * 2)
    assert rewards == [np.float32(-1.45)] * 2
    assert world[:, grid.SIGN].tolist() == [-1, -1]
    _, rewards = step(process, world, N, N)  # 7 → 7: not approaching
    assert rewards == [eq_11(7, 1.0)] * 2
    assert world[:, grid.SIGN].tolist() == [0, 0]
    _, rewards = step(process, world, E, E)
    _, rewards = step(process, world, W, E)  # 7 → 9: apart
    assert rewards == [eq_11(9, 1.0)] * 2
    assert world[:, grid.SIGN].tolist() == [1, 1]


@pytest.mark.parametrize(("dx", "expected"), [(6, NEAR), (7, MEDIUM), (10, MEDIUM), (11, LARGE)])
def test_distance_classes_and_rewards_of_robots_apart(dx, expected):
    """What is far costs nothing, and the partner of a robot off the board is paid as ever."""
    world = world_at(pair(), (2, 25), (2 + dx, 25))
    assert world[:, grid.CLASS].tolist() == [expected] * 2
    assert step(pair(), world_at(pair(), (2, 25), (20, 25)), E, W)[1] == [-1.0, -1.0]
    left = step(pair(), world_at(pair(), (0, 29), (5, 5)), W, E)
    assert left == (OUT_OF_BOARD, [-100.0, -1.0])


def test_contact_fails_both_moving_robots_but_not_a_parked_one():
    process = pair()
    outcome, rewards = step(process, world_at(process, (5, 25), (12, 25)), E, W)  # 7 → 5
    assert (outcome, rewards) == (COLLISION, [-100.0, -100.0])
    world = world_at(process, (15, 19), (21, 17))
    assert step(process, world, S, N) == (RUNNING, [100.0, eq_11(6, 1.5)])
    outcome, rewards = step(process, world, N, W)  # robot 1 is parked, robot 2 drives into it
    assert (outcome, rewards) == (COLLISION, [0.0, -100.0])
    assert world[:, grid.STATUS].tolist() == [grid.ARRIVED, grid.HIT]


def test_arrived_robot_stays_and_success_needs_both():
    process = pair()
    world = world_at(process, (15, 19), (15, 10))
    assert step(process, world, S, N)[0] == RUNNING
    before = world[0].copy()
    assert step(process, world, E, N) == (SUCCESS, [0.0, 100.0])
    assert world[0, : grid.VX].tolist() == before[: grid.VX].tolist()


def test_target_of_the_other_robot_is_an_obstacle_of_a_cell_or_a_disk():
    for process, last_free in [(pair(), 11), (pair(target_obstacle="disk"), 6)]:
        world = world_at(process, (15, last_free - 1), (2, 2))
        assert step(process, world, N, E)[0] == RUNNING
        assert step(process, world, N, E)[0] == COLLISION


def test_zone_is_an_obstacle_only_if_asked_but_never_the_own_target():
    assert step(pair(), world_at(pair(), (12, 19), (2, 2)), S, E)[0] == RUNNING
    closed = process_of("2-zone")
    assert step(closed, world_at(closed, (12, 19), (2, 2)), S, E)[0] == COLLISION
    assert step(closed, world_at(closed, (15, 19), (2, 2)), S, E)[1][0] == 100.0


def test_swept_collision_sees_robots_that_pass_each_other():
    # robots smaller than a cell that swap their cells are never in contact on a cell's centre
    tiny = Scenario("t", "", ((5, 5), (0, 5)), (((0, 0),), ((9, 9),)), robot_diameter_m=0.009)
    for collision, expected in (("cells", RUNNING), ("swept", COLLISION)):
        process = process_of(tiny, collision=collision)
        assert step(process, world_at(process, (3, 3), (4, 3)), E, W)[0] == expected


@pytest.mark.parametrize(("diameter_m", "reach"), [(0.05, 3), (0.04, 2), (0.009, 0)])
def test_a_cell_is_blocked_if_a_robot_in_its_middle_touches_an_obstacle(diameter_m, reach):
    process = process_of(replace(OBSTACLE_AT_10, robot_diameter_m=diameter_m))
    radius = 50.0 * diameter_m  # in cells
    for x in range(30):
        for y in range(30):
            gap = math.hypot(max(abs(x - 10) - 0.5, 0.0), max(abs(y - 10) - 0.5, 0.0))
            assert (process.terrain[0, x + 1, y + 1] == OBSTACLE) == (gap <= radius + 1e-9)
    beside = world_at(process, (10 + reach + 1, 10))
    assert step(process, beside, W) == (COLLISION, [-100.0])
    assert beside[0, grid.STATUS] == grid.HIT
    assert step(process, world_at(process, (10 + reach + 1, 10)), N) == (RUNNING, [-1.0])


@pytest.mark.parametrize("collision", ["cells", "swept"])
def test_swept_collision_sees_corners_that_diagonal_moves_graze(collision):
    """A point-like robot passes from beside an obstacle to above it, over its corner."""
    process = process_of(replace(OBSTACLE_AT_10, robot_diameter_m=0.009), collision=collision)
    for start, action in [((11, 10), NW), ((10, 11), SE), ((9, 10), NE), ((10, 9), NE)]:
        outcome, _ = step(process, world_at(process, start), action)
        assert outcome == (COLLISION if collision == "swept" else RUNNING)
    for start, action in [((11, 10), NE), ((12, 10), NW), ((11, 10), N)]:
        assert step(process, world_at(process, start), action)[0] == RUNNING
    outside = world_at(process, (0, 0))
    assert step(process, outside, SW) == (OUT_OF_BOARD, [-100.0])


def test_only_robots_that_touch_fail():
    starts = (((5, 5),), ((11, 5),), ((25, 5),))
    process = process_of(Scenario("row", "", ((5, 20), (11, 20), (25, 20)), starts))
    world = world_at(process, (5, 5), (11, 5), (25, 5))
    outcome, rewards = step(process, world, E, W, N)
    assert outcome == COLLISION
    assert world[:, grid.STATUS].tolist() == [grid.HIT, grid.HIT, grid.MOVING]
    assert rewards == [-100.0, -100.0, -1.0]
    world = world_at(process, (5, 5), (11, 5), (29, 5))
    assert step(process, world, E, W, E)[0] == OUT_OF_BOARD  # outranks the collision
    assert world[:, grid.STATUS].tolist() == [grid.HIT, grid.HIT, grid.LEFT]


@pytest.mark.parametrize("order", [(0, 1, 2), (2, 1, 0), (1, 0, 2)])
def test_leaving_the_board_outranks_a_collision_of_any_robot(order):
    cells, actions = [(0, 5), (10, 5), (16, 5)], [W, E, W]
    starts = tuple((cells[k],) for k in order)
    process = process_of(Scenario("row", "", ((5, 20), (11, 20), (25, 20)), starts))
    world = world_at(process, *(cells[k] for k in order))
    assert step(process, world, *(actions[k] for k in order))[0] == OUT_OF_BOARD
    expected = [[grid.LEFT, grid.HIT, grid.HIT][k] for k in order]
    assert world[:, grid.STATUS].tolist() == expected


def test_three_robots_see_the_nearest():
    starts = (((0, 0),), ((10, 0),), ((0, 20),))
    three = Scenario("three", "", ((15, 15), (22, 15), (15, 22)), starts)
    process = process_of(three, features=("x", "y", "d", "g", "b"))
    world = world_at(process, (0, 0), (10, 0), (0, 20))
    assert world[:, grid.SQUARED].tolist() == [100, 100, 400]
    assert world[:, grid.BEARING].tolist() == [E, W, S]
    assert process.state_count == 30 * 30 * 3 * 3 * 8


@given(st.integers(0, 29), st.integers(0, 29), st.integers(0, 29), st.integers(0, 29))
def test_bearing_is_the_nearest_direction(x, y, u, v):
    process = pair(features=("x", "y", "b"))
    world = np.zeros((2, grid.COLUMN_COUNT), dtype=np.int64)
    if not grid.place(process, world, np.array([(x, y), (u, v)], dtype=np.int64)):
        return
    unit = DIRECTIONS / np.linalg.norm(DIRECTIONS, axis=1)[:, None]
    cosines = unit @ np.array([u - x, v - y])
    assert world[0, grid.BEARING] == np.argmax(cosines)


def test_every_state_index_is_a_row_of_its_own():
    process = pair()
    seen = set()
    world = np.zeros((2, grid.COLUMN_COUNT), dtype=np.int64)
    for x in range(30):
        for y in range(30):
            for d in range(3):
                for g in (-1, 0, 1):
                    world[0, [grid.X, grid.Y, grid.CLASS, grid.SIGN]] = x, y, d, g
                    seen.add(int(grid.state_index(process, world, 0)))
    assert seen == set(range(process.state_count))


def test_random_starts_are_uniform_and_free_of_contact():
    close = Scenario("c", "", ((15, 18), (15, 12)), (((0, 0), (9, 0)), ((0, 3), (9, 3))))
    process = process_of(close)
    world = np.zeros((2, grid.COLUMN_COUNT), dtype=np.int64)
    cells = np.empty((2, 2), dtype=np.int64)
    random = seeded_state(1)
    first = []
    for _ in range(2000):
        grid.place_randomly(process, world, cells, random)
        assert world[0, grid.SQUARED] > 25
        first.append(int(cells[0, 0]))
        assert all(tuple(c) in own for c, own in zip(cells.tolist(), close.starts, strict=True))
    # binomial(2000, 1/2) has σ = 22; five σ
    assert abs(first.count(0) - 1000) < 112


def test_slip_turns_by_45_degrees_as_often_as_asked():
    process = pair(slip_probability=0.3)
    random = seeded_state(3)
    executed = [grid.slipped(process, N, random) for _ in range(10_000)]
    assert set(executed) == {NE, N, NW}
    # σ of a binomial(10 000, 0.15) is 36; five σ
    assert abs(executed.count(NE) - 1500) < 180
    assert abs(executed.count(NW) - 1500) < 180


@pytest.mark.parametrize(
    ("facing", "values", "expected"),
    [
        (2, [1, 0, 0, 0, 0, 0, 0, 0], 0),
        (2, [1, 1, 1, 1, 1, 1, 1, 1], 2),
        (3, [1, 0, 0, 0, 1, 0, 0, 0], 4),
        (7, [1, 0, 0, 0, 0, 0, 1, 0], 0),
        (0, [0, 0, 1, 0, 0, 0, 1, 0], 2),
    ],
)
def test_ties_go_to_the_least_rotation(facing, values, expected):
    assert grid.least_rotation_argmax(np.array(values, dtype=np.float32), facing) == expected


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"slip_probability": 1.5}, "slip_probability"),
        ({"step_limit": 0}, "step_limit"),
        ({"approach_coefficient": 0.5}, "approach_coefficient"),
        ({"features": ("d", "g")}, "features = d, g .*lone robot"),
    ],
)
def test_unusable_interpretations_are_refused(wrong, message):
    with pytest.raises(UserError, match=message):
        process_of("1a", **wrong)


def test_few_starts_are_all_there_but_those_in_contact():
    rows = (tuple((x, 0) for x in range(0, 10, 2)), ((0, 3), (8, 3)), ((4, 12),))
    scenario = Scenario("few", "", ((2, 20), (12, 20), (22, 20)), rows)
    expected = [
        starts
        for starts in itertools.product(*rows)
        if all(math.dist(a, b) > 5 for a, b in itertools.combinations(starts, 2))
    ]
    found = joint_starts(build_process(scenario, ProcessConfig()))
    assert [tuple(map(tuple, starts)) for starts in found.tolist()] == expected


def test_many_starts_are_drawn_always_the_same():
    scenario = find_scenario("6-swap")
    process = build_process(scenario, ProcessConfig())
    starts = joint_starts(process)
    assert starts.shape == (MAX_STARTS, 6, 2)
    assert np.array_equal(starts, joint_starts(process))
    for robot, cells in enumerate(scenario.starts):
        assert set(map(tuple, starts[:, robot].tolist())) == set(cells)
    for i, j in itertools.combinations(range(6), 2):
        assert ((starts[:, i] - starts[:, j]) ** 2).sum(axis=1).min() > 25


def test_drawn_starts_have_an_interval_and_all_starts_have_none():
    def untrained(name):
        config = PolicyConfig(find_scenario(name), ProcessConfig(), LearningConfig(), Seed(0))
        state = initial_state(build_process(config.scenario, config.process), config.learning, 0)
        return Policy(config, state.q, state.visits, state.random)

    drawn, exact = grid_row("drawn", untrained("4-cross")), grid_row("all", untrained("1b"))
    assert (drawn.starts, drawn.success, drawn.success_low) == (10_000, 0.0, 0.0)
    # Wilson: z²/(n + z²)
    assert drawn.success_high is not None
    assert math.isclose(drawn.success_high, 1.96**2 / (10_000 + 1.96**2), rel_tol=1e-3)
    assert (exact.starts, exact.success_low, exact.success_high) == (116, None, None)


@pytest.mark.parametrize(
    ("per", "expected"), [("step", [-1.0, -1.0]), ("time", [-0.05] * 2), ("distance", [-0.3, 0.0])]
)
def test_what_a_step_costs(per, expected):
    """Far from each other robots pay the cost of a step only."""
    process = build_process(find_scenario("2"), ProcessConfig(reward_per=per))
    cells = np.array([(2, 25), (25, 2)])
    step: Any = SimpleNamespace(
        action=np.array([0, 4]),
        events=np.full(2, RUNNING),
        after=Observation(cells, *np.zeros((3, 2), dtype=int)),
        duration_s=0.1,
        moved_m=np.array([0.003, 0.0]),
    )
    parts = reward_parts(process, step, np.zeros(2, dtype=bool))
    assert parts.sum(axis=1) == pytest.approx(expected)

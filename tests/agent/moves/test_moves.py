"""Moves that last: the grid's process where they take one RL step, learning, and observation."""

import json
import math
import re
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agent.mdp import grid
from agent.mdp.config import ProcessConfig
from agent.mdp.interpretations import build_process
from agent.mdp.rng import next_word, seeded_state
from agent.moves import kernels, observe
from agent.moves.model import NO_DIRECTION, Move, ObservedMoves, build_model
from agent.moves.observe import move_rows, observe_moves
from agent.moves.worlds import RANGES, draw_world
from agent.training.loop import learn
from agent.training.moves_qlearning import _discounts
from agent.training.policy import Policy, PolicyConfig, Seed
from agent.training.settings import LearningConfig
from cosim.base.errors import UserError
from cosim.model.config import CoSimConfig
from cosim.model.outcome import COLLISION, OUT_OF_BOARD, RUNNING
from cosim.model.params import TIMING
from cosim.model.scenario import Scenario
from cosim.model.scenario_file import find_scenario
from cosim.onboard.features import DIRECTIONS
from fmus.build import cached_fmu

RL_STEP_S = TIMING.rl_step_s
STARTS = ((1, 10), (2, 10)), ((10, 1), (9, 1))
SMALL = Scenario("small", "", ((1, 1), (10, 10)), STARTS, columns=12, rows=12, zone=(5, 5, 6, 6))


def ideal_moves(duration_s=RL_STEP_S, turn_s=0.0, drift=0.0, stop=0.0):
    """Every kind of move once, heading east or north-east; drift and stop point north-west."""
    how: Any = turn_s, duration_s, -drift, drift, -stop, stop
    moves = [
        Move(direction, heading, NO_DIRECTION, *DIRECTIONS[direction].tolist(), *how)
        for direction in (0, 1)
        for heading in range(4)
    ]
    return ObservedMoves("ideal", 0, tuple(moves))


def pair_at(process, *cells):
    world = np.zeros((len(cells), grid.COLUMN_COUNT), dtype=np.int64)
    assert grid.place(process, world, np.array(cells, dtype=np.int64))
    plans = np.zeros((len(cells), kernels.PLAN_SIZE))
    kernels.reset_plans(build_model(ideal_moves(), 5.0), world, plans, seeded_state(0))
    return world, plans


def begun(process, moves, cells, directions):
    """Robots that have begun a move each; a function that plays RL steps, and their rewards."""
    model, random, rewards = build_model(moves, 5.0), seeded_state(0), np.zeros(len(cells), "f4")
    world, plans = pair_at(process, *cells)
    for robot, direction in enumerate(directions):
        first = kernels.begin_move(process, model, world, plans, robot, direction, random)
        assert first == RUNNING
    return world, plans, lambda: kernels.step(process, model, world, plans, rewards), rewards


@pytest.mark.long
def test_moves_of_one_step_are_the_grid():
    process = build_process(find_scenario("4"), ProcessConfig(clearance_m=0.0))
    model = build_model(ideal_moves(), 5.0)
    rng, random = np.random.default_rng(0), seeded_state(0)
    compared = 0
    for _ in range(50):
        cells = rng.integers(3, 27, (2, 2))
        if ((cells[0] - cells[1]) ** 2).sum() <= 49:
            continue
        on_grid, _ = pair_at(process, *cells)
        world, plans = pair_at(process, *cells)
        expected, rewards = np.zeros(2, dtype=np.float32), np.zeros(2, dtype=np.float32)
        for _ in range(20):
            actions = rng.integers(0, 8, 2)
            outcome = grid.move(process, on_grid, actions, expected)
            begun = RUNNING
            for robot in np.flatnonzero(world[:, grid.STATUS] == grid.MOVING):
                begun = begun or kernels.begin_move(
                    process, model, world, plans, int(robot), int(actions[robot]), random
                )
            if begun:
                assert outcome == begun
                break
            after, _ = kernels.step(process, model, world, plans, rewards)
            if grid.touched_between(on_grid, 0, 1, 25):
                break  # the grid looks at the ends of moves only
            assert after == outcome
            if outcome:
                break
            compared += 1
            assert rewards == pytest.approx(expected)
            columns = [grid.X, grid.Y, grid.STATUS, grid.CLASS, grid.SIGN, grid.AXIS]
            moving = world[:, grid.STATUS] == grid.MOVING
            assert np.array_equal(world[:, : grid.Y + 1], on_grid[:, : grid.Y + 1])
            assert np.array_equal(world[moving][:, columns], on_grid[moving][:, columns])
    assert compared > 200


@pytest.mark.long
def test_a_robot_turns_then_drives_then_waits():
    process = build_process(find_scenario("1a"), ProcessConfig())
    moves, north = ideal_moves(duration_s=7.0, turn_s=3.0, drift=0.1, stop=0.05), 2
    world, plans, step, _ = begun(process, moves, [(5, 5)], [north])
    positions = []
    for _ in range(4):
        assert not kernels.waits(plans, 0)
        step()
        positions.append(plans[0, [kernels.AT_X, kernels.AT_Y]].tolist())
    assert kernels.waits(plans, 0)
    # north-west of a move to the east is south-west of one to the north
    assert positions[0] == pytest.approx([5.5 - 0.1 * 2 / 3, 5.5 - 0.1 * 2 / 3])
    share = 1.0 / 4.0  # of the path after the turn, 4 s after the beginning
    assert positions[1] == pytest.approx([5.4 + share * 0.05, 5.4 + share * 1.05])
    assert positions[3] == pytest.approx([5.45, 6.45])
    assert world[0, [grid.X, grid.Y, grid.AXIS]].tolist() == [5, 6, north]


@pytest.mark.long
def test_robots_that_meet_between_cells_collide():
    """And a robot apart from them earns the reward of its step."""
    starts = (((2, 5),), ((8, 5),), ((5, 14),))
    three = Scenario("three", "", ((2, 25), (9, 25), (16, 25)), starts)
    process = build_process(three, ProcessConfig())
    cells = [own[0] for own in starts]
    world, _, step, rewards = begun(process, ideal_moves(duration_s=4.0), cells, (0, 4, 6))
    assert step()[0] == COLLISION
    assert world[:, grid.STATUS].tolist() == [grid.HIT, grid.HIT, grid.MOVING]
    # closing in: from cell (5, 14) to (2, 5) when it decided, to (3, 5) now
    nearest = math.hypot(2, 9)
    assert rewards.tolist() == pytest.approx([-100.0, -100.0, -1.5 * (1 - nearest / 10) - 1])


def test_a_robot_that_strays_to_an_obstacle_collides():
    """From a cell that is free to one that is free, along a path or to an end that is not."""
    moves = [ideal_moves(duration_s=3.0), ideal_moves(duration_s=3.0, stop=0.3)]
    # a robot of 4 cm in the middle of a cell three cells beside an obstacle has 5 mm left
    board = Scenario(
        "b", "", ((9, 9),), (((2, 2),),), 12, 12, obstacles=((5, 2),), zone=(5, 5, 6, 6),
        robot_diameter_m=0.04,
    )  # fmt: skip
    process = build_process(board, ProcessConfig())
    rewards, outcomes = np.zeros(1, dtype=np.float32), []
    for observed, start, direction in [
        (moves[0], (2, 3), 6),
        (moves[1], (2, 3), 6),  # stops 3 mm to the east of the middle: 2 mm are left
        (ideal_moves(duration_s=3.0, stop=0.6), (2, 3), 6),
        (moves[0], (2, 2), 0),  # into a blocked cell
    ]:
        model = build_model(observed, 5.0)
        world, plans = pair_at(process, start)
        outcome = kernels.begin_move(process, model, world, plans, 0, direction, seeded_state(0))
        while outcome == RUNNING and not kernels.waits(plans, 0):
            outcome, _ = kernels.step(process, model, world, plans, rewards)
        outcomes.append(outcome)
    assert outcomes == [RUNNING, RUNNING, COLLISION, COLLISION]
    assert rewards.tolist() == [-100.0]


@pytest.mark.parametrize(
    ("stop", "start", "direction", "outcome"),
    [
        (0.0, (9, 9), 1, COLLISION),  # into the other's target
        (0.2, (9, 10), 1, RUNNING),  # over its upper left corner, to the left of it
        (-0.2, (9, 10), 1, COLLISION),  # to the right of the corner: through the cell
        (0.0, (9, 10), 2, RUNNING),  # past it
    ],
)
def test_a_robot_whose_centre_passes_through_anothers_target_collides(
    stop, start, direction, outcome
):
    process = build_process(SMALL, ProcessConfig())
    model = build_model(ideal_moves(duration_s=2.0, stop=stop), 5.0)
    world, plans = pair_at(process, start, (2, 2))
    rewards = np.zeros(2, dtype=np.float32)
    found = kernels.begin_move(process, model, world, plans, 0, direction, seeded_state(0))
    if found == RUNNING:
        found, _ = kernels.step(process, model, world, plans, rewards)
        assert (rewards[0] == -100.0) == (outcome == COLLISION)
    assert found == outcome
    assert (world[0, grid.STATUS] == grid.HIT) == (outcome == COLLISION)


def test_a_robot_that_drifts_off_the_board_while_it_turns_is_lost():
    process = build_process(SMALL, ProcessConfig())
    moves = ideal_moves(3.0 * RL_STEP_S, turn_s=1.5 * RL_STEP_S, drift=2.0)
    world, _, step, rewards = begun(process, moves, [(0, 10), (10, 1)], [0])
    assert step()[0] == OUT_OF_BOARD
    assert world[:, grid.STATUS].tolist() == [grid.LEFT, grid.MOVING]
    assert world[0, : grid.Y + 1].tolist() == [0, 11]
    assert rewards[0] == -process.goal_reward
    assert rewards[1] > rewards[0]


def test_a_robot_keeps_the_world_that_it_drew():
    """All of a robot's moves are of one walk; the next episode may draw another."""
    process = build_process(SMALL, ProcessConfig())
    walks = [ideal_moves(duration_s=s).moves for s in (1.0, 2.0, 3.0)]
    observed = ObservedMoves("", 0, sum(walks, ()), walks=tuple(len(walk) for walk in walks))
    model, random = build_model(observed, 5.0), seeded_state(0)
    durations = np.zeros((20, 6))
    for episode in durations:
        world, plans = pair_at(process, (2, 2), (10, 10))
        kernels.reset_plans(model, world, plans, random)
        for move in range(len(episode)):
            kernels.begin_move(process, model, world, plans, 0, move % 3, random)
            episode[move] = plans[0, kernels.DURATION_S]
    assert (durations == durations[:, :1]).all()
    assert set(durations[:, 0]) == {1.0, 2.0, 3.0}


@pytest.mark.parametrize(("reward_per", "shares"), [("time", (1.0, 0.55)), ("step", (20.0, 11.0))])
def test_steps_in_which_nobody_is_asked_pass_at_once(reward_per, shares):
    """Paid for time, twenty short ones pay as one of 2 s does; paid for steps, each does."""
    process = build_process(SMALL, ProcessConfig(reward_per=reward_per))
    lasting = ideal_moves(duration_s=3.05)
    short = ObservedMoves("", 0, lasting.moves, rl_step_s=0.1)
    earned, passed = [], []
    for observed in (lasting, short):
        _, plans, step, rewards = begun(process, observed, [(2, 10), (10, 2)], (0, 4))
        for _ in range(2):
            outcome, steps = step()
            assert outcome == RUNNING
            earned.append(float(rewards[0]))
            passed.append(steps)
        assert kernels.waits(plans, 0)
    assert passed == [1, 1, 20, 11]
    assert earned[2:] == pytest.approx([shares[0] * earned[0], shares[1] * earned[1]])
    exponents = np.arange(21) / (20.0 if reward_per == "time" else 1.0)
    assert _discounts(process, build_model(short, 5.0), np.float32(0.9)) == pytest.approx(
        0.9**exponents, rel=1e-6
    )


def test_rewards_per_distance_pay_for_the_path():
    process = build_process(SMALL, ProcessConfig(reward_per="distance"))
    cells = [(1, 10), (10, 1)]  # too far apart to be near
    *_, step, rewards = begun(process, ideal_moves(duration_s=4.0, turn_s=2.0), cells, (1, 4))
    for expected in ([0.0, 0.0], [-math.sqrt(2.0), -1.0]):
        step()
        assert rewards.tolist() == pytest.approx(expected, abs=1e-6)


@pytest.mark.long
def test_training_on_moves_reaches_the_targets():
    config = PolicyConfig(
        SMALL,
        ProcessConfig(features=("x", "y", "d", "g", "b")),
        LearningConfig(episodes=60_000, eta=0.05, greedy_points=0, epsilon_episodes=10),
        Seed(0),
        ideal_moves(duration_s=3.5, turn_s=0.5),
    )
    policy, log = learn(config)
    assert log.success[-1] > 0.97
    again, _ = learn(config)
    assert np.array_equal(policy.q, again.q)


@pytest.mark.long
def test_double_q_learning_on_moves_is_that_of_a_plain_loop():
    """One robot, two tables: one picks the next action, the other says what it is worth."""
    alone = Scenario(
        "alone", "", ((4, 4),), (((0, 0), (1, 3)),), columns=6, rows=6, zone=(0, 0, 0, 0)
    )
    learning = LearningConfig(episodes=40, eta=0.5, greedy_points=0, exploration=1.0)
    moves = ideal_moves(duration_s=2.5 * RL_STEP_S)
    features = ProcessConfig(features=("x", "y"))
    config = PolicyConfig(alone, features, learning, Seed(1), moves, "double_q")
    policy, _ = learn(config)

    process, model = build_process(alone, config.process), build_model(moves, 5.0)
    world = np.zeros((1, grid.COLUMN_COUNT), dtype=np.int64)
    plans, cells = np.zeros((1, kernels.PLAN_SIZE)), np.zeros((1, 2), dtype=np.int64)
    random, rewards = seeded_state(1), np.zeros(1, dtype=np.float32)
    q = np.zeros((2, process.state_count, 8))
    for _ in range(learning.episodes):
        grid.place_randomly(process, world, cells, random)
        kernels.reset_plans(model, world, plans, random)
        outcome = RUNNING
        while outcome == RUNNING:
            state = int(grid.state_index(process, world, 0))
            action, word = int(q.sum(axis=0)[state].argmax()), int(next_word(random))
            if word >> 11 < round(0.9 * 2**53):
                action = word % 8
            outcome = kernels.begin_move(process, model, world, plans, 0, action, random)
            target, steps = (0.0, 0) if outcome == RUNNING else (-100.0, 0)
            while outcome == RUNNING and not kernels.waits(plans, 0):
                outcome, _ = kernels.step(process, model, world, plans, rewards)
                target += 0.99**steps * rewards[0]
                steps += 1
            table = int(next_word(random)) & 1
            if outcome == RUNNING:
                after = int(grid.state_index(process, world, 0))
                target += 0.99**steps * q[1 - table, after, q[table, after].argmax()]
            q[table, state, action] += 0.5 * (target - q[table, state, action])
    assert policy.q[:, 0] == pytest.approx(q, abs=1e-3)
    assert np.abs(q).max(axis=(1, 2)).min() > 10.0


@pytest.mark.parametrize(
    ("process", "on_moves", "message"),
    [
        ({"diagonal_cost": 1.5}, True, "diagonal_cost = 1.5 .* on moves.* at 1.0"),
        ({"collision": "swept"}, True, "collision = swept .* on moves.* at cells"),
        ({"partner_of_failed": "none"}, True, "partner_of_failed = none .* at ordinary"),
        ({"slip_probability": 0.2}, True, "slip_probability = 0.2 .* at 0.0"),
        ({"clearance_m": 0.003}, False, "clearance_m = 0.003 .* on the grid.* at 0.002"),
    ],
)
def test_interpretations_without_effect_are_refused_by_name(
    process, on_moves, message, command, tmp_path
):
    """In Python, on the command line and from a settings file, before anything is written."""
    (name, value), moves = *process.items(), ideal_moves()
    learning = LearningConfig(episodes=10, greedy_points=0)
    other = ProcessConfig(**process)
    assert PolicyConfig(SMALL, other, learning, Seed(0), None if on_moves else moves)
    with pytest.raises(UserError, match=message):
        PolicyConfig(SMALL, other, learning, Seed(0), moves if on_moves else None)
    file, settings, out = (tmp_path / f for f in ("moves.json", "settings.toml", "out"))
    moves.save(file)
    settings.write_text(f"[process]\n{name} = {json.dumps(value)}\n")
    arguments = ["--scenario", "2", "--out", str(out), "--learning.episodes", "10"]
    arguments += ["--moves", str(file)] if on_moves else []
    for own in ([f"--process.{name}", str(value)], ["--config", str(settings)]):
        ended = command("train", *arguments, *own)
        assert ended.returncode == 2
        assert re.search(message, ended.stderr)
    assert not out.exists()


def test_a_policy_and_a_file_keep_moves(tmp_path):
    learning, moves = LearningConfig(episodes=10, greedy_points=0), ideal_moves()
    moves.save(tmp_path / "moves.json")
    assert ObservedMoves.load(tmp_path / "moves.json") == moves
    config = PolicyConfig(SMALL, ProcessConfig(), learning, Seed(0), moves)
    policy, _ = learn(config)
    policy.save(tmp_path / "policy.npz")
    assert Policy.load(tmp_path / "policy.npz").config == config


@pytest.mark.parametrize("content", [None, "", "[]", '{"schema_version": 9}', '{"moves": 3}'])
def test_a_wrong_file_is_refused_in_one_sentence(tmp_path, content):
    path = tmp_path / "moves.json"
    if content is not None:
        path.write_text(content)
    with pytest.raises(UserError, match=r"moves\.json.*minirobots moves"):
        ObservedMoves.load(path)


def test_moves_of_robots_that_are_seldom_asked_or_of_few_kinds_are_refused(command, tmp_path):
    seldom = msgspec.structs.replace(ideal_moves(), rl_step_s=7.0)
    with pytest.raises(UserError, match=r"RL step of 7 s .*; .* at most 2 s"):
        build_model(seldom, 5.0)
    with pytest.raises(UserError, match="more moves"):
        build_model(ObservedMoves("", 0, ideal_moves().moves[:3]), 5.0)
    ended = command("moves", "--rl-step", 7, "--out", tmp_path / "moves.json")
    assert ended.returncode == 2
    assert "with an --rl-step of at most 2 s" in ended.stderr


def test_rewards_per_time_have_no_effect_where_robots_are_asked_every_two_seconds():
    process = ProcessConfig(reward_per="time")
    with pytest.raises(UserError, match=r"reward_per = time .* RL step of 2 s"):
        PolicyConfig(SMALL, process, LearningConfig(), Seed(0), ideal_moves())
    often = msgspec.structs.replace(ideal_moves(), rl_step_s=0.1)
    assert PolicyConfig(SMALL, process, LearningConfig(), Seed(0), often)


@pytest.mark.parametrize("rl_step_s", [0.1, 0.8, 1.5])
def test_rewards_per_time_pay_for_two_seconds(rl_step_s):
    moves = msgspec.structs.replace(ideal_moves(), rl_step_s=rl_step_s)
    model = build_model(moves, 5.0)
    process = build_process(SMALL, ProcessConfig(reward_per="time"))
    discounts = _discounts(process, model, np.float32(0.9))
    assert discounts[1] == pytest.approx(0.9 ** (rl_step_s / 2.0), rel=1e-6)


@pytest.mark.long
def test_moves_are_observed_on_the_cells_of_the_scenario(monkeypatch, tmp_path):
    monkeypatch.setattr(observe, "WALKS", 1)
    small, large = (
        observe_moves(CoSimConfig(), cached_fmu(), moves_per_kind=1, cell_m=cell_m, jobs=1)
        for cell_m in (0.01, 0.02)
    )
    driven_s = [np.mean([m.duration_s - m.turn_s for m in of.moves]) for of in (small, large)]
    assert driven_s[1] == pytest.approx(2.0 * driven_s[0], rel=0.2)
    assert all((m.columns, m.rows) == tuple(DIRECTIONS[m.direction]) for m in large.moves)
    large.save(tmp_path / "moves.json")
    assert ObservedMoves.load(tmp_path / "moves.json").cell_m == 0.02
    with pytest.raises(UserError, match=r"cells of 0.02 m do not fit scenario .* --cell 0.01"):
        PolicyConfig(SMALL, ProcessConfig(), LearningConfig(), Seed(0), large)


@given(
    cell_m=st.floats(1e-3, 1.0),
    speed_m_s=st.floats(1e-4, 0.05),
    rate=st.floats(0.01, 3.0),
    backward_speed_rad_s=st.sampled_from([0.0, 900.0]),
)
def test_a_move_may_last_several_times_what_it_needs(cell_m, speed_m_s, rate, backward_speed_rad_s):
    own = {"drive_speed_m_s": speed_m_s, "turn_rate_rad_s": rate}
    config = CoSimConfig().having("test", **own, backward_speed_rad_s=backward_speed_rad_s)
    turn_rad = 0.5 * math.pi if backward_speed_rad_s else math.pi
    needed_s = turn_rad / rate + math.sqrt(2.0) * cell_m / speed_m_s
    assert config.move_limit_s(cell_m) > 3.0 * needed_s
    assert config.move_limit_s(cell_m) >= CoSimConfig().move_limit_s(0.01) == TIMING.move_limit_s


SLOW = {"drive_speed_m_s": 8e-4, "forward_speed_rad_s": 680.0, "backward_speed_rad_s": 680.0}


@pytest.mark.parametrize(
    ("cell_m", "own"),
    [
        pytest.param(0.2, {}, marks=pytest.mark.long),
        pytest.param(0.03, SLOW, marks=pytest.mark.slow),
    ],
)
def test_moves_that_take_longer_are_observed_to_their_ends(monkeypatch, cell_m, own):
    """On large cells, and of a slow machine."""
    monkeypatch.setattr(observe, "WALKS", 1)
    config = CoSimConfig().having("test", **own)
    moves = observe_moves(config, cached_fmu(), moves_per_kind=1, cell_m=cell_m, jobs=1)
    for move in moves.moves:
        ended = DIRECTIONS[move.direction].tolist()
        assert (move.columns, move.rows) == tuple(ended)
        length_m = cell_m * math.hypot(*ended)
        driven_m = config.steering.drive_speed_m_s * (move.duration_s - move.turn_s)
        assert driven_m == pytest.approx(length_m, rel=0.2)
    assert max(move.duration_s for move in moves.moves) > 40.0


@pytest.mark.parametrize(
    ("own", "words"),
    [
        (
            {"forward_speed_rad_s": 300.0, "backward_speed_rad_s": 300.0},
            r"machine paper .* mu = 0\.15 .* 10 mm it drove for 40 s",
        ),
        ({"turn_speed_rad_s": 300.0, "move_limit_s": 4.0}, r"it turned for 4 s"),
    ],
)
def test_a_move_that_does_not_end_is_refused(monkeypatch, own, words):
    monkeypatch.setattr(observe, "WALKS", 1)
    config = CoSimConfig().having("test", **own)
    with pytest.raises(UserError, match=words):
        observe_moves(config, cached_fmu(), moves_per_kind=2, jobs=1)


@pytest.mark.parametrize(
    "backward_speed_rad_s", [pytest.param(0.0, marks=pytest.mark.long), 1023.5]
)
def test_a_machine_that_cannot_reverse_is_seen_to_turn_around(monkeypatch, backward_speed_rad_s):
    monkeypatch.setattr(observe, "WALKS", 1)
    config = CoSimConfig().having("test", backward_speed_rad_s=backward_speed_rad_s)
    moves = observe_moves(config, cached_fmu(), moves_per_kind=1, jobs=1)
    turns = {moves.kind_of(move): move.turn_s for move in moves.moves}
    assert len(turns) == moves.kinds == (8 if backward_speed_rad_s else 16)
    assert (turns.get(4, 0.0) > 12.0) == (not backward_speed_rad_s)  # half a turn
    assert len(move_rows(moves)[1]) == moves.kinds
    shown = [row[0] for row in move_rows(moves)[1]]
    assert ("straight after +180 deg" in shown) == (not backward_speed_rad_s)
    config = PolicyConfig(
        SMALL, ProcessConfig(features=("x", "h")), LearningConfig(), Seed(0), moves
    )
    assert config.build().state_count == SMALL.columns * moves.facings


def test_rows_of_moves_name_the_turn_that_is_made_first():
    """Counter-clockwise from what the robot faces, or its back, to where it goes."""
    moves = ideal_moves()
    labels = [row[0] for row in move_rows(moves)[1]]
    for move in moves.moves:
        turn = 45 * ((move.direction - move.heading + 1) % 4 - 1)
        kind = "diagonal" if move.direction % 2 else "straight"
        assert labels[moves.kind_of(move)] == f"{kind} after {turn:+d} deg"


@pytest.mark.long
def test_moves_are_observed_in_the_co_simulation(monkeypatch):
    monkeypatch.setattr(observe, "WALKS", 2)
    motor_fmu = cached_fmu()
    moves = observe_moves(CoSimConfig(), motor_fmu, moves_per_kind=2, jobs=2)
    again = observe_moves(CoSimConfig(), motor_fmu, moves_per_kind=2, jobs=1)
    assert moves == again
    kinds = [moves.kind_of(move) for move in moves.moves]
    assert min(kinds.count(kind) for kind in range(8)) >= 2
    for move in moves.moves:
        assert (move.columns, move.rows) == tuple(DIRECTIONS[move.direction])
        assert 0.0 <= move.turn_s < move.duration_s < TIMING.move_limit_s
        assert math.hypot(move.stop_x, move.stop_y) < 0.3
    build_model(moves, 5.0)


SIDE, REACH = 400, 14


def test_worlds_are_within_their_ranges():
    rng = np.random.default_rng(0)
    worlds = [draw_world(RANGES, SIDE, REACH, rng) for _ in range(200)]
    for name in ("mu", "motor_spread", "restitution", "floor_tilt_deg", "payload_g"):
        low, high = getattr(RANGES, name)
        drawn = np.array([getattr(world, name) for world in worlds])
        assert low <= drawn.min() < low + 0.05 * (high - low)
        assert high - 0.05 * (high - low) < drawn.max() <= high
    for world in worlds:
        assert len(world.mu_patches) == RANGES.patches
        for patch in world.mu_patches:
            left, bottom, right, top = patch.cells
            assert abs(left - SIDE // 2) <= REACH
            assert RANGES.patch_cells[0] <= right - left + 1 <= RANGES.patch_cells[1]
            assert bottom <= top
        assert world.camera.rate_hz >= RANGES.rate_hz[0]
    assert len(set(map(repr, worlds))) == len(worlds)


@pytest.mark.long
def test_every_walk_has_a_world_of_its_own(monkeypatch):
    """In one batch, and the same whatever else is in it."""
    monkeypatch.setattr(observe, "WALKS_OF_WORLDS", 2)
    seen = []
    begin = observe.Batch.begin

    def watched(batch, *arguments):
        seen.append(arguments[-1].world)
        return begin(batch, *arguments)

    monkeypatch.setattr(observe.Batch, "begin", watched)
    config = CoSimConfig()
    walked = [
        observe.observe_moves(config, cached_fmu(), worlds=RANGES, moves_per_kind=1, jobs=jobs)
        for jobs in (1, 2)
    ]
    assert walked[0] == walked[1]
    assert len(walked[0].walks) == observe.WALKS_OF_WORLDS
    assert sum(walked[0].walks) == len(walked[0].moves) >= 2 * 8
    assert seen[0] != seen[1]
    assert seen[:2] == sorted(seen[2:], key=seen[:2].index)
    ideal = observe.source_digest(config, cached_fmu())
    assert walked[0].source != ideal

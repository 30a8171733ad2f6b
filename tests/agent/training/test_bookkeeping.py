"""Learning curves and exact evaluations, against episodes that can be counted by hand.

Every robot drives in one direction only, as its table says, from start cells that end the episode
in all ways: all numbers of an episode follow from its start cells.
"""

import math

import numpy as np
import pytest

from agent.mdp.config import ProcessConfig
from agent.mdp.exact import evaluate_on_grid, joint_starts
from agent.mdp.interpretations import build_process
from agent.study.grid import grid_row
from agent.training.learning import build_learning, initial_state
from agent.training.loop import move_model, training_log
from agent.training.moves_qlearning import advance_moves
from agent.training.policy import Policy, PolicyConfig, Seed
from agent.training.qlearning import advance
from agent.training.settings import LearningConfig
from cosim.model.outcome import COLLISION, OUT_OF_BOARD, SUCCESS
from cosim.model.scenario import Scenario
from tests.agent.moves.test_moves import ideal_moves

EAST, NORTH_EAST = 0, 1
# robot 1 drives east and robot 2 north-east; further apart than D, a move costs 1
BOARD = Scenario(
    "counted", "", ((8, 2), (8, 28)),
    (((5, 2), (3, 2), (2, 9)), ((6, 26), (3, 23), (5, 29))), zone=(0, 0, 0, 0),
    obstacles=((15, 12),), cell_m=0.01, columns=40, rows=30,
)  # fmt: skip


def episode(starts, at_once=False):
    """Return outcome, mean path in cells, mean moves, and return of each robot.

    With `at_once` a robot fails as it begins the move, for which others are not paid any more.
    """
    ends = []  # of each robot: move with which it ends, and how
    for (x, y), target, step in zip(starts, BOARD.targets, ((1, 0), (1, 1)), strict=True):
        for move in range(1, 100):
            at = x + move * step[0], y + move * step[1]
            if at == target:
                ends.append((move, SUCCESS))
                break
            if not (at[0] < BOARD.columns and at[1] < BOARD.rows):
                ends.append((move, OUT_OF_BOARD))
                break
            if math.dist((max(15, min(at[0] + 0.5, 16)), max(12, min(at[1] + 0.5, 13))),
                         (at[0] + 0.5, at[1] + 0.5)) <= 2.5:  # fmt: skip
                ends.append((move, COLLISION))
                break
    failing = [move for move, end in ends if end != SUCCESS]
    last = min(failing) if failing else max(move for move, _ in ends)
    moves = [min(move, last) for move, _ in ends]
    outcome = max((end for move, end in ends if move <= last), default=SUCCESS)
    if not failing:
        outcome = SUCCESS
    returns = []
    for (move, end), made in zip(ends, moves, strict=True):
        unpaid = move == made or (at_once and failing)
        ended = (100 if end == SUCCESS else -100) if move == made else 0
        returns.append(float(ended - (made - bool(unpaid))))
    path = (moves[0] + math.sqrt(2.0) * moves[1]) / 2.0
    return outcome, path, sum(moves) / 2.0, returns


def settings(moves, episodes=200, log=1, window=1):
    config = LearningConfig(
        episodes=episodes, eta=1e-60, epsilon=0.0, log_episodes=log, log_window=window,
        greedy_points=0,
    )  # fmt: skip
    return PolicyConfig(BOARD, ProcessConfig(), config, Seed(3), moves)


def trained(moves, log=1, window=1):
    config = settings(moves, log=log, window=window)
    process = build_process(BOARD, config.process)
    state = initial_state(process, config.learning, 3)
    state.q[0, 0, :, EAST] = state.q[0, 1, :, NORTH_EAST] = 1.0
    learning, model = build_learning(config.learning), move_model(config)
    if model is None:
        advance(process, learning, state, config.learning.episodes)
    else:
        advance_moves(process, model, learning, state, config.learning.episodes)
    return training_log(config.learning, state, BOARD.cell_m)


@pytest.mark.parametrize("moves", [None, ideal_moves()], ids=["grid", "moves"])
def test_learning_curves_are_those_of_their_episodes(moves):
    log, expected = trained(moves), {}
    for starts in joint_starts(build_process(BOARD, ProcessConfig())).tolist():
        outcome, path, steps, returns = episode(starts, at_once=moves is not None)
        expected[tuple(returns)] = (outcome == SUCCESS, path, steps)
    assert {success for success, *_ in expected.values()} == {True, False}
    rows = [tuple(row) for row in log.returns.tolist()]
    assert set(rows) == set(expected)
    for row, success, path_cm, steps in zip(
        rows, log.success, log.path_length_cm, log.steps, strict=True
    ):
        assert success == expected[row][0]
        if success:
            assert (path_cm, steps) == pytest.approx(expected[row][1:])
        else:
            assert np.isnan([path_cm, steps]).all()


@pytest.mark.parametrize("moves", [None, ideal_moves()], ids=["grid", "moves"])
def test_points_of_learning_curves_are_means_over_their_windows(moves):
    single, log = trained(moves), trained(moves, log=5, window=3)
    last = np.arange(5, 201, 5)[:, None] - (3, 2, 1)
    assert log.episode.tolist() == list(range(5, 201, 5))
    assert log.success == pytest.approx(single.success[last].mean(axis=1))
    assert log.returns == pytest.approx(single.returns[last].mean(axis=1))
    known = log.success > 0
    for name in ("path_length_cm", "steps"):
        means = np.nanmean(getattr(single, name)[last[known]], axis=1)
        assert getattr(log, name)[known] == pytest.approx(means)


def test_an_exact_evaluation_has_means_over_successes_alone():
    config = settings(None)
    process = build_process(BOARD, config.process)
    values = np.zeros((2, process.state_count, 8), np.float32)
    values[0, :, EAST] = values[1, :, NORTH_EAST] = 1.0
    found = evaluate_on_grid(process, values)
    episodes = [episode(starts) for starts in found.starts.tolist()]
    assert found.outcome.tolist() == [outcome for outcome, *_ in episodes]
    assert {*found.outcome.tolist()} == {SUCCESS, COLLISION, OUT_OF_BOARD}
    assert found.path_cells.mean(axis=1) == pytest.approx([path for _, path, *_ in episodes])
    assert found.steps.mean(axis=1) == pytest.approx([steps for *_, steps, _ in episodes])
    succeeded = [row for row in episodes if row[0] == SUCCESS]
    visits, unused = np.ones(values.shape[:2], np.uint32), np.zeros(1, np.uint64)
    report = grid_row("forced", Policy(config, values[None], visits, unused, 0))
    assert report.path_length_cm == pytest.approx(np.mean([row[1] for row in succeeded]))
    assert report.steps == pytest.approx(np.mean([row[2] for row in succeeded]))
    assert report.success == len(succeeded) / len(episodes)
    assert report.failing_starts == len(episodes) - len(succeeded)

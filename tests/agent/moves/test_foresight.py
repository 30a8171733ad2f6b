"""What robots may expect on observed moves, against paths that are known."""

import numpy as np
import pytest

from agent.mdp.config import ProcessConfig
from agent.mdp.exact import evaluate
from agent.mdp.readings import build_process
from agent.mdp.rng import seeded_state
from agent.moves.foresight import foresee
from agent.moves.model import build_model
from cosim.model.outcome import SUCCESS
from cosim.model.params import TIMING
from cosim.model.scenario import Scenario
from tests.agent.moves.test_moves import ideal_moves

EAST, NORTH = 0, 2
CONTACT = 0.5  # cells


@pytest.mark.parametrize("delay", [0, 4, 5])
def test_gaps_and_times_of_paths_that_cross(delay):
    targets = ((24, 12), (12, 24))
    board = Scenario("crossing", "", targets=targets, starts=(((6, 12),), ((12, 6 - delay),)))
    process = build_process(board, ProcessConfig())
    values = np.zeros((2, process.state_count, 8), dtype=np.float32)
    values[0, :, EAST], values[1, :, NORTH] = 1.0, 1.0
    starts = np.array(board.starts).transpose(1, 0, 2)
    model = build_model(ideal_moves(), CONTACT)
    gaps, seconds = foresee(process, model, values, starts, 3, seeded_state(0))
    # The second one is some cells late, and is nearest when both are half of that away.
    assert gaps == pytest.approx([max(delay / np.sqrt(2.0) - CONTACT, 0.0)])
    moves = 18 + delay if delay else 6
    assert seconds == pytest.approx([moves * TIMING.rl_step_s])


def test_on_moves_of_one_step_robots_drive_as_on_the_grid(near_policy):
    process, values = near_policy.process, near_policy.values
    on_grid = evaluate(process, values)
    model = build_model(ideal_moves(), 0.0)
    _, seconds = foresee(process, model, values, on_grid.starts, 2, seeded_state(0))
    succeeded = on_grid.outcome == SUCCESS
    assert succeeded.sum() > 3
    expected = TIMING.rl_step_s * on_grid.steps.max(axis=1)
    assert seconds[succeeded] == pytest.approx(expected[succeeded])

"""Values of the code against those printed in the paper, copied from it and not from the code."""

import numpy as np
import pytest

from agent.mdp.config import ProcessConfig
from agent.mdp.interpretations import build_process
from agent.training.learning import EPISODES, build_learning, initial_state
from agent.training.qlearning import advance
from agent.training.settings import LearningConfig
from cosim.model.params import FIG_7, SPEED_NOISE, TABLE_I, TABLE_II, TIMING
from cosim.model.scenario_file import PAPER, find_scenario
from tests.fmus.starts import motor_starts

TABLE_1 = {
    "mass_kg": 0.1, "diameter_m": 0.05, "height_m": 0.045,
    "motor_diameter_m": 0.0044, "motor_length_m": 0.0102,
}  # fmt: skip
TABLE_2 = {
    "m": 0.00021, "r": 0.00177, "K_T": 3.64e-4, "J": 2.67e-9, "R": 10.7, "b": 2.94e-9,
    "c": 1.34e-5, "g": 9.81, "K_p": 0.015, "K_i": 0.025, "V_s_max": 3.0,
}  # fmt: skip


def test_tables_1_and_2():
    assert {name: getattr(TABLE_I, name) for name in TABLE_1} == TABLE_1
    assert {mount.place_m[2] for mount in TABLE_I.motors} == {0.003}  # height of their axes
    assert TABLE_II._asdict() == TABLE_2
    assert (FIG_7.omega_des, FIG_7.d) == (700.0, 1e-6)
    starts = motor_starts()
    assert {name: starts[name] for name in TABLE_2} == TABLE_2  # of the FMU


def test_section_3():
    process = ProcessConfig()
    # "a typical value is L = 100", "typical value of this threshold is D = 10", "- 1.0" of Eq. (11)
    assert (process.goal_reward, process.distance_limit_m, process.step_cost) == (100.0, 0.1, 1.0)
    assert process.features == ("x", "y", "d", "g")


def test_section_5():
    # "equivalent to ±5 %"; "dt = 10^-5", "2 × 10^5 integration time steps, equivalent to 2 seconds"
    assert SPEED_NOISE.relative_amplitude == 0.05
    assert (TIMING.dt_s, TIMING.rl_step_s) == (1e-5, 2.0)
    learning = LearningConfig()
    assert (learning.gamma, learning.eta, learning.epsilon) == (0.99, 0.01, 0.9)
    assert (learning.epsilon_decay, learning.epsilon_episodes) == (0.999, 500)
    assert (learning.episodes, learning.exploration) == (5_000_000, 0.6)


def edges_cm(scenario, cells) -> tuple[np.ndarray, np.ndarray]:
    """Lower left and upper right corner of a region of cells in cm."""
    corner = 100.0 * scenario.cell_m
    return corner * np.min(cells, axis=0), corner * (np.max(cells, axis=0) + 1)


@pytest.mark.parametrize("name", PAPER)
def test_section_5_places_robots_on_the_sides_of_the_board(name):
    scenario = find_scenario(name)
    board = scenario.columns, scenario.rows
    assert edges_cm(scenario, [(0, 0), np.subtract(board, 1)])[1] == pytest.approx([30.0, 30.0])
    low, high = edges_cm(scenario, np.reshape(scenario.zone, (2, 2)))
    assert high - low == pytest.approx([7.0, 7.0])
    assert np.abs((low + high) / 2.0 - 15.0).max() <= 0.5  # at the centre, to half a cell
    if name == "1b":  # "a zone of width equal to one cell on every side of the board"
        inner = {(x, y) for x in range(1, 29) for y in range(1, 29)}
        assert set(scenario.starts[0]) == {(x, y) for x in range(30) for y in range(30)} - inner
        return
    # "x ∈ [0, 30] cm and y ∈ [29, 30] cm"; the second robot likewise on the lower side
    sides = [((0.0, 29.0), (30.0, 30.0)), ((0.0, 0.0), (30.0, 1.0))]
    for cells, (lower_left, upper_right) in zip(scenario.starts, sides, strict=False):
        low, high = edges_cm(scenario, cells)
        assert low == pytest.approx(lower_left)
        assert high == pytest.approx(upper_right)


def test_curves_are_means_of_the_last_100_episodes():
    """Fig. 8: "of the last 100 episodes"; counted in what the default configuration logs."""
    process = build_process(find_scenario("1a"), ProcessConfig())
    learning = LearningConfig(episodes=3000)
    state = initial_state(process, learning, 0)
    advance(process, build_learning(learning), state, learning.episodes)
    assert state.curve[:, EPISODES].tolist() == [100.0] * 3

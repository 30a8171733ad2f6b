"""The safety layer: geometry of plans, and who waits or yields."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cosim.base.config import CoSimConfig
from cosim.base.params import SAFETY_MARGIN_M
from cosim.base.scenario import Scenario
from cosim.navigation.batch import CoSimulation, run_episode
from cosim.navigation.features import DIRECTIONS
from cosim.navigation.safety import WAIT, line_to_line, permitted
from cosim.physics.body import STATE_SIZE

E, N, W, S = 0, 2, 4, 6
FACING = Scenario(
    "facing", "swap places", ((12, 5), (3, 12)), (((3, 5),), ((12, 5),)), 16, 16, zone=(7, 7, 8, 8)
)

coordinate = st.floats(-1.0, 1.0)
lines = st.tuples(coordinate, coordinate, coordinate, coordinate).map(
    lambda v: np.array(v).reshape(2, 2)
)


@given(lines, lines)
def test_distance_of_plans_is_that_of_their_closest_points(a, b):
    shares = np.linspace(0.0, 1.0, 101)[:, None]
    on_a, on_b = a[0] + shares * (a[1] - a[0]), b[0] + shares * (b[1] - b[0])
    sampled = np.linalg.norm(on_a[:, None] - on_b[None], axis=2).min()
    spacing = (np.linalg.norm(a[1] - a[0]) + np.linalg.norm(b[1] - b[0])) / 100
    assert sampled - spacing <= line_to_line(a, b) <= sampled + 1e-12


def bodies_at(*cells):
    bodies = np.zeros((len(cells), STATE_SIZE))
    for body, cell in zip(bodies, cells, strict=True):
        body[:2] = FACING.centre_m(cell)
    return bodies


def goals_of(bodies, *directions):
    goals = np.full((len(bodies), 2), np.nan)
    for robot, direction in enumerate(directions):
        if direction is not None:
            goals[robot] = bodies[robot, :2] + DIRECTIONS[direction] * FACING.cell_m
    return goals


@pytest.mark.parametrize(
    ("other", "moving", "wanted", "expected"),
    [
        ((14, 5), None, E, E),  # far away
        ((10, 5), None, E, N),  # stands in the plan, and of the diagonals too
        ((10, 5), W, E, WAIT),  # comes closer
        ((9, 5), None, W, W),  # touches: moving away is free
    ],
)
def test_who_waits_and_who_yields(other, moving, wanted, expected):
    bodies = bodies_at((4, 5), other)
    goals = goals_of(bodies, None, moving)
    assert permitted(FACING, bodies, goals, 0, wanted, SAFETY_MARGIN_M) == expected


def test_yielding_never_leads_off_the_board():
    bodies = bodies_at((0, 5), (5, 5))
    for wanted in range(8):
        allowed = permitted(FACING, bodies, goals_of(bodies), 0, wanted, SAFETY_MARGIN_M)
        if allowed not in (wanted, WAIT):
            assert DIRECTIONS[allowed, 0] >= 0


class Straight:
    """Drives every robot straight at its target, whoever stands there."""

    def act(self, observation):
        offsets = np.array(FACING.targets) - observation.cells
        return np.round(np.arctan2(offsets[:, 1], offsets[:, 0]) / (math.pi / 4)).astype(int) % 8


@pytest.mark.parametrize("margin_m", [0.0, SAFETY_MARGIN_M])
def test_robots_that_would_collide_do_not_with_the_layer(motor_fmu, margin_m):
    system = CoSimulation(FACING, motor_fmu, CoSimConfig(safety_margin_m=margin_m))
    starts = tuple(cells[0] for cells in FACING.starts)
    outcome = run_episode(system, Straight(), starts, np.random.SeedSequence(0), lambda step: None)
    assert system.conflicts > 0
    if margin_m:
        assert outcome != "collision"
        assert system.measures.min_distance_m > FACING.robot_diameter_m
    else:
        assert outcome == "collision"

"""Geometry of plans, and who waits or yields."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cosim.base.arguments import ConfigError
from cosim.model.config import CoSimConfig
from cosim.model.params import SHIELD, TIMING
from cosim.model.scenario import Scenario
from cosim.onboard.features import DIRECTIONS
from cosim.onboard.observing import area_of
from cosim.onboard.yielding import (
    NEAREST_FIRST,
    WAIT,
    _from_edge,
    board_of,
    line_to_line,
    permitted,
)
from cosim.simulation import rules
from cosim.simulation.rules import adopt
from tests import alone

E, N, W, S = 0, 2, 4, 6
FACING = Scenario(
    "facing", "swap places", ((14, 5), (3, 12)), (((3, 5),), ((12, 5),)), 16, 16, zone=(7, 7, 8, 8)
)
BOARD = board_of(FACING)
USUAL = 0.006, NEAREST_FIRST

coordinate = st.floats(-1.0, 1.0)
points = st.tuples(coordinate, coordinate)
lines = st.tuples(points, points)


@given(lines, lines)
def test_distance_of_plans_is_that_of_their_closest_points(a, b):
    on_a, on_b = np.linspace(a[0], a[1], 101), np.linspace(b[0], b[1], 101)
    sampled = np.linalg.norm(on_a[:, None] - on_b[None], axis=2).min()
    spacing = (math.dist(*a) + math.dist(*b)) / 100
    assert sampled - spacing <= line_to_line(a, b) <= sampled + 1e-12


def positions_at(*cells):
    return np.array([FACING.centre_m(cell) for cell in cells])


def goals_of(positions, *directions):
    goals = np.full((len(positions), 2), np.nan)
    for robot, direction in enumerate(directions):
        if direction is not None:
            goals[robot] = positions[robot] + DIRECTIONS[direction] * FACING.cell_m
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
    positions = positions_at((4, 5), other)
    goals = goals_of(positions, None, moving)
    assert permitted(BOARD, positions, goals, 0, wanted, *USUAL) == expected


def test_yielding_never_leads_off_the_board():
    positions = positions_at((0, 5), (5, 5))
    for wanted in range(8):
        allowed = permitted(BOARD, positions, goals_of(positions), 0, wanted, *USUAL)
        if allowed != WAIT:
            assert DIRECTIONS[allowed, 0] >= 0


@pytest.mark.long
@pytest.mark.parametrize("shield", [False, True])
def test_robots_that_would_collide_do_not_with_the_shield(motor_fmu, straight_policy, shield):
    config = CoSimConfig(shield=SHIELD if shield else None)
    system, _ = alone.drive(FACING, motor_fmu, straight_policy(FACING.targets), config)
    assert (system.episode.conflicts > 0) == shield
    assert (system.episode.outcome == "collision") == (not shield)
    if shield:
        assert system.episode.measures.min_distance_m > FACING.diameter_m


@pytest.mark.long
def test_the_monitor_alone_keeps_robots_apart(motor_fmu, monkeypatch):
    """When nobody yields they meet, and are parted, again and again."""
    monkeypatch.setattr(rules, "adopt", lambda r, s, m, wanted, _: adopt(r, s, m, wanted, None))
    timing = TIMING._replace(episode_limit_s=30.0)
    config = CoSimConfig(shield=SHIELD, timing=timing)
    system, _ = alone.drive(FACING, motor_fmu, alone.Constant(E, W), config)
    assert system.episode.outcome == "timeout"
    assert system.episode.shield_stops >= 2
    assert system.episode.measures.min_distance_m > FACING.diameter_m


def test_what_the_shield_cannot_go_with_is_refused():
    with pytest.raises(ConfigError, match="keep their course"):
        CoSimConfig(shield=SHIELD, open_loop=("heading",))


def test_a_board_that_is_not_square_has_its_own_edges_and_columns():
    wide = Scenario("wide", "", ((35, 5),), (((3, 5),),), 40, 20, zone=(18, 8, 21, 11))
    board = board_of(wide)
    places = {(0.3, 0.1): 0.1, (0.38, 0.1): 0.02, (0.3, 0.17): 0.03, (0.01, 0.1): 0.01}
    for point, away_m in places.items():
        assert _from_edge(board, point) == pytest.approx(away_m)
    assert area_of(wide, camera=True).most_m == pytest.approx((0.4, 0.2))

"""Obstacles are solid: one definition, on the grid, in the dynamics and for who yields."""

import math
from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cosim.base.errors import UserError
from cosim.base.jit import kernel
from cosim.model.config import CoSimConfig
from cosim.model.outcome import COLLISION, RUNNING
from cosim.model.params import SHIELD, TABLE_I, TIMING
from cosim.model.scenario import Scenario, touches_obstacle
from cosim.model.scenario_file import find_scenario
from cosim.onboard.features import DIRECTIONS
from cosim.onboard.yielding import NEAREST_FIRST, WAIT, board_of, permitted
from cosim.physics import collision as solid
from cosim.recording.episode_log import EpisodeLog
from tests import alone

E, NE, N, W, S = 0, 1, 2, 4, 6
RADIUS_M = TABLE_I.diameter_m / 2.0
WALL = """
columns = 16
rows = 16
obstacles = [[4, 9, 11, 9]]

[[robots]]
target = [8, 14]
starts = [[8, 5]]
"""
cells = st.lists(st.tuples(st.integers(0, 7), st.integers(0, 7)), max_size=12)


@pytest.fixture
def wall(tmp_path):
    """A scenario file with a wall across the path to the target."""
    (tmp_path / "wall.toml").write_text(WALL)
    return find_scenario(tmp_path / "wall.toml")


@kernel
def compiled(x: float, y: float, squared_radius: float, obstacles: np.ndarray) -> bool:
    return solid.touches_obstacle(x, y, squared_radius, obstacles)


def distance(x, y, obstacle):
    """Of a point from a cell's square, in cells, by its closest point."""
    return math.dist((x, y), [min(max(v, o), o + 1) for v, o in zip((x, y), obstacle, strict=True)])


@given(cells, st.floats(-1.0, 9.0), st.floats(-1.0, 9.0), st.floats(0.1, 4.0))
def test_a_disc_touches_what_is_no_further_than_its_radius(obstacles, x, y, radius):
    scenario = Scenario("o", "", ((20, 20),), (((29, 29),),), obstacles=tuple(obstacles))
    walls = scenario.walls.astype(float)
    gaps = [distance(x, y, obstacle) - radius for obstacle in obstacles]
    found = compiled(x, y, radius**2, walls)
    assert found == touches_obstacle(x, y, radius**2, walls)
    if all(abs(gap) > 1e-12 for gap in gaps):
        assert found == any(gap < 0.0 for gap in gaps)


@given(cells)
def test_walls_are_the_obstacles(obstacles):
    walls = Scenario("o", "", ((20, 20),), (((29, 29),),), obstacles=tuple(obstacles)).walls
    covered = [
        cell
        for left, low, right, top in walls
        for cell in product(range(left, right), range(low, top))
    ]
    assert sorted(covered) == sorted(set(obstacles))


@pytest.mark.parametrize(("diameter_m", "cell_m"), [(0.05, 0.01), (0.07, 0.01), (0.03, 0.006)])
def test_no_rounding_decides_on_the_grid(diameter_m, cell_m):
    """A gap of exactly the radius is a contact, of robots (a diameter) and of obstacles."""
    sizes = {"cell_m": cell_m, "robot_diameter_m": diameter_m}
    diameter = round(diameter_m / cell_m)
    starts = (((0, 0),), ((29, 29),))
    with pytest.raises(UserError, match="do not both fit there"):
        Scenario("o", "", ((20, 20), (20 - diameter, 20)), starts, **sizes)
    reach = (diameter + 1) // 2  # cells from a cell's middle to an obstacle's, at contact
    with pytest.raises(UserError, match="touches an obstacle"):
        Scenario("o", "", ((20, 20),), starts[:1], obstacles=((20, 20 + reach),), **sizes)
    Scenario("o", "", ((20, 20),), starts[:1], obstacles=((20, 21 + reach),), **sizes)


@pytest.mark.parametrize(
    ("field", "text"),
    [
        ("targets", WALL.replace("14]", "12]")),
        ("starts[0]", WALL.replace("8, 5]", "8, 5], [8, 6]")),
    ],
)
def test_robots_cannot_start_or_park_touching_an_obstacle(tmp_path, field, text):
    (tmp_path / "tight.toml").write_text(text)
    with pytest.raises(UserError) as refusal:
        find_scenario(tmp_path / "tight.toml")
    assert f"{field} has cell (8, " in str(refusal.value)
    assert "robot of 5.0 cm touches an obstacle" in str(refusal.value)


def drive(scenario, motor_fmu, policy, **changes):
    timing = TIMING._replace(episode_limit_s=20.0)
    return alone.drive(scenario, motor_fmu, policy, CoSimConfig(timing=timing, **changes))


@pytest.mark.parametrize("on_collision", ["end", "continue"])
def test_no_robot_drives_through_a_wall(wall, motor_fmu, straight_policy, on_collision):
    policy = straight_policy(wall.targets)
    system, steps = drive(wall, motor_fmu, policy, on_collision=on_collision)
    highest = max(step.samples.position[:, 0, 1].max() for step in steps)
    assert 0.09 - RADIUS_M - 2e-5 < highest < 0.09 - RADIUS_M + 1e-7
    log = EpisodeLog(wall, system.config)
    lines = [line.text for step in steps for line in log.lines(step, np.array([-100.0]))]
    told = [line for line in lines if line.startswith("r1 touches an obstacle at ")]
    touched_s = system.episode.measures.contact_time_s
    if on_collision == "end":
        assert system.episode.outcome == "collision"
        assert steps[-1].events.tolist() == [COLLISION]
        assert all(step.events.tolist() == [RUNNING] for step in steps[:-1])
        assert 0.0 < touched_s <= TIMING.control_period_s
        assert len(told) == 2  # the contact, and why the episode ends
        assert lines[-2].startswith("r1 touches an obstacle at (8.")
    else:
        assert system.episode.outcome == "timeout"
        assert touched_s > 0.0
        assert 1 <= len(told) < len(steps) + 1


def test_the_shield_never_lets_a_robot_touch_a_wall(wall, motor_fmu, straight_policy):
    policy = straight_policy(wall.targets)
    system, steps = drive(wall, motor_fmu, policy, shield=SHIELD)
    assert system.episode.outcome == "timeout"
    assert system.episode.conflicts > 0
    highest = max(step.samples.position[:, 0, 1].max() for step in steps)
    assert highest < 0.09 - RADIUS_M


def allowed(obstacles, wanted):
    """What is left of a direction of a robot in cell (8, 5)."""
    scenario = Scenario("o", "", ((25, 25),), (((29, 29),),), obstacles=obstacles)
    here, stands = np.array([scenario.centre_m((8, 5))]), np.full((1, 2), np.nan)
    asked = here, stands, 0, wanted, MARGIN_M, NEAREST_FIRST
    return permitted(board_of(scenario), *asked)


MARGIN_M = 0.006
ABOVE, BELOW = (tuple((x, y) for x in range(17)) for y in (9, 1))
BESIDE = tuple((x, y) for y in range(1, 10) for x in (4, 12))


@pytest.mark.parametrize(
    ("obstacles", "wanted", "expected"),
    [
        (ABOVE, N, W),  # the wanted direction itself is refused, the diagonals too
        (ABOVE, E, E),
        (ABOVE + BELOW, NE, E),
        (ABOVE + BELOW + BESIDE, S, WAIT),
        (((10, 8),), E, 7),  # less than the margin away already: no closer
        (((10, 8),), W, W),
    ],
)
def test_moves_that_come_too_close_to_an_obstacle_yield(obstacles, wanted, expected):
    assert allowed(obstacles, wanted) == expected


@given(st.lists(st.tuples(st.integers(3, 13), st.integers(0, 10)), min_size=1, max_size=6))
def test_a_plan_is_free_if_every_point_of_it_is(obstacles):
    least = (RADIUS_M + MARGIN_M) / 0.01
    if min(distance(8.5, 5.5, obstacle) for obstacle in obstacles) < least:
        return
    for wanted, step in enumerate(DIRECTIONS):
        points = np.array([8.5, 5.5]) + np.linspace(0.0, 1.0, 201)[:, None] * step
        nearest = min(distance(x, y, obstacle) for x, y in points for obstacle in obstacles)
        if abs(nearest - least) > 1e-4:
            assert (allowed(tuple(obstacles), wanted) == wanted) == (nearest > least)

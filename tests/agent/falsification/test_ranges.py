"""What a search may choose: refused by name, and mapped exactly."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from agent.falsification.ranges import RangeError, Space, chained, folded, read_ranges
from cosim.base.errors import UserError
from cosim.model.built_in import sides
from cosim.model.config import CoSimConfig
from cosim.model.scenario import Scenario
from cosim.model.scenario_file import find_scenario
from cosim.model.world import IDEAL, Sensor, World

CONFIG = CoSimConfig()
QUIET = replace(CONFIG, noise=CONFIG.noise._replace(relative_amplitude=0.0))
ONE_START = Scenario("one", "", ((5, 5),), (((15, 15),),))


def test_neighbours_on_a_chain_are_neighbours_on_the_board():
    border = sides(7, 9)["border"]
    chain = chained(border[::-1])
    assert sorted(chain) == sorted(border)
    assert {abs(a - c) + abs(b - d) for (a, b), (c, d) in pairwise(chain)} == {1}


def test_coordinates_are_mirrored_at_their_ends():
    assert folded(np.array([0.0, 0.4, 1.0, 1.25, 2.0, -0.25, 3.5])).tolist() == [
        *(0.0, 0.4, 1.0, 0.75, 0.0, 0.25, 0.5)
    ]


def test_a_vector_stands_for_one_episode():
    ranges = {"mu": (0.1, 0.2), "seed": (5.0, 8.0), "motor_phase_deg": (0.0, 90.0)}
    space = Space(find_scenario("3"), CONFIG, ranges)
    assert space.coordinates == (
        *("start of r1", "start of r2"),
        *(f"motor_phase_deg of {motor}" for motor in ("r1.D", "r1.E", "r2.D", "r2.E")),
        *("seed", "mu"),
    )
    assert space.steps.tolist() == [0.08, 0.08, *[0.3] * 6]
    point = space.point(np.array([0.5, 1.0, 0.0, 0.5, 1.0, 1.5, 0.25, 0.75]))
    assert point.starts == ((15, 29), (29, 0))
    assert point.seed == 6
    assert point.world == World(
        mu=0.1 + (0.2 - 0.1) * 0.75, motor_phases_deg=(0.0, 45.0, 90.0, 45.0)
    )
    assert [space.point(np.full(8, share)).seed for share in (0.0, 0.999, 1.0)] == [5, 8, 8]


def test_what_a_world_declares_holds_where_nothing_is_searched():
    world = World(motor_spread=0.05, motor_phases_deg=(0.0, 90.0), sensor=Sensor(30.0, 50.0))
    config = CONFIG.in_world(world)
    scenario = find_scenario("1a")
    space = Space(scenario, config, {"sensor.delay_ms": (0.0, 80.0), "motor_spread": (0.02, 0.02)})
    assert space.coordinates == ("start of r1", "seed", "sensor.delay_ms")
    point = space.point(np.array([0.0, 0.0, 0.5]))
    assert point.world == World(
        motor_spread=0.02, motor_phases_deg=(0.0, 90.0), sensor=Sensor(30.0, 40.0)
    )
    assert Space(scenario, QUIET, {}).coordinates == (
        *("start of r1", "motor_phase_deg of r1.D", "motor_phase_deg of r1.E"),
    )


def test_motors_hang_down_where_phases_are_left_out():
    space = Space(find_scenario("1a"), CONFIG, {"motor_phase_deg": (0.0, 0.0)})
    assert space.coordinates == ("start of r1", "seed")
    assert space.point(np.array([0.5, 0.5])).world == IDEAL
    hanging = CONFIG.in_world(World(motor_phases_deg=(90.0, 90.0)))
    space = Space(find_scenario("1a"), hanging, {"motor_phase_deg": (0.0, 0.0)})
    assert space.point(np.array([0.5, 0.5])).world == IDEAL


def test_starts_in_contact_give_way_to_the_nearest_ones_without():
    line = tuple((x, 0) for x in range(12))
    space = Space(Scenario("line", "", ((3, 20), (20, 20)), (line, line)), CONFIG, {})
    for shares in ((0.5, 0.5), (0.0, 0.2), (0.99, 0.7)):
        (a, _), (b, _) = space.point(np.array([*shares, *[0.0] * 5])).starts
        assert a == min(int(12 * shares[0]), 11)
        wanted = min(int(12 * shares[1]), 11)
        free = [x for x in range(12) if abs(x - a) > 5]
        assert abs(b - wanted) == min(abs(x - wanted) for x in free)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[ranges]\nfriction = [0, 1]", "ranges.friction is unknown; choose from start, motor_ph"),
        ("[ranges.sensor]\nmu = [0, 1]", "ranges.sensor.mu is unknown"),
        ("[ranges]\nmu = 0.2", "ranges.mu is not a pair"),
        ("[ranges]\nmu = [0.2, 0.1]", "ranges.mu = .0.2, 0.1. has its ends swapped"),
        ("[ranges]\nstart = [0, 2]", "ranges.start = .0, 2. is outside 0 to 1"),
        ("[ranges]\nseed = [0, 0.5]", "ranges.seed = .0, 0.5. is not a range of seeds"),
        ("[ranges]\nsensor = 3", "ranges.sensor is not a table"),
        ("[world]\nmu = 0.2", "a table .ranges. and nothing else is expected"),
        ("[ranges", "not a TOML file"),
    ],
)
def test_files_that_declare_no_ranges_are_refused(text, said, tmp_path):
    path = tmp_path / "ranges.toml"
    path.write_text(text)
    with pytest.raises(RangeError, match=said):
        read_ranges(path)


def test_a_file_names_ranges_of_the_camera_apart(tmp_path):
    path = tmp_path / "ranges.toml"
    path.write_text("[ranges]\nmu = [0.1, 0.2]\n[ranges.sensor]\ndelay_ms = [0, 80]\n")
    assert read_ranges(path) == {"mu": (0.1, 0.2), "sensor.delay_ms": (0.0, 80.0)}


@pytest.mark.parametrize(
    ("config", "ranges", "said"),
    [
        (CONFIG, {"mu": (0.1, 20.0)}, "world.mu = 20 is not usable; give 0 to 10"),
        (CONFIG, {"motor_phase_deg": (-400.0, 0.0)}, "world.motor_phases_deg has -400"),
        (CONFIG, {"sensor.delay_ms": (0.0, 80.0)}, "delay_ms has no effect without a camera"),
        (QUIET, {"seed": (0.0, 9.0)}, "ranges.seed has no effect where nothing is drawn"),
        (CONFIG, {"start": (0.2, 0.4)}, "ranges.start has no effect where every robot has one"),
        (
            replace(CONFIG, open_loop=("motors",)),
            {"motor_speed_noise": (0.0, 0.1)},
            "ranges.motor_speed_noise has no effect with --open-loop motors",
        ),
        (QUIET, {"motor_phase_deg": (90.0, 90.0)}, "all ranges are fixed"),
    ],
)
def test_ranges_that_cannot_be_searched_are_refused(config, ranges, said):
    with pytest.raises(UserError, match=said):
        Space(ONE_START, config, ranges)

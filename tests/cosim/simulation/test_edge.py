"""A floor that ends where the board does: `edge` of a world."""

from dataclasses import replace

import numpy as np
import pytest

from cosim.model.config import CoSimConfig
from cosim.model.params import SHIELD, TABLE_I
from cosim.model.scenario import Scenario
from cosim.model.world import World
from cosim.physics.feet import foot_positions
from cosim.physics.rotation import headings
from tests.alone import CoSimulation, same

NORTH, SOUTH = 2, 6
FLOORS = {edge: CoSimConfig().in_world(World(edge=edge)) for edge in (False, True)}


def first_step(motor_fmu, start, edge, **machine):
    """The first RL step of a robot that drives to the middle of its board."""
    scenario = Scenario("rim", "", ((15, 15),), ((start,),))
    system = CoSimulation(scenario, motor_fmu, FLOORS[edge].having("test", **machine))
    system.reset()
    step = system.step(np.array([SOUTH if start[1] > 15 else NORTH]))
    system.close()
    return step


@pytest.mark.parametrize("row", [0, 29])
def test_a_robot_with_a_foot_beyond_the_edge_falls(motor_fmu, row):
    step = first_step(motor_fmu, (15, row), edge=True)
    assert step.outcome == "out_of_board"
    assert step.samples.position[-1, 0, 2] < 0.0
    assert len(step.samples.position) < 500  # at once: its centre of mass is not above two feet
    assert not first_step(motor_fmu, (15, row), edge=False).outcome


@pytest.mark.parametrize("own_mu", [None, 0.2])
def test_a_robot_with_all_feet_on_the_board_notices_no_edge(own_mu, motor_fmu):
    feet = tuple(foot._replace(mu=own_mu) for foot in TABLE_I.feet)
    machine = {"feet": feet} if own_mu else {}
    without, within = (first_step(motor_fmu, (15, 26), e, **machine) for e in (False, True))
    assert not within.outcome
    assert same(without.samples, within.samples)


@pytest.mark.parametrize(("row", "direction"), [(25, NORTH), (4, SOUTH)])
def test_a_shielded_robot_keeps_its_feet_on_the_board(motor_fmu, row, direction):
    """It would leave the board: it drives on beyond the end of its move for 4 s."""
    world = World(edge=True, payload_g=5.0, payload_offset_mm=(8.0, 0.0))
    timing = CoSimConfig().timing._replace(rl_step_s=6.0)
    config = replace(CoSimConfig().in_world(world), shield=SHIELD, through=True, timing=timing)
    start = (15, row)
    system = CoSimulation(Scenario("rim", "", ((15, 15),), ((start,),)), motor_fmu, config)
    system.reset()
    samples = system.step(np.array([direction])).samples
    assert not system.episode.outcome
    offsets = foot_positions(config.robot)
    angle = headings(samples.quaternion[:, 0])[:, None]
    feet_y = samples.position[:, :1, 1] + np.sin(angle) * offsets[:, 0]
    feet_y += np.cos(angle) * offsets[:, 1]
    assert 0.0 < min(feet_y.min(), 0.3 - feet_y.max()) < 5e-3
    system.close()

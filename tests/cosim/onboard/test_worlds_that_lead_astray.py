"""Shielded robots in slopes that lead estimates astray, with bouncing feet, or on a table."""

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from cosim.model.scenario import Scenario
from cosim.model.world import Sensor, World
from cosim.onboard.features import DIRECTION_COUNT
from cosim.physics.draws import draw_world
from cosim.simulation.options import SimulationOptions
from cosim.simulation.tasks import Task, simulate_tasks
from tests.alone import Constant

EPISODES = 200
STEEP = World(mu=0.15, floor_tilt_deg=4.0, sensor=Sensor(10.0, 200.0, 3.0, 4.0))
WORLDS = {
    "constant": STEEP,
    "downhill in a ring": STEEP,
    "corner": World(mu=0.03, floor_tilt_deg=1.0, motor_speed_noise=0.2),
    "bouncing": World(restitution=0.98, floor_tilt_deg=2.0),
    "bouncing downhill": World(restitution=0.7, floor_tilt_deg=4.0),
    "table": World(edge=True),
}
PAIR = Scenario(
    "pair",
    "",
    ((4, 11), (11, 4)),
    (((5, 5),), ((11, 11),)),
    zone=(5, 5, 10, 10),
    columns=16,
    rows=16,
)
RING = tuple((c, r) for c in range(16) for r in range(16) if {c, r} & {0, 15})
CORNER = Scenario(
    "corner", "", ((100, 100),), (((0, 0),),), zone=(90, 90, 110, 110), columns=200, rows=200,
    cell_m=0.002,
)  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("case", WORLDS)
def test_shielded_robots_neither_touch_nor_leave_the_board(case):
    world, scenario, limit_s = WORLDS[case], PAIR, 24.0
    if case == "downhill in a ring":
        scenario = replace(PAIR, obstacles=RING)
    if case == "corner":
        scenario, limit_s = CORNER, 150.0
    config, fmu = SimulationOptions(shield=True, through=True, time_limit=limit_s).prepare(
        scenario.diameter_m, world=world
    )
    starts = tuple(cells[0] for cells in scenario.starts)
    tasks = []
    for number in range(EPISODES):
        seed, rng = np.random.SeedSequence(number), np.random.default_rng(number)
        directions = rng.integers(DIRECTION_COUNT, size=scenario.robots)
        if "downhill" in case:
            slope_deg = draw_world(
                world, (config.motor,) * 2, scenario.robots, seed
            ).tilt_direction_deg
            directions[:] = round(slope_deg / 45.0) % DIRECTION_COUNT
        if case == "corner":
            directions[:] = 1
        policy = Constant(*directions)
        tasks.append(Task(scenario, fmu, config, policy, starts, seed))
    results = [result for _, result in simulate_tasks(tasks, 1)]
    outcomes = Counter(result.outcome.name for result in results)
    print(outcomes, sum(result.shield_stops or 0 for result in results))
    assert outcomes.keys() <= {"SUCCESS", "TIMEOUT"}

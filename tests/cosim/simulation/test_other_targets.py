"""The target of another robot is a static obstacle (Section III-A): nothing stands there."""

from dataclasses import replace

import numpy as np
import pytest

from cosim.model.config import CoSimConfig
from cosim.model.outcome import COLLISION, RUNNING
from cosim.model.params import SHIELD
from cosim.model.scenario import Scenario
from cosim.model.scenario_file import find_scenario
from cosim.onboard.state import STOPS
from cosim.onboard.yielding import NEAREST_FIRST, WAIT, board_of, permitted
from cosim.recording.episode_log import EpisodeLog
from cosim.simulation import rules
from cosim.simulation.rules import adopt
from tests.alone import drive

E, NE, N, NW, W, S = 0, 1, 2, 3, 4, 6
# the second robot's target is on the first one's way
BEYOND = Scenario(
    "beyond", "", ((4, 13), (4, 6)), (((4, 5),), ((12, 3),)), 16, 16, zone=(7, 7, 8, 8)
)


def test_a_robot_that_drives_over_anothers_target_collides(motor_fmu, straight_policy):
    system, steps = drive(BEYOND, motor_fmu, straight_policy(BEYOND.targets))
    assert system.episode.outcome == "collision"
    assert steps[-1].events.tolist() == [COLLISION, RUNNING]
    *_, before, after = steps[-1].samples.position[:, 0, 1]
    assert before < 0.06 <= after  # its centre enters the cell, not its rim
    assert system.episode.measures.contact_time_s == 0.0
    log = EpisodeLog(BEYOND, system.config)
    lines = [line for step in steps for line in log.lines(step, np.zeros(2))]
    assert lines[-2].text.startswith("r1 enters another robot's target at (4.")
    assert (lines[-2].entity, lines[-2].state) == (
        "/rl/r1/failure",
        "enters another robot's target",
    )


def test_robots_that_push_on_after_collisions_drive_over_targets(motor_fmu, straight_policy):
    timing = CoSimConfig().timing._replace(episode_limit_s=10.0)
    config = CoSimConfig(on_collision="continue", timing=timing)
    system, steps = drive(BEYOND, motor_fmu, straight_policy(BEYOND.targets), config)
    assert system.episode.outcome == "timeout"
    assert steps[-1].samples.position[-1, 0, 1] > 0.061


@pytest.mark.long
def test_the_shield_keeps_out_of_anothers_target(motor_fmu, straight_policy):
    timing = CoSimConfig().timing._replace(episode_limit_s=60.0)
    config = CoSimConfig(shield=SHIELD, timing=timing)
    system, steps = drive(BEYOND, motor_fmu, straight_policy(BEYOND.targets), config)
    assert system.episode.outcome != "collision"
    assert system.episode.conflicts > 0  # yielding: no move begins that leads there
    path = np.concatenate([step.samples.position[:, 0, :2] for step in steps])
    inside = ((path >= (0.04, 0.06)) & (path < (0.05, 0.07))).all(axis=1)
    assert not inside.any()


@pytest.mark.long
def test_the_monitor_alone_keeps_out_of_anothers_target(motor_fmu, straight_policy, monkeypatch):
    monkeypatch.setattr(rules, "adopt", lambda r, s, m, wanted, _: adopt(r, s, m, wanted, None))
    timing = CoSimConfig().timing._replace(episode_limit_s=30.0)
    config = CoSimConfig(shield=SHIELD, timing=timing)
    system, _ = drive(BEYOND, motor_fmu, straight_policy(BEYOND.targets), config)
    assert system.episode.outcome == "timeout"
    assert system.state.onboard.shields[0, STOPS] >= 1


@pytest.mark.parametrize(
    ("cell", "wanted", "allowed"),
    [
        ((4, 5), N, {E, W}),  # into it, and next to it over its corners
        ((3, 5), N, {N}),  # past it, half a cell away
        ((3, 5), NE, {N, E}),  # into it, askew
        ((3, 6), NE, {N}),  # over its corner
    ],
)
def test_moves_into_anothers_target_or_over_its_corner_yield(cell, wanted, allowed):
    positions = np.array([BEYOND.centre_m(cell), BEYOND.centre_m((12, 3))])
    goals = np.full((2, 2), np.nan)
    found = permitted(board_of(BEYOND), positions, goals, 0, wanted, 2e-3, NEAREST_FIRST)
    assert found != WAIT
    assert found in allowed
    # to the second robot it is its own
    assert (
        permitted(board_of(BEYOND), positions[::-1].copy(), goals, 1, N, 2e-3, NEAREST_FIRST) == N
    )


def test_a_zone_that_is_an_obstacle_ends_the_episode_in_the_dynamics(motor_fmu, straight_policy):
    zoned = replace(BEYOND, targets=((4, 13), (12, 6)), zone=(3, 6, 5, 13), zone_is_obstacle=True)
    system, steps = drive(zoned, motor_fmu, straight_policy(zoned.targets))
    assert system.episode.outcome == "collision"
    log = EpisodeLog(zoned, system.config)
    lines = [line.text for step in steps for line in log.lines(step, np.zeros(2))]
    assert lines[-2].startswith("r1 enters the restricted zone at (4.")


@pytest.mark.parametrize("name", ["1a", "1b", "2", "3", "4"])
def test_the_restricted_zone_is_a_named_option_of_the_papers_scenarios(name):
    usual, zoned = find_scenario(name), find_scenario(f"{name}-zone")
    assert usual.digest() != zoned.digest()
    for robot, target in enumerate(usual.targets):
        others = [cell for cell in usual.targets if cell != target]
        for scenario in (usual, zoned):
            free = np.ones((30, 30), dtype=bool)
            for left, bottom, right, top in scenario.forbidden[robot]:
                if left < np.inf:
                    free[int(left) : int(right), int(bottom) : int(top)] = False
            expected = np.ones((30, 30), dtype=bool)
            if scenario is zoned:
                expected[12:19, 12:19] = False  # where all targets are
                expected[target] = True
            else:
                expected[tuple(np.array(others, dtype=int).reshape(-1, 2).T)] = False
            assert (free == expected).all()

"""Where evaluations begin: all combinations of start cells, or draws where there are too many."""

import itertools
import math

import numpy as np

from agent.mdp.config import ProcessConfig
from agent.mdp.exact import MAX_STARTS, joint_starts
from agent.mdp.interpretations import build_process
from agent.study.grid import grid_row
from agent.training.learning import initial_state
from agent.training.policy import Policy, PolicyConfig, Seed
from agent.training.settings import LearningConfig
from cosim.model.scenario import Scenario
from cosim.model.scenario_file import find_scenario


def test_few_starts_are_all_there_but_those_in_contact():
    rows = (tuple((x, 0) for x in range(0, 10, 2)), ((0, 3), (8, 3)), ((4, 12),))
    scenario = Scenario("few", "", ((2, 20), (12, 20), (22, 20)), rows)
    expected = [
        starts
        for starts in itertools.product(*rows)
        if all(math.dist(a, b) > 5 for a, b in itertools.combinations(starts, 2))
    ]
    found = joint_starts(build_process(scenario, ProcessConfig()))
    assert [tuple(map(tuple, starts)) for starts in found.tolist()] == expected


def test_many_starts_are_drawn_always_the_same():
    scenario = find_scenario("6-swap")
    process = build_process(scenario, ProcessConfig())
    starts = joint_starts(process)
    assert starts.shape == (MAX_STARTS, 6, 2)
    assert np.array_equal(starts, joint_starts(process))
    for robot, cells in enumerate(scenario.starts):
        assert set(map(tuple, starts[:, robot].tolist())) == set(cells)
    for i, j in itertools.combinations(range(6), 2):
        assert ((starts[:, i] - starts[:, j]) ** 2).sum(axis=1).min() > 25


def test_drawn_starts_have_an_interval_and_all_starts_have_none():
    def untrained(name):
        config = PolicyConfig(find_scenario(name), ProcessConfig(), LearningConfig(), Seed(0))
        state = initial_state(build_process(config.scenario, config.process), config.learning, 0)
        return Policy(config, state.q, state.visits, state.random)

    drawn, exact = grid_row("drawn", untrained("4-cross")), grid_row("all", untrained("1b"))
    assert (drawn.starts, drawn.success, drawn.success_low) == (10_000, 0.0, 0.0)
    # Wilson: z²/(n + z²)
    assert drawn.success_high is not None
    assert math.isclose(drawn.success_high, 1.96**2 / (10_000 + 1.96**2), rel_tol=1e-3)
    assert (exact.starts, exact.success_low, exact.success_high) == (116, None, None)

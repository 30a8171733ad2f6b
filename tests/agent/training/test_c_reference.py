"""The numba kernels against a C program written from the paper: the same bits in every table."""

import numpy as np
import pytest

from agent.mdp.config import ProcessConfig
from agent.mdp.interpretations import build_process
from agent.training.learning import build_learning, initial_state
from agent.training.qlearning import advance
from agent.training.settings import LearningConfig
from cosim.model.scenario_file import find_scenario
from tests.references.qlearning_c import build_reference, reference_state, train_reference

EPISODES = 100_000


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    return build_reference(tmp_path_factory.mktemp("reference"))


@pytest.mark.parametrize("name", ["1a", "2", "4"])
@pytest.mark.parametrize("budget", [EPISODES, 5_000_000])
def test_tables_agree_bit_for_bit_after_100_000_episodes(library, name, budget):
    # the budget sets the schedule: all of it, and the first fiftieth of Section V's
    config = LearningConfig(episodes=budget)
    scenario, learning = find_scenario(name), build_learning(config)
    process = build_process(scenario, ProcessConfig())
    ours = initial_state(process, config, seed=7)
    reference = reference_state(scenario, ours.random)
    advance(process, learning, ours, EPISODES)
    train_reference(library, scenario, learning, reference, EPISODES)
    q, visits = reference.q, reference.visits
    if scenario.robots == 1:  # we leave out what a lone robot cannot see: large, same
        seen = np.arange(process.state_count) * 9 + 2 * 3 + 1
        assert np.count_nonzero(np.delete(visits, seen, axis=1)) == 0
        q, visits = q[:, :, seen], visits[:, seen]
    assert np.array_equal(ours.q, q)
    assert np.array_equal(ours.visits, visits)
    assert np.array_equal(ours.random, reference.random)
    assert ours.agent_steps == reference.agent_steps
    assert np.count_nonzero(q) > 1000

"""Rewards of co-simulated steps: for every step, for the time, or for the path."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from agent.mdp.config import ProcessConfig
from agent.mdp.interpretations import build_process
from agent.mdp.rewards import step_reward
from cosim.model.outcome import RUNNING
from cosim.model.scenario_file import find_scenario
from cosim.onboard.features import Observation


@pytest.mark.parametrize(
    ("per", "expected"), [("step", [-1.0, -1.0]), ("time", [-0.05] * 2), ("distance", [-0.3, 0.0])]
)
def test_what_a_step_costs(per, expected):
    """Far from each other robots pay the cost of a step only."""
    process = build_process(find_scenario("2"), ProcessConfig(reward_per=per))
    cells = np.array([(2, 25), (25, 2)])
    step: Any = SimpleNamespace(
        action=np.array([0, 4]),
        events=np.full(2, RUNNING),
        after=Observation(cells, *np.zeros((3, 2), dtype=int)),
        duration_s=0.1,
        moved_m=np.array([0.003, 0.0]),
    )
    assert step_reward(process, step, np.zeros(2, dtype=bool)) == pytest.approx(expected)

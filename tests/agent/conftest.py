from pathlib import Path

import pytest

from agent.mdp.config import ProcessConfig
from agent.training.loop import learn
from agent.training.policy import Policy, PolicyConfig, Seed
from agent.training.settings import LearningConfig
from cosim.model.scenario import Scenario

# Targets one cell away, straight ahead: an episode takes some simulated seconds.
NEAR = Scenario(
    "near", "", ((3, 6), (10, 6)), (((3, 7), (3, 8)), ((10, 5), (10, 4))), 14, 14, zone=(0, 0, 0, 0)
)

# The same as a file, but for its zone.
BOARD = """
columns = 14
rows = 14
robots = [
    { target = [3, 6], starts = [[3, 7], [3, 8]] },
    { target = [10, 6], starts = [[10, 5], [10, 4]] },
]
"""


@pytest.fixture
def fresh_cache(tmp_path, monkeypatch):
    """A cache of policies and bounds of this test's own."""
    monkeypatch.setenv("MINIROBOTS_CACHE", str(tmp_path / "cache"))


@pytest.fixture(scope="module")
def near_policy() -> Policy:
    """A policy of two robots with four starts, none of which fails."""
    config = PolicyConfig(NEAR, ProcessConfig(), LearningConfig(episodes=5000), Seed(0))
    return learn(config)[0]


@pytest.fixture(scope="module")
def near_file(near_policy, tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("policy") / "policy.npz"
    near_policy.save(path)
    return path

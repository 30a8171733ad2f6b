import pytest

from agent.process import ProcessConfig, build_process
from agent.qlearning import LearningConfig
from cosim.scenario import find_scenario


@pytest.fixture(scope="session")
def pair_process():
    """The decision process of scenario 2 as the paper reads here."""
    return build_process(find_scenario("2"), ProcessConfig())


@pytest.fixture(scope="session")
def short_learning():
    """Section V on a small budget: the same schedule, 20 000 episodes."""
    return LearningConfig(episodes=20_000, epsilon_episodes=20, greedy_points=4)


@pytest.fixture(autouse=True)
def own_cache(tmp_path, monkeypatch):
    monkeypatch.setenv("MINIROBOTS_CACHE", str(tmp_path / "cache"))

"""The training benchmark on a small scale: its figures, and that training is as fast as said."""

import json

import pytest

from agent.training.settings import LearningConfig
from benchmarks import __main__ as benchmarks
from benchmarks import training


@pytest.fixture
def measured(monkeypatch, command):
    """Figures of small trainings."""

    def run(episodes: int, repeats: int) -> dict[str, float]:
        monkeypatch.setattr(training, "SECTION_V", LearningConfig(episodes=episodes))
        monkeypatch.setattr(training, "GYMNASIUM_STEPS", episodes // 20)
        done = command(benchmarks, "training", "--json", "--repeats", repeats)
        return json.loads(done.stdout.splitlines()[-1])

    return run


@pytest.mark.long
def test_figures_are_printed_as_json(measured):
    figures = measured(episodes=10_000, repeats=1)
    assert min(figures.values()) > 0.0
    assert figures["ratio_to_paper"] == pytest.approx(600.0 / figures["seconds_5e6"])
    assert figures["ratio_numba_to_c"] == pytest.approx(
        figures["seconds_5e6"] / figures["seconds_5e6_c"]
    )


@pytest.mark.slow
def test_training_is_as_fast_as_c_and_far_faster_than_a_loop_in_python(measured):
    figures = measured(episodes=100_000, repeats=5)
    # on a quiet machine about 1 and more than 500
    assert figures["ratio_numba_to_c"] < 2.5
    assert figures["ratio_to_gymnasium"] > 100.0
    assert figures["agent_steps_per_s"] > 3e6

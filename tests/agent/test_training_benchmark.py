"""The training benchmark in the small: its figures, and ratios that hold on a busy machine too."""

import json
import sys

import pytest

from agent.learning import LearningConfig
from benchmarks import training


def test_figures_are_printed_as_json(monkeypatch, capsys):
    monkeypatch.setattr(training, "SECTION_V", LearningConfig(episodes=100_000))
    monkeypatch.setattr(training, "GYMNASIUM_STEPS", 5000)
    monkeypatch.setattr(sys, "argv", ["training", "--json", "--repeats", "5"])
    training.main()
    figures = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert figures["ratio_to_paper"] == pytest.approx(600.0 / figures["seconds_5e6"])
    assert figures["ratio_numba_to_c"] == pytest.approx(
        figures["seconds_5e6"] / figures["seconds_5e6_c"]
    )
    # on a quiet machine about 1 and more than 500
    assert figures["ratio_numba_to_c"] < 2.5
    assert figures["ratio_to_gymnasium"] > 100.0
    assert figures["agent_steps_per_s"] > 3e6

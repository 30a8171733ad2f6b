"""The example that trains Stable-Baselines3's PPO to drive; `test_clients` has that of one file."""

from importlib import import_module
from pathlib import Path
from typing import Any

import pytest

import minirobots as mr

EXAMPLES = Path(__file__).parents[3] / "docs" / "examples"


@pytest.mark.learners
def test_the_example_of_stable_baselines_trains_continues_and_drives(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(EXAMPLES)
    sb3: Any = import_module("sb3_drive")
    file, options = tmp_path / "drive.zip", {"time_limit": 2.0}
    for _ in range(2):
        sb3.train(file, 1e-9, options)
    assert sum(sb3.evaluate(file, 2, options).values()) == 2
    assert mr.simulate("1a", sb3.driver(file), time_limit=2, progress=None).outcome == "timeout"

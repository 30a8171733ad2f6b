"""Shared by the tests of analysis: short real runs of the main command."""

import json
import signal
import subprocess
import sys
import time

import pytest
from rich.console import Console

from agent.experiments import Experiments, run_experiment
from analysis import motor_test
from analysis.results import RESULTS
from cosim import platform
from cosim.run import Run, run
from cosim.scenario import BUILT_IN

CONSOLE = Console(stderr=True)
NAMES = {platform: "platform", motor_test: "motor_test"}
BRIEF = ("--train-episodes", "20000")
KILL_TIMEOUT_S = 120.0
TRANSFER_ROWS = [
    {
        "scenario": scenario,
        "method": "paper",
        "mu": 0.15,
        "episodes": 10,
        "success": 0.9,
        "success_low": 0.6,
        "success_high": 0.98,
    }
    for scenario in BUILT_IN
]


@pytest.fixture(scope="session")
def results(tmp_path_factory):
    """A results folder with everything small: few, short, but real runs."""
    out = tmp_path_factory.mktemp("results")
    for name in ("fig08", "fig10", "fig11"):
        place = RESULTS[name].location(out)
        run_experiment(Experiments(name, runs=2, episodes=3000, out=place, jobs=1), CONSOLE)
    for scenario in BUILT_IN:
        place = RESULTS[f"episodes_{scenario}"].location(out)
        run(Run(scenario, train_episodes=20_000, time_limit=8.0, out=place), CONSOLE)
    with pytest.MonkeyPatch.context() as patch:
        for module in (platform, motor_test):
            patch.setattr("sys.argv", ["x", "--out", str(RESULTS[NAMES[module]].location(out))])
            module.main()
    table = RESULTS["transfer"].proof_in(out)
    table.parent.mkdir()
    table.write_text(json.dumps({"rows": TRANSFER_ROWS}), encoding="utf-8")
    return out


@pytest.fixture(scope="session")
def run_folder(results):
    """A run of two robots, one episode of 8 s."""
    return RESULTS["episodes_2"].location(results)


@pytest.fixture(scope="session")
def recording(run_folder):
    """Recording of that episode."""
    return run_folder / "episodes" / "ep_000.rrd"


@pytest.fixture(scope="session")
def killed_recording(tmp_path_factory, run_folder):
    """What a run leaves that was killed while it wrote: kill -9, some RL steps written."""
    out = tmp_path_factory.mktemp("killed")
    part = out / "episodes" / "ep_000.rrd.part"
    command = [sys.executable, "-m", "cosim.run", *BRIEF, "--scenario", "2", "--out", str(out)]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as run:
        began = time.monotonic()
        while not (part.is_file() and part.stat().st_size > 1_000_000):
            assert run.poll() is None
            assert time.monotonic() - began < KILL_TIMEOUT_S
            time.sleep(0.05)
        run.send_signal(signal.SIGKILL)
    assert part.is_file()
    return part

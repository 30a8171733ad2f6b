"""Shared by the tests of analysis: short real runs of the main command."""

import signal
import subprocess
import sys
import time
from dataclasses import replace
from functools import partial

import pytest
from rich.console import Console

from agent import experiments, methods
from analysis.profiles import Profile
from analysis.reading.results import RESULTS
from analysis.reproduce import Reproduce, reproduce

# Everything in the small: few, short, but real runs.
TINY = Profile(
    name="tiny",
    runs=2,
    train_episodes=3000,
    drive_method="paper",  # needs no observed moves
    drive_episodes=20_000,
    single_episodes=1,
    pair_episodes=1,
    episode_limit_s=8.0,
    transfer_scenarios=("1a",),
    transfer_methods=("paper",),
    transfer_quick=True,
)
BRIEF = ("--method", "paper", "--train-episodes", "20000")


def evaluate_seldom(patch):
    """Few exact evaluations on the way: policies trained so briefly circle to the step limit."""
    for module in (methods, experiments):
        patch.setattr(module, "replace", partial(replace, greedy_points=6))


@pytest.fixture(autouse=True)
def few_evaluations(monkeypatch):
    """The same while a test goes on with a reproduction."""
    evaluate_seldom(monkeypatch)


@pytest.fixture(scope="session")
def tiny():
    """Profile of the session's reproduction."""
    return TINY


@pytest.fixture(scope="session")
def reproduction(tmp_path_factory):
    """A reproduction with everything small: results, figures and report."""
    out = tmp_path_factory.mktemp("reproduction")
    with pytest.MonkeyPatch.context() as patch:
        evaluate_seldom(patch)
        reproduce(Reproduce(out, jobs=1), TINY, Console(stderr=True))
    return out


@pytest.fixture(scope="session")
def results(reproduction):
    """Its results folder."""
    return reproduction / "results"


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
        while not (part.is_file() and part.stat().st_size > 1_000_000):
            assert run.poll() is None
            time.sleep(0.05)
        run.send_signal(signal.SIGKILL)
    assert part.is_file()
    return part

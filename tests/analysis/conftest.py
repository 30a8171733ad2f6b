"""Shared by the tests of analysis: short real runs of the main command."""

import signal
import subprocess
import sys
import time

import pytest

BRIEF = ("--train-episodes", "20000")
KILL_TIMEOUT_S = 120.0


@pytest.fixture(scope="session")
def run_folder(tmp_path_factory):
    """A run of two robots, one episode of 8 s."""
    out = tmp_path_factory.mktemp("run") / "run"
    arguments = (*BRIEF, "--scenario", "2", "--time-limit", "8", "--out", str(out))
    subprocess.run([sys.executable, "-m", "cosim.run", *arguments], check=True, capture_output=True)
    return out


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

"""What the cache keeps is made once, also when two processes want it at the same moment."""

import subprocess
import sys
import time

import pytest

# Each makes one thing when it is told to, and says whether it was the one that made it.
SCRIPT = """
import os
import sys

from agent.mdp.config import ProcessConfig
from agent.training.policy import PolicyConfig, Seed
from agent.training.settings import LearningConfig
from agent.training.store import find_or_train
from cosim.base.jit import kernel
from cosim.model.scenario_file import find_scenario
from fmus import build

os.environ["MINIROBOTS_CACHE"] = sys.argv[1]

@kernel
def squares(count):
    total = NUMBER  # another kernel each time
    for k in range(count):
        total += k * k
    return total

def compiled():
    squares(3)
    return sum(squares.stats.cache_misses.values())

def built():
    builds, build_fmu = [], build.build_fmu
    build.build_fmu = lambda *what: builds.append(what) or build_fmu(*what)
    build.cached_fmu()
    return len(builds)

def trained():
    seen, learning = [], LearningConfig(episodes=100_000)
    config = PolicyConfig(find_scenario("1a"), ProcessConfig(), learning, Seed(0))
    find_or_train(config, progress=seen.append)
    return int(bool(seen))

for make in (compiled, built, trained):
    print("ready", flush=True)
    input()
    print(make(), flush=True)
"""


@pytest.mark.long
def test_two_processes_make_everything_once(tmp_path):
    script = tmp_path / "make.py"
    script.write_text(SCRIPT.replace("NUMBER", str(time.time_ns())))
    pair = [
        subprocess.Popen(
            [sys.executable, script, tmp_path / "cache"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        for _ in range(2)
    ]
    made = []
    for _ in ("kernel", "FMU", "policy"):
        assert [said(process) for process in pair] == ["ready", "ready"]
        for process in pair:
            print(file=process.stdin, flush=True)
        made.append(sorted(said(process) for process in pair))
    assert made == [["0", "1"]] * 3
    assert [process.wait() for process in pair] == [0, 0]


def said(process: subprocess.Popen[str]) -> str:
    assert process.stdout is not None
    return process.stdout.readline().strip()

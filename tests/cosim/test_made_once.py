"""What the cache keeps is made once, also when two processes want it at the same moment."""

import os
import subprocess
import sys

# Each makes one thing when it is told to, and says whether it was the one that made it.
SCRIPT = """
import numpy as np
from agent.learning import LearningConfig
from agent.rng import next_word
from agent.store import trained_policy
from cosim.scenario import find_scenario
from fmus import build

def kernel():
    next_word(np.zeros(1, dtype=np.uint64))
    return sum(next_word.stats.cache_misses.values())

def fmu():
    builds, build_fmu = [], build.build_fmu
    build.build_fmu = lambda folder: builds.append(folder) or build_fmu(folder)
    build.cached_fmu()
    return len(builds)

def policy():
    seen, learning = [], LearningConfig(episodes=300_000)
    trained_policy(find_scenario("1a"), None, learning, progress=seen.append)
    return int(bool(seen))

for make in (kernel, fmu, policy):
    print("ready", flush=True)
    input()
    print(make(), flush=True)
"""


def test_two_processes_make_everything_once(tmp_path):
    pair = [
        subprocess.Popen(
            [sys.executable, "-c", SCRIPT],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env=os.environ | {"MINIROBOTS_CACHE": str(tmp_path)},
        )
        for _ in range(2)
    ]
    made = {}
    for kind in ("kernel", "fmu", "policy"):
        assert [said(process) for process in pair] == ["ready", "ready"]
        for process in pair:
            print(file=process.stdin, flush=True)
        made[kind] = sorted(int(said(process)) for process in pair)
    assert made == {"kernel": [0, 1], "fmu": [0, 1], "policy": [0, 1]}
    assert [process.wait() for process in pair] == [0, 0]


def said(process: subprocess.Popen[str]) -> str:
    assert process.stdout is not None
    return process.stdout.readline().strip()

"""Sweeps on every backend give the same bits, also when a worker is killed in the middle."""

import os
import signal
import subprocess
import sys
import time
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from agent.mdp.config import ProcessConfig
from agent.training.loop import learn
from agent.training.policy import PolicyConfig
from agent.training.runs import RunsConfig
from agent.training.settings import LearningConfig
from cosim.base import backends
from cosim.base.backends import sweep
from cosim.base.errors import UserError
from cosim.base.jobs import Workers
from cosim.model.scenario_file import find_scenario
from tests.alone import lives, python

ROOT = Path(__file__).parents[3]

EXPERIMENT = RunsConfig(
    find_scenario("2"), ProcessConfig(), LearningConfig(episodes=2000, greedy_points=1), 3, 4
)


class Fragile(NamedTuple):
    """A run whose worker is killed the first time it gets there."""

    run: int
    config: PolicyConfig
    marker: Path


def die_once_and_train(fragile):
    if fragile.run == 1 and not fragile.marker.exists():
        fragile.marker.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return learn(fragile.config)


@pytest.fixture(scope="module")
def expected():
    return [learn(config)[0].q for config in EXPERIMENT.configs()]


@pytest.mark.long
@pytest.mark.parametrize("backend", ["loky", pytest.param("dask", marks=pytest.mark.cluster)])
def test_killed_worker_is_replaced_and_no_bit_changes(backend, expected, tmp_path):
    marker = tmp_path / "marker"
    tasks = [Fragile(k, config, marker) for k, config in enumerate(EXPERIMENT.configs())]
    results = dict(sweep(die_once_and_train, tasks, Workers(jobs=2, backend=backend)))
    assert marker.exists()
    assert sorted(results) == [0, 1, 2, 3]
    for k, q in enumerate(expected):
        assert np.array_equal(results[k][0].q, q)


@pytest.mark.long
def test_threads_and_one_job_give_the_same_bits(expected):
    for jobs in (1, 2):
        results = dict(sweep(learn, EXPERIMENT.configs(), Workers(jobs=jobs)))
        assert all(np.array_equal(results[k][0].q, q) for k, q in enumerate(expected))


def test_a_task_that_always_kills_its_worker_ends_the_sweep(monkeypatch):
    monkeypatch.setattr(backends, "ATTEMPTS", 2)
    with pytest.raises(UserError, match="workers died 2 times"):
        list(sweep(signal.raise_signal, [0, signal.SIGKILL], Workers(jobs=2, backend="loky")))


def test_errors_of_a_task_are_not_retried():
    with pytest.raises(ZeroDivisionError):
        list(sweep(lambda k: 1 // k, [0, 1], Workers(jobs=2, backend="loky")))


def test_an_address_without_a_cluster_is_refused():
    with pytest.raises(UserError, match=r"--address .* --backend loky"):
        Workers(backend="loky", address="tcp://127.0.0.1:9")
    with pytest.raises(UserError, match="--jobs has no effect"):
        Workers(jobs=2, backend="dask", address="tcp://127.0.0.1:9")


WRONG = "head", "tcp://head", "http://head:1", "tcp:1:2", "a:b"
NOT_THERE = "127.0.0.1:9", "[::1]:9", "127.0.0.1:99999", f"{'a' * 99}:9"


@pytest.mark.parametrize("address", [*WRONG, *NOT_THERE])
def test_an_address_that_is_none_and_a_cluster_that_is_not_there_are_refused(address):
    invalid, absent = "--address .* is invalid; give HOST:PORT", "no Dask cluster answers"
    with pytest.raises(UserError, match=invalid if address in WRONG else absent):
        list(sweep(abs, [1, 2], Workers(backend="dask", address=address)))


SCRIPT = """
import sys
from cosim.base.backends import sweep
from cosim.base.errors import run_command
from cosim.base.jobs import Workers
run_command(lambda: print(dict(sweep(abs, [1, 2], Workers(jobs=2, backend="dask")))))
"""


@pytest.mark.cluster
def test_a_script_without_a_guard_is_told_of_it(tmp_path):
    path = tmp_path / "script.py"
    path.write_text(SCRIPT)
    done = python(path)
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1), done.stderr
    assert 'if __name__ == "__main__":' in done.stderr


@pytest.mark.cluster
@pytest.mark.parametrize("workers", [0, 2])
def test_a_cluster_that_cannot_do_the_work_is_refused(workers, tmp_path, monkeypatch):
    from distributed import LocalCluster

    monkeypatch.setattr(backends, "CONNECT_TIMEOUT_S", 0.5)
    (tmp_path / "own_policy.py").write_text("def act(seen):\n    return seen\n")
    options: Any = {"n_workers": workers, "threads_per_worker": 1, "dashboard_address": None}
    local: Any = LocalCluster(**options)
    with local:
        monkeypatch.syspath_prepend(tmp_path)
        act = import_module("own_policy").act
        said = "cannot import own_policy; install it" if workers else "has no workers"
        with pytest.raises(UserError, match=said):
            list(sweep(act, [1, 2], Workers(backend="dask", address=local.scheduler_address)))


# A task that ends at once and leaves its worker idle, and one that does not end.
WAITING = """
import os, sys, time
from pathlib import Path
from cosim.base.backends import sweep
from cosim.base.jobs import Workers

def work(task):
    Path(sys.argv[1], str(os.getpid())).touch()
    time.sleep(600 * task)

if __name__ == "__main__":
    list(sweep(work, [0, 1, 1], Workers(jobs=3, backend="loky")))
"""


@pytest.mark.ci
@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="looks at processes in /proc")
def test_workers_end_with_the_process_that_is_killed(tmp_path):
    script, pids = tmp_path / "waiting.py", tmp_path / "pids"
    script.write_text(WAITING)
    pids.mkdir()
    process = subprocess.Popen(
        [sys.executable, script, pids], env=os.environ | {"PYTHONPATH": str(ROOT)}
    )
    while len(list(pids.iterdir())) < 2:
        assert process.poll() is None
        time.sleep(0.05)
    process.kill()  # it alone, as the out-of-memory killer does
    process.wait()
    end_s = time.monotonic() + 60.0
    while living := [path.name for path in pids.iterdir() if lives(int(path.name))]:
        assert time.monotonic() < end_s, living
        time.sleep(0.1)

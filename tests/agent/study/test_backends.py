"""Commands on a Dask cluster of two workers give the rows that they give in threads."""

from pathlib import Path
from typing import Any

import msgspec
import pytest

from agent.mdp.config import ProcessConfig
from agent.study.user import study
from agent.training.runs import RunsConfig, make_runs
from agent.training.settings import LearningConfig
from cosim.base.jobs import Workers
from cosim.model.scenario_file import find_scenario
from tests.faults.killing import timeless


def training(out: Path, where: Workers) -> Any:
    few = LearningConfig(episodes=2000, greedy_points=1)
    runs = make_runs(RunsConfig(find_scenario("2"), ProcessConfig(), few, 3, 2), out, where=where)
    return [policy.digest() for policy, _ in runs]


NAMES = ("claim", "study", "training")


def rows(name: str, out: Path, where: Workers, policy: Path) -> Any:
    """What a command gives, but for the time that it takes."""
    out.parent.mkdir()
    work: Any = {"out": out, "backend": where.backend, "address": where.address}
    work |= {"jobs": where.jobs, "progress": None}
    claimed: Any = {"claim": "success > 0.5", "confidence": 0.9, "episodes": 9}
    found = {
        "claim": lambda: study(policy, **claimed, **work).rows,
        "study": lambda: study(policy, noise=[0.0, 0.05], episodes=2, **work).rows,
        "training": lambda: training(out, where),
    }[name]()
    return timeless(msgspec.json.decode(msgspec.json.encode(found)))


@pytest.fixture(scope="module")
def cluster():
    from distributed import LocalCluster

    options: Any = {"n_workers": 2, "threads_per_worker": 1, "dashboard_address": None}
    local: Any = LocalCluster(**options)
    with local:
        yield Workers(backend="dask", address=local.scheduler_address)


def compare(name: str, there: Workers, policy: Path, folder: Path) -> None:
    one = rows(name, folder / "here" / "out", Workers(jobs=1), policy)
    other = rows(name, folder / "there" / "out", there, policy)
    assert msgspec.json.encode(one).replace(b"/here/", b"/there/") == msgspec.json.encode(other)


@pytest.mark.cluster
@pytest.mark.parametrize("name", NAMES)
def test_a_cluster_gives_the_rows_of_threads(cluster, name, near_file, tmp_path):
    compare(name, cluster, near_file, tmp_path)


@pytest.mark.slow
def test_processes_give_the_rows_of_threads(near_file, tmp_path):
    compare("study", Workers(jobs=2, backend="loky"), near_file, tmp_path)

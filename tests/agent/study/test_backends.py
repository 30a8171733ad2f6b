"""Commands on a Dask cluster of two workers give the rows that they give in threads."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import pytest

from agent.evaluation.claims import claim_of
from agent.mdp.config import ProcessConfig
from agent.study.evaluate import evaluate
from agent.study.transfer import robustness, transfer
from agent.study.user import study
from agent.training.runs import Experiment, train_runs
from agent.training.settings import LearningConfig
from cosim.base.jobs import Workers
from cosim.machine.validation import validate as measurement
from cosim.machine.validation.published import SPEEDS
from cosim.model.scenario_file import ROUGH, find_scenario, read_world
from cosim.simulation.options import SimulationOptions
from tests.agent.study.test_transfer import BOARD
from tests.faults.killing import timeless


class Place:
    """Where a command runs, and what it may need.

    Attributes:
        out: folder of results.
        where: backend.
        policy, board: files.
    """

    def __init__(self, out: Path, where: Workers, policy: Path) -> None:
        self.out, self.where, self.policy = out, where, policy
        out.parent.mkdir()
        self.board = out.parent / "near.toml"
        self.board.write_text(BOARD)


def of_claim(place: Place, _: pytest.MonkeyPatch) -> Any:
    options: Any = {"claim": claim_of("success > 0.5", 0.9), "starts": 9, "recordings": 0}
    return evaluate([place.policy], SimulationOptions(), place.out, where=place.where, **options)


def of_evaluate(place: Place, _: pytest.MonkeyPatch) -> Any:
    return evaluate([place.policy], SimulationOptions(), place.out, recordings=0, where=place.where)


def of_robustness(place: Place, _: pytest.MonkeyPatch) -> Any:
    board, axes = str(place.board), ("nothing", "delay")
    few: Any = {"scenario": board, "axes": axes, "methods": ("paper",), "episodes": 1}
    return robustness(place.out, read_world(ROUGH), where=place.where, **few)


def of_study(place: Place, _: pytest.MonkeyPatch) -> Any:
    work = {"out": place.out, "backend": place.where.backend, "address": place.where.address}
    return study(place.policy, noise=[0.0, 0.05], episodes=2, **work).rows


def of_training(place: Place, _: pytest.MonkeyPatch) -> Any:
    few = LearningConfig(episodes=2000, greedy_points=1)
    runs = train_runs(
        Experiment(find_scenario("2"), ProcessConfig(), few, 3, 2), place.out, where=place.where
    )
    return [(run.run, run.policy.digest()) for run in runs]


def of_transfer(place: Place, _: pytest.MonkeyPatch) -> Any:
    few: Any = {"scenarios": (str(place.board),), "methods": ("paper",), "quick": True}
    return transfer(place.out, where=place.where, **few)


def of_validate(place: Place, patch: pytest.MonkeyPatch) -> Any:
    patch.setattr(measurement, "SPEEDS", SPEEDS[-2:])
    patch.setattr(measurement, "PATHS", ())
    patch.setattr(measurement, "cache_dir", lambda _: place.out)
    place.out.mkdir()
    fmu = SimulationOptions().fmu()
    return measurement.validate(fmu, measurement.QUICK, where=place.where).speeds


OF: dict[str, Callable[[Place, pytest.MonkeyPatch], Any]] = {
    "claim": of_claim,
    "evaluate": of_evaluate,
    "robustness": of_robustness,
    "study": of_study,
    "training": of_training,
    "transfer": of_transfer,
    "validate": of_validate,
}


def rows(name: str, place: Place) -> Any:
    with pytest.MonkeyPatch.context() as patch:
        return timeless(msgspec.json.decode(msgspec.json.encode(OF[name](place, patch))))


@pytest.fixture(scope="module")
def cluster():
    from distributed import LocalCluster

    options: Any = {"n_workers": 2, "threads_per_worker": 1, "dashboard_address": None}
    local: Any = LocalCluster(**options)
    with local:
        yield Workers(backend="dask", address=local.scheduler_address)


@pytest.mark.cluster
@pytest.mark.parametrize("name", OF)
def test_a_cluster_gives_the_rows_of_threads(cluster, name, near_file, tmp_path):
    here = rows(name, Place(tmp_path / "here" / "out", Workers(jobs=1), near_file))
    there = rows(name, Place(tmp_path / "there" / "out", cluster, near_file))
    assert msgspec.json.encode(here).replace(b"/here/", b"/there/") == msgspec.json.encode(there)


@pytest.mark.slow
def test_processes_give_the_rows_of_threads(near_file, tmp_path):
    here = rows("evaluate", Place(tmp_path / "here" / "out", Workers(jobs=1), near_file))
    place = Place(tmp_path / "there" / "out", Workers(jobs=2, backend="loky"), near_file)
    there = rows("evaluate", place)
    assert msgspec.json.encode(here).replace(b"/here/", b"/there/") == msgspec.json.encode(there)

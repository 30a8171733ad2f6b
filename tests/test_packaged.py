"""Results of the default configuration that are in the packages: found, and with these bits.

Where a default, the FMU or the `VERSION` of a producer has changed, measure them again (40 s of
processor time):
`PACKAGED=write uv run --group test pytest -n 0 -m slow tests/test_packaged.py`. If bits change
with it, CHANGELOG says so.
"""

import os
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from agent.training.methods import method_config
from cosim.base.storage import CACHE, PACKAGED, cache_dir
from cosim.calibration.measuring import calibrated
from cosim.calibration.shielding import with_stopping_distance
from cosim.fmi.motor import MotorFmu
from cosim.model.config import CoSimConfig
from cosim.model.params import SHIELD
from cosim.model.scenario_file import find_scenario
from cosim.model.world import World
from fmus.build import cached_fmu


def prepared(**options: Any) -> CoSimConfig:
    return calibrated(replace(CoSimConfig(), **options), cached_fmu(), slower=True)


FLOOR = CoSimConfig().in_world(World(mu=0.2))  # the example of the README
DEFAULTS: dict[str, Callable[[], Any]] = {
    "calibration": prepared,
    "calibration on another floor": lambda: calibrated(FLOOR, cached_fmu(), slower=True),
    "shield": lambda: with_stopping_distance(prepared(shield=SHIELD), cached_fmu()),
    "moves": lambda: method_config("moves", find_scenario("2")),
    "moves through cells": lambda: method_config("fastest", find_scenario("2")),
}


def files(folder: Path) -> dict[str, Path]:
    """Results in a cache, by kind and name."""
    found = [path for path in folder.glob("*/*") if path.suffix in {".json", ".npz"}]
    kinds = ("calibrations", "moves")
    return {f"{p.parent.name}/{p.name}": p for p in found if p.parent.name in kinds}


@pytest.fixture
def empty_cache(tmp_path, monkeypatch) -> Path:
    MotorFmu(cached_fmu())  # unpacked
    for folder in map(cache_dir, ("fmus", "kernels", "unpacked")):
        (tmp_path / folder.name).symlink_to(folder, target_is_directory=True)
    monkeypatch.setenv(CACHE, str(tmp_path))
    return tmp_path


def test_nothing_is_measured_where_everything_has_its_default(empty_cache):
    for name, default in DEFAULTS.items():
        default()
        assert not files(empty_cache), f"{name} is of another version: write it as above"


@pytest.mark.parametrize(
    "names",
    [
        pytest.param(("calibration", "moves"), marks=pytest.mark.long),
        pytest.param(tuple(DEFAULTS), marks=pytest.mark.slow),
    ],
    ids=["some", "all"],
)
def test_packaged_results_are_what_this_machine_measures(names, empty_cache, monkeypatch):
    monkeypatch.setattr("cosim.base.storage.PACKAGED", empty_cache / "none")
    for name in names:
        DEFAULTS[name]()
    found, everything = files(empty_cache), names == tuple(DEFAULTS)
    if everything and os.environ.get("PACKAGED") == "write":
        shutil.rmtree(PACKAGED, ignore_errors=True)
        for name, path in found.items():
            (PACKAGED / name).parent.mkdir(parents=True, exist_ok=True)
            for file in (path, path.with_name(f"{path.name}.sha256")):
                shutil.copy(file, PACKAGED / Path(name).parent)
    packaged = files(PACKAGED)
    assert packaged.keys() == found.keys() if everything else packaged.keys() > found.keys() > set()
    for name, path in found.items():
        if path.suffix == ".npz":
            with np.load(path) as new, np.load(packaged[name]) as old:
                assert {k: v.tobytes() for k, v in new.items()} == {
                    k: v.tobytes() for k, v in old.items()
                }
        else:
            assert path.read_bytes() == packaged[name].read_bytes()

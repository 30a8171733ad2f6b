"""Every field of a configuration is where it has to be: in batches, tables and keys of caches."""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from agent.moves import observe
from agent.moves.worlds import RANGES
from cosim.base.arguments import ConfigError
from cosim.base.errors import UserError
from cosim.calibration import primitives, shielding
from cosim.calibration.measuring import Point, digest, measure_batch
from cosim.fmi.motor import MotorFmu
from cosim.model.config import CoSimConfig
from cosim.model.params import ESTIMATOR, PAIR, SHIELD, STEERING, Drive, Foot, Mount
from cosim.model.world import Patch, Sensor, World
from cosim.simulation.batch import shared

CAMERA = Sensor(30.0, 50.0, 0.5, 1.0, 0.1)
CONFIG = CoSimConfig(shield=SHIELD, world=World(sensor=CAMERA, payload_g=5.0))

# What episodes of a batch may differ by: every lane has its own, see tests/cosim/simulation
# (test_worlds_share_a_batch_and_keep_their_bits).
OF_A_LANE = {"robot.mu", "noise.relative_amplitude"} | {
    f"world.{name}" for name in World.__struct_fields__
}
NAMES_ALONE = {"preset", "sources"}  # of parameters, which are fields of their own
# Obstacles are the scenario's, the FMU has a digest of its own in results; a world's friction and
# noise are those of robot and noise, see `CoSimConfig.in_world`.
NOT_IN_TABLE = {"world.obstacles", "motor_fmu", "world.mu", "world.motor_speed_noise"}


def leaves(config: CoSimConfig) -> dict[str, Any]:
    """Values of all fields, those of records one by one, by name."""
    found = {}
    for name, value in vars(config).items():
        inner = getattr(value, "_asdict", dict)() or (
            msgspec.structs.asdict(value) if isinstance(value, msgspec.Struct) else {}
        )
        found |= {f"{name}.{field}": part for field, part in inner.items()} or {name: value}
    return found


def another(name: str, value: Any) -> Any:
    """Return another value of a field."""
    given = {
        "world.mu_patches": (Patch((0, 0, 1, 1), 0.3),),
        "world.obstacles": ((0, 0),),
        "world.payload_offset_mm": (1.0, 2.0),
        "world.motor_phases_deg": (1.0, 2.0),
        "world.sensor": msgspec.structs.replace(CAMERA, rate_hz=10.0),
        "on_collision": "continue",
        "open_loop": ("motors",),
        "preset": "thesis",
        "sources": (("mu", "elsewhere"),),
        "motor_parameters": (("L", 1e-5),),
        "motor_fmu": "another",
        "robot.inertia_kg_m2": (1e-5, 1e-5, 2e-5),
        "robot.motors": (Mount((0.0, 0.01, 0.003), (1.0, 0.0, 0.0)),) * 2,
        "robot.feet": (Foot(0.02, 0.0), Foot(-0.01, 0.01), Foot(-0.01, -0.01)),
        "steering.shares": PAIR[::-1],
        "steering.drives": (Drive(speed=0.5),) * 4,
    }
    if name in given:
        return given[name]
    return not value if isinstance(value, bool) else (value or 0.0) + 0.125


def changed(name: str) -> CoSimConfig:
    """Return the configuration with another value of a field, whether it fits the others or not."""
    config, (record, _, part) = replace(CONFIG), name.partition(".")
    value = another(name, leaves(CONFIG)[name])
    if part:
        of = getattr(config, record)
        change = msgspec.structs.replace if isinstance(of, msgspec.Struct) else type(of)._replace
        value = change(of, **{part: value})
    object.__setattr__(config, record, value)
    return config


NAMES = sorted(leaves(CONFIG))


@pytest.mark.parametrize("name", NAMES)
def test_a_batch_shares_every_field_or_has_it_per_lane(name):
    expected = name in OF_A_LANE | NAMES_ALONE
    assert (shared(changed(name)) == shared(CONFIG)) == expected


@pytest.mark.parametrize("name", NAMES)
def test_the_table_has_every_field(name):
    assert (changed(name).table() == CONFIG.table()) == (name in NOT_IN_TABLE)


# What decides nothing where robots are far apart, with what cameras see, and worlds but for a load.
APART = {"timing.rl_step_s", "timing.move_limit_s", "timing.episode_limit_s", "timing.burst_s"}
APART |= {f"shield.{name}" for name in SHIELD._fields} | {"on_collision", "through", "preset"}
APART |= {f"estimator.{name}" for name in ESTIMATOR._fields}
APART |= {f"world.{n}" for n in World.__struct_fields__}
APART -= {f"world.{n}" for n in ("restitution", "payload_g", "payload_offset_mm")}  # the load
STEERED = {f"steering.{name}" for name in STEERING._fields}
# By the function that looks for a measurement: fields of a configuration that change nothing of it.
IDLE: dict[Callable[[CoSimConfig, Path], object], set[str]] = {
    observe.cached_moves: set(),
    primitives.find_primitives: APART | STEERED - {"steering.pulse_s", "steering.pause_s"},
    shielding.with_stopping_distance: APART - {"world.motor_spread", "world.floor_tilt_deg"},
}


@pytest.mark.parametrize("find", IDLE, ids=lambda find: find.__name__)
def test_a_measurement_is_known_by_every_field_that_may_change_it(find, motor_fmu, monkeypatch):
    def stop(key: Any, *_: Any, **__: Any) -> None:
        raise UserError(f"it is looked for as {key}")

    def said(config: CoSimConfig) -> str:
        with pytest.raises(UserError) as refused:  # or what does not fit the other values
            find(config, motor_fmu)
        return str(refused.value)

    for place in (primitives, shielding):
        monkeypatch.setattr(place, "measured", stop)
    monkeypatch.setattr(observe, "cached", stop)
    usual = said(CONFIG)
    assert "looked for" in usual
    assert {name for name in NAMES if said(changed(name)) == usual} == IDLE[find] | {"sources"}


def test_moves_are_known_by_the_edge_of_their_cells(motor_fmu, monkeypatch):
    looked = []
    monkeypatch.setattr(observe, "cached", lambda path, *_, **__: looked.append(path))
    for cell_m in (0.01, 0.012, 0.0121):
        observe.cached_moves(CONFIG, motor_fmu, cell_m=cell_m)
    assert len(set(looked)) == 3


def test_moves_are_known_by_every_range_of_their_worlds(motor_fmu):
    given = {"patches": 2, "patch_cells": (2, 3)}
    ranges = [RANGES._replace(**{n: given.get(n, (0.1, 0.2))}) for n in RANGES._fields]
    keys = {observe.source_digest(CONFIG, motor_fmu, each) for each in (None, RANGES, *ranges)}
    assert len(keys) == len(ranges) + 2


@pytest.fixture(scope="module")
def trial(motor_fmu):
    """Measures a robot that drives and one that turns, as a calibration does."""
    points = [Point("forwards", 900.0), Point("left_turn", 900.0)]
    fmu = MotorFmu(motor_fmu)
    return lambda config: measure_batch(config, fmu, points, np.random.SeedSequence(0))


@pytest.fixture(scope="module")
def measured(trial):
    return trial(CONFIG)


@pytest.mark.long
@pytest.mark.parametrize("name", NAMES)
def test_a_calibration_is_known_by_every_field_that_changes_it(name, trial, measured, motor_fmu):
    config = changed(name)
    if name == "open_loop":  # `find_calibration` takes it out
        return
    with suppress(ConfigError):  # of values that do not fit the others
        if digest(config, motor_fmu) == digest(CONFIG, motor_fmu):
            np.testing.assert_array_equal(trial(config), measured)

"""Every field of a configuration is where it has to be: in batches, tables and keys of caches."""

from contextlib import suppress
from dataclasses import replace
from typing import Any

import msgspec
import numpy as np
import pytest

from cosim.base.arguments import ConfigError
from cosim.calibration.measuring import Point, digest, measure_batch
from cosim.fmi.motor import MotorFmu
from cosim.model.config import CoSimConfig
from cosim.model.params import PAIR, SHIELD, Drive, Foot, Mount
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

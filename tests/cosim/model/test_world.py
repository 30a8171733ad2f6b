"""Worlds, and tables [world] of files: what is refused, and what an episode draws."""

import json
import math

import numpy as np
import pytest

from cosim.base.errors import UserError
from cosim.model.config import CoSimConfig
from cosim.model.params import TABLE_II
from cosim.model.scenario_file import find_in_world, find_scenario
from cosim.model.world import IDEAL, Patch, Sensor, World
from cosim.physics.draws import Drawn, draw_world
from cosim.physics.properties import gravity

PAIR = (TABLE_II, TABLE_II)
SEED = np.random.SeedSequence(7)


@pytest.mark.parametrize(
    ("kind", "values", "said"),
    [
        (World, {"restitution": 1.5}, "world.restitution = 1.5 is invalid: .*; give 0 to 1"),
        (World, {"motor_spread": -0.1}, "world.motor_spread"),
        (World, {"mu": -1.0}, "world.mu"),
        (World, {"floor_tilt_deg": 90.0}, "world.floor_tilt_deg"),
        (World, {"motor_phases_deg": (0.0, 400.0)}, r"world.motor_phases_deg\[1\] = 400"),
        (World, {"payload_offset_mm": (1.0, 0.0)}, "no effect without a payload"),
        (World, {"payload_g": 1.0, "payload_offset_mm": (0.0, np.nan)}, r"offset_mm\[1\] = nan"),
        (Sensor, {"rate_hz": 30.0, "dropout": 1.0}, "world.sensor.dropout"),
        (Sensor, {"delay_ms": 50.0}, "world.sensor.delay_ms has no effect without a camera"),
        (Patch, {"cells": (0, 0, 1, 1), "mu": -0.1}, "world.mu_patches.mu"),
    ],
)
def test_worlds_that_cannot_be_are_refused(kind, values, said):
    with pytest.raises(UserError, match=said):
        kind(**values)


def test_an_ideal_world_draws_nothing():
    assert not IDEAL.draws
    pair = TABLE_II, TABLE_II
    assert draw_world(IDEAL, PAIR, 2, SEED) == Drawn((pair, pair), 0.0)
    assert CoSimConfig().in_world(IDEAL) == CoSimConfig()


def test_motors_differ_as_declared():
    drawn = draw_world(World(motor_spread=0.1), PAIR, 2000, SEED)
    for name in ("K_T", "R", "J", "r"):
        nominal = getattr(TABLE_II, name)
        factors = np.array([[getattr(m, name) / nominal for m in pair] for pair in drawn.motors])
        assert abs(factors.mean() - 1.0) < 0.01
        assert abs(factors.std() - 0.1) < 0.01
        assert 0.7 - 1e-9 <= factors.min() < factors.max() <= 1.3 + 1e-9
        assert len(np.unique(factors)) > 3900  # every motor alone
    assert {motor.m for pair in drawn.motors for motor in pair} == {TABLE_II.m}


def test_draws_are_the_seeds_alone():
    world = World(motor_spread=0.1, floor_tilt_deg=1.0)
    first = draw_world(world, PAIR, 2, SEED)
    assert draw_world(world, PAIR, 2, SEED) == first
    assert list(first.table()) == ["r1.D", "r1.E", "r2.D", "r2.E", "floor"]
    assert first.table()["r2.D"]["K_T"] == first.motors[1][0].K_T
    assert draw_world(world, PAIR, 2, np.random.SeedSequence(8)) != first


def test_parameters_of_a_world_are_values_of_json():
    world = World(
        mu_patches=(Patch((0, 1, 2, 3), 0.4),),
        payload_g=20.0,
        payload_offset_mm=(1.0, -2.0),
        motor_phases_deg=(0.0, 90.0),
    )
    table = CoSimConfig(world=world).table()
    values = {name: row["value"] for name, row in table.items()}
    assert json.loads(json.dumps(values)) == values
    assert values["mu_patches"] == [{"cells": [0, 1, 2, 3], "mu": 0.4}]
    assert values["payload_offset_mm"] == [1.0, -2.0]
    assert values["motor_phases_deg"] == [0.0, 90.0]


def test_gravity_falls_where_the_floor_does():
    x, y, z = gravity(10.0, 90.0, 9.81)
    assert math.hypot(x, y, z) == pytest.approx(9.81)
    assert x == pytest.approx(0.0, abs=1e-12)
    assert y == pytest.approx(9.81 * math.sin(math.radians(10.0)))
    assert gravity(0.0, 0.0, 9.81) == (0.0, 0.0, -9.81)


SCENARIO = """
columns = 20
rows = 20
[[robots]]
target = [5, 15]
starts = "bottom"
"""
WORLD = """
[world]
mu = 0.2
mu_patches = [{cells = [0, 0, 9, 9], mu = 0.1}]
obstacles = [[14, 10, 16, 12]]
[world.sensor]
rate_hz = 30
"""


@pytest.mark.parametrize("mark", ["", "\ufeff"])  # with which editors on Windows begin files
def test_a_scenario_may_have_a_world(written, mark):
    scenario, world = find_in_world(written(mark + SCENARIO + WORLD, "own.toml"))
    assert world.mu == 0.2
    assert world.mu_patches == (Patch((0, 0, 9, 9), 0.1),)
    assert world.sensor == Sensor(rate_hz=30.0)
    assert len(scenario.obstacles) == 9
    assert scenario.blocks(2 * 15 + 1, 2 * 11 + 1)


def test_a_world_file_goes_with_any_scenario(written):
    path = written(WORLD, "world.toml")
    own, _ = find_in_world(written(SCENARIO + WORLD, "own.toml"))
    beside, world = find_in_world(written(SCENARIO, "own2.toml"), path)
    assert beside.digest() == own.digest()
    assert world.mu == 0.2
    assert find_in_world("4") == (find_scenario("4"), IDEAL)


@pytest.mark.parametrize(
    ("world", "said"),
    [
        ("[world]\nmue = 0.2", "mue"),
        ("[word]\nmu = 0.2", "word"),
        ("mu = 0.2", "mu"),
        ("[world]\nrestitution = 2", "world.toml: world.restitution = 2 is invalid"),
        ("[world]\nmu = 'slippery'", "world.mu"),
        ("[world]\nmu_patches = [{cells = [0, 0, 30, 9], mu = 0.1}]", "not a rectangle"),
        ("[world]\nobstacles = [[1, 2, 3]]", "world.obstacles"),
        ("[world]\nobstacles = [[9, 5, 3, 8]]", "world.obstacles.*is neither a cell"),
        ("[world]\nobstacles = [[15, 18]]", "touches an obstacle"),
        ("[world", "not a TOML file"),
    ],
)
def test_what_is_wrong_is_named(written, world, said):
    with pytest.raises(UserError, match=said):
        find_in_world("2", written(world, "world.toml"))


def test_two_worlds_are_refused(written):
    own, other = written(SCENARIO + WORLD, "own.toml"), written(WORLD, "world.toml")
    with pytest.raises(UserError, match="a world of its own in addition to"):
        find_in_world(own, other)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(UserError, match=r"none\.toml: no such world file"):
        find_in_world("2", tmp_path / "none.toml")


def test_a_world_that_would_have_no_effect_is_refused(written):
    obstacles = "\n[world]\nobstacles = [[14, 10]]\n"
    walled = find_scenario(written(SCENARIO + obstacles, "walled.toml"), ideal=True)
    assert (14, 10) in walled.obstacles
    with pytest.raises(UserError, match="only obstacles have an effect here"):
        find_scenario(written(SCENARIO + WORLD, "own.toml"), ideal=True)

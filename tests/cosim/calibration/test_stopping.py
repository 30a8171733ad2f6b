"""The stopping distance that the shield's proof rests on."""

from dataclasses import replace

import pytest

from cosim.base.config import CoSimConfig
from cosim.base.params import SHIELD
from cosim.base.world import Patch, World
from cosim.calibration.speed_map import CalibrationError
from cosim.calibration.stopping import RESERVE, shielded, stopping_distances
from cosim.coupling.fmu import MotorFmu


def test_robots_stop_within_half_of_what_the_shield_allows_for(motor_fmu):
    moved, restless_s = stopping_distances(CoSimConfig(), MotorFmu(motor_fmu), 32, seed=0)
    assert 0.02e-3 < moved.max() < SHIELD.stopping_m / RESERVE
    assert restless_s.max() < 0.03


def test_robots_stop_later_the_less_friction_there_is(motor_fmu):
    """So that it is enough to measure on the most slippery patch."""
    fmu, usual = MotorFmu(motor_fmu), CoSimConfig()
    floors = [replace(usual, robot=usual.robot._replace(mu=mu)) for mu in (0.12, 0.16, 0.22, 0.3)]
    moved = [stopping_distances(config, fmu, 32, seed=0)[0].max() for config in floors]
    assert moved == sorted(moved, reverse=True)


def test_motors_without_control_take_longer_to_stop(motor_fmu, monkeypatch, tmp_path):
    monkeypatch.setenv("MINIROBOTS_CACHE", str(tmp_path))
    monkeypatch.setattr("cosim.calibration.stopping.ROBOTS", 16)
    monkeypatch.setattr("cosim.calibration.stopping.TRIALS", 1)
    configs = CoSimConfig(), CoSimConfig(open_loop=("motors",))
    controlled, coasting = (shielded(c, motor_fmu).shielding.stopping_m for c in configs)
    assert 1.2 * controlled < coasting < 1e-3


@pytest.mark.parametrize(
    "world", [World(mu_patches=(Patch((0, 0, 1, 1), 0.05),)), World(floor_tilt_deg=3.0)]
)
def test_a_slippery_patch_and_a_slope_count(motor_fmu, monkeypatch, tmp_path, world):
    monkeypatch.setenv("MINIROBOTS_CACHE", str(tmp_path))
    monkeypatch.setattr("cosim.calibration.stopping.ROBOTS", 16)
    monkeypatch.setattr("cosim.calibration.stopping.TRIALS", 1)
    config, worse = CoSimConfig(), CoSimConfig(world=world)
    usual, longer = (shielded(c, motor_fmu).shielding.stopping_m for c in (config, worse))
    assert usual < longer
    assert shielded(config, motor_fmu).shielding.stopping_m == usual  # from the cache
    assert len(list(tmp_path.glob("calibrations/*.json"))) == 2
    with pytest.raises(CalibrationError, match="slide on"):
        shielded(CoSimConfig(world=World(floor_tilt_deg=10.0)), motor_fmu)

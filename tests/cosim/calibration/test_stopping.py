"""The stopping distance that the shield's proof rests on."""

from cosim.base.config import CoSimConfig
from cosim.base.params import SHIELD
from cosim.base.world import Patch, World
from cosim.calibration.stopping import RESERVE, shielded, stopping_distances
from cosim.coupling.fmu import MotorFmu


def test_robots_stop_within_half_of_what_the_shield_allows_for(motor_fmu):
    moved, restless_s = stopping_distances(CoSimConfig(), MotorFmu(motor_fmu), 32, seed=0)
    assert 0.02e-3 < moved.max() < SHIELD.stopping_m / RESERVE
    assert restless_s.max() < 0.03


def test_motors_without_control_take_longer_to_stop(motor_fmu, monkeypatch, tmp_path):
    monkeypatch.setenv("MINIROBOTS_CACHE", str(tmp_path))
    monkeypatch.setattr("cosim.calibration.stopping.ROBOTS", 16)
    monkeypatch.setattr("cosim.calibration.stopping.TRIALS", 1)
    configs = CoSimConfig(), CoSimConfig(open_loop=("motors",))
    controlled, coasting = (shielded(c, motor_fmu).shielding.stopping_m for c in configs)
    assert 1.2 * controlled < coasting < 1e-3


def test_a_slippery_patch_counts(motor_fmu, monkeypatch, tmp_path):
    monkeypatch.setenv("MINIROBOTS_CACHE", str(tmp_path))
    monkeypatch.setattr("cosim.calibration.stopping.ROBOTS", 16)
    monkeypatch.setattr("cosim.calibration.stopping.TRIALS", 1)
    config = CoSimConfig()
    icy = CoSimConfig(world=World(mu_patches=(Patch((0, 0, 1, 1), 0.05),)))
    usual, slippery = (shielded(c, motor_fmu).shielding.stopping_m for c in (config, icy))
    assert usual < slippery
    assert shielded(config, motor_fmu).shielding.stopping_m == usual  # from the cache
    assert len(list(tmp_path.glob("calibrations/*.json"))) == 2

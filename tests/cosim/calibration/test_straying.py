"""The error of estimates that the shield's claim rests on, measured in the world."""

from dataclasses import replace

import numpy as np
import pytest

from cosim.calibration import shielding, straying
from cosim.calibration.shielding import with_stopping_distance
from cosim.calibration.straying import NOISE_DEVIATIONS, bias_of, drive_about
from cosim.fmi.motor import MotorFmu
from cosim.model.config import CoSimConfig
from cosim.model.params import ESTIMATOR, EstimatorParams
from cosim.model.world import Patch, Sensor, World
from cosim.simulation.options import SimulationOptions

CAMERA = Sensor(rate_hz=10.0, delay_ms=200.0, position_noise_mm=3.0, heading_noise_deg=4.0)
SLOPE = World(mu=0.15, floor_tilt_deg=4.0, sensor=CAMERA)


@pytest.fixture
def quick(monkeypatch):
    monkeypatch.setattr(straying, "ROBOTS", 8)
    monkeypatch.setattr(straying, "LENGTH_S", 5.0)


@pytest.mark.long
def test_a_slope_biases_estimates_by_more_than_their_noise(motor_fmu, quick):
    """With the usual filter: five deviations, for noise and bias together, were too few."""
    fmu = MotorFmu(motor_fmu)
    level, steep = (
        bias_of(drive_about(config, fmu, straying.ROBOTS, seed=0), config)[0]
        for config in (CoSimConfig(world=World(sensor=CAMERA)), CoSimConfig(world=SLOPE))
    )
    assert level < 3.0
    assert steep > 5.0


@pytest.mark.long
def test_the_filter_of_a_slope_trusts_its_motion_less(motor_fmu, quick):
    drift, deviations, _ = straying.best_filter(CoSimConfig(world=SLOPE), MotorFmu(motor_fmu))
    assert drift > ESTIMATOR.position_drift_m2_s
    assert deviations > NOISE_DEVIATIONS + 1.0
    level = CoSimConfig(world=World(sensor=CAMERA))
    assert straying.best_filter(level, MotorFmu(motor_fmu))[0] == ESTIMATOR.position_drift_m2_s


@pytest.mark.long
def test_robots_that_stand_have_no_bias(motor_fmu, quick, monkeypatch):
    monkeypatch.setattr(straying, "_HOLDS", 1.0)
    config = CoSimConfig(world=SLOPE)
    bias, deviation_m = bias_of(drive_about(config, MotorFmu(motor_fmu), 4, seed=0), config)
    assert bias < 1e-3
    assert deviation_m < 2e-3  # of a frame 3 mm


@pytest.mark.slow
@pytest.mark.parametrize(
    "world",
    [
        SLOPE,
        World(floor_tilt_deg=2.0, sensor=Sensor(30.0, 50.0, 0.5, 1.0)),
        World(mu_patches=(Patch((0, 0, 5, 5), 0.4),), sensor=Sensor(30.0, 50.0, 0.5, 1.0)),
    ],
)
def test_other_robots_have_no_larger_bias(world):
    config, fmu = SimulationOptions(shield=True).prepare(world=world)
    shield, config = config.shield, replace(config, shield=None)
    assert shield is not None
    for seed in (1, 2):
        bias, _ = bias_of(drive_about(config, MotorFmu(fmu), straying.ROBOTS, seed), config)
        assert np.isfinite(bias)
        assert NOISE_DEVIATIONS + bias < shield.deviations


@pytest.mark.long
def test_errors_are_measured_with_the_filter_of_the_robots(motor_fmu, quick, monkeypatch):
    monkeypatch.setattr(shielding, "TRIALS", 1)
    own = EstimatorParams(1.5 * ESTIMATOR.position_drift_m2_s, settle_s=0.2)
    config = CoSimConfig(world=World(sensor=CAMERA), estimator=own)
    found = with_stopping_distance(config, motor_fmu).estimator
    assert found == own._replace(position_drift_m2_s=found.position_drift_m2_s)
    octaves = np.log2(found.position_drift_m2_s / own.position_drift_m2_s)
    assert octaves == pytest.approx(round(octaves))  # its own filter, or one next to it

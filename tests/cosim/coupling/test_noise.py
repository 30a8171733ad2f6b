"""Speed noise in the co-simulation: ±5 % of each motor's set point, and none where that is 0."""

import numpy as np
import pytest

from cosim.calibration.trial import Trial
from cosim.fmi.motor import MotorFmu
from cosim.model.config import CoSimConfig
from cosim.model.params import TABLE_II
from cosim.onboard.steering import DIRECT, HOLD, MODE, OMEGA_D, OMEGA_E


@pytest.fixture(scope="module")
def driven_and_stopped(motor_fmu):
    """Samples of three robots that drive, then stop: one never did, the others at some speeds."""
    seed = np.random.SeedSequence(0)
    with Trial(MotorFmu(motor_fmu), CoSimConfig(), np.zeros(3), seed) as trial:
        trial.commands[0, MODE] = HOLD
        trial.commands[1:, MODE] = DIRECT
        trial.commands[1:, [OMEGA_D, OMEGA_E]] = [(-1000.0, 800.0), (500.0, 0.0)]
        driven = trial.advance(1500)
        trial.commands[:, MODE] = HOLD
        trial.advance(500)
        return driven, trial.advance(500)


def test_a_motor_hears_noise_in_proportion_to_its_set_point(driven_and_stopped):
    """Voltages of Eq. (14) jump by K_p times the difference of two values of the noise."""
    driven, _ = driven_and_stopped
    jumps = np.diff(driven.voltage[500:], axis=0).std(axis=0).reshape(-1)
    # two independent values, uniform within ±5 %; the speed answers within the period to some of it
    whole = TABLE_II.K_p * 0.05 * np.sqrt(2.0 / 3.0)
    speeds = np.array([1000.0, 800.0, 500.0])
    assert jumps[2:5] == pytest.approx(0.9 * whole * speeds, rel=0.1)
    assert jumps[2:5] / jumps[4] == pytest.approx(speeds / 500.0, rel=0.05)


def test_parked_motors_do_not_hunt(driven_and_stopped):
    driven, stopped = driven_and_stopped
    for samples, robot in ((driven, 0), (stopped, 0)):
        assert not samples.voltage[:, robot].any()
        assert not samples.omega[:, robot].any()
    assert not driven.omega[:, 2, 1].any()
    # Eq. (14) alone brings the others to rest: smoothly, without the jumps of a driven motor
    jumps = [np.abs(np.diff(each.voltage[-200:, 1], axis=0)).max() for each in (driven, stopped)]
    assert jumps[1] < 0.05 * jumps[0]

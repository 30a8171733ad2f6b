"""Motors and their speed noise: ±5 % of each set point, and none where that is 0."""

from dataclasses import replace

import numpy as np
import pytest

from cosim.calibration.trial import Trial
from cosim.coupling.assembly import SpeedNoise
from cosim.fmi.motor import MotorFmu
from cosim.fmi.motors import Motors
from cosim.model.config import CoSimConfig
from cosim.model.params import TABLE_II
from cosim.model.scenario import Scenario
from cosim.onboard.steering import DIRECT, HOLD, MODE, OMEGA_D, OMEGA_E
from tests.alone import CoSimulation

PAIR = ((TABLE_II, TABLE_II),)


@pytest.mark.parametrize(
    ("hold", "steps"), [(1, (10,)), (3, (10,)), (3, (1, 2, 4, 3)), (7, (5, 5))]
)
def test_noise_of_a_motor_is_its_own_generators(hold, steps):
    """A value holds its time, however many RL steps end within it."""
    config = CoSimConfig()
    config = replace(config, noise=config.noise._replace(hold_s=hold * 1e-3))
    seed = np.random.SeedSequence(1)
    speed_noise = SpeedNoise(config, seed, 2)
    noise = np.concatenate([speed_noise.draw(periods) for periods in steps])
    assert noise.shape == (10, 2, 2)
    for k in range(4):
        own = np.random.default_rng(np.random.SeedSequence(1, spawn_key=(k,)))
        held = np.repeat(own.uniform(-1.0, 1.0, -(-10 // hold)), hold)[:10]
        assert np.array_equal(noise[:, k // 2, k % 2], held * config.noise.relative_amplitude)


@pytest.mark.parametrize("fmu", ["motor_fmu", "array_fmu"])
def test_motors_begin_with_the_angle_and_the_speed_that_their_fmu_says(fmu, request):
    fmu = MotorFmu(request.getfixturevalue(fmu))
    config = replace(CoSimConfig(), motor_parameters=(("theta_start", 0.3), ("omega_start", 50.0)))
    motors, phases = Motors(fmu, config, 2), np.array([[np.nan, 2.0]])
    for _ in range(2):  # also when they begin again
        assert motors.restart([1], PAIR, phases).tolist() == [[0.3], [2.0], [50.0], [50.0]]
        motors.step(100, config.timing.dt_s)
    motors.close()


def test_the_first_exchange_has_them(motor_fmu):
    """Bodies see outputs between those of the start and the end of a communication step."""
    scenario = Scenario("one", "", ((15, 18),), (((15, 15),),))
    timing = CoSimConfig().timing._replace(communication_step_s=1e-3, rl_step_s=1e-3, burst_s=1e-3)
    pushes = []
    for given in (("omega_start", 0.0), ("omega_start", 1000.0)):
        config = replace(CoSimConfig(), timing=timing, motor_parameters=(given,))
        system = CoSimulation(scenario, motor_fmu, config)
        system.reset(((15, 15),), 0)
        pushes.append(system.step(np.array([2])).raw.normal[0].sum())
        system.close()
    at_rest, turning = pushes  # m r ω² of two masses that hang
    assert turning - at_rest == pytest.approx(2.0 * TABLE_II.m * TABLE_II.r * 1e6, rel=0.05)


@pytest.mark.parametrize("fmu", ["motor_fmu", "array_fmu"])
def test_a_restored_motor_goes_on_as_the_saved_one(fmu, request):
    """With its inputs, which nothing sets again, and the time that its steps owe."""
    fmu, config, dt_s = MotorFmu(request.getfixturevalue(fmu)), CoSimConfig(), 1e-5 * (1.0 + 6e-7)
    saved, restored = Motors(fmu, config, 1), Motors(fmu, config, 1)
    inputs = np.array([[700.0, -800.0, 5.0, -7.0, 1e-6, 2e-6]]).T
    for motors in (saved, restored):
        motors.restart([0], PAIR)
    saved.set_inputs(inputs, dt_s)
    for _ in range(101):  # an odd number: what is owed is made up for in every second step
        saved.step(1, dt_s)
    restored.set_state(saved.get_state())
    for count in (1, 1, 3):
        found = []
        for motors in (saved, restored):
            motors.step(count, dt_s)
            outputs, electrical = np.zeros((6, 1)), np.zeros((8, 1))
            motors.get_outputs(outputs, dt_s)
            motors.get_electrical(electrical, dt_s)
            found.append(np.concatenate([outputs, electrical]))
        assert np.array_equal(*found)
    for motors in (saved, restored):
        motors.close()


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

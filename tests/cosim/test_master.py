"""Both drivers give the same bits; a failing FMU is named."""

import numpy as np
import pytest

from cosim.body import body_params, standing_state
from cosim.fmu import FmuError, MotorFmu
from cosim.forces import motor_mounts
from cosim.master import DRIVERS
from cosim.params import STEERING, TABLE_I, TABLE_II, TIMING
from cosim.plant import COLLISION, Plant, new_raw_samples, new_samples, new_state
from cosim.steering import START

PERIODS, TICKS_PER_PERIOD, ROBOTS = 200, 100, 2


def advance(motor_fmu, driver, *, gap_m=0.1, noise=40.0, broken_period=None):
    """20 000 ticks of two robots that drive to the right."""
    fmu = MotorFmu(motor_fmu)
    motors = [fmu.instantiate(f"r{r + 1}.{m}") for r in range(ROBOTS) for m in "DE"]
    plant = Plant(
        body_params(TABLE_I, TABLE_II, TIMING.dt_s),
        *motor_mounts(TABLE_I, TABLE_II),
        STEERING,
        TABLE_I.diameter_m,
        0.3,
        0.3,
        TICKS_PER_PERIOD,
    )
    state = new_state(ROBOTS)
    for robot in range(ROBOTS):
        x = 0.05 + gap_m * robot
        state.bodies[robot] = standing_state(TABLE_I, x, 0.15, 0.3 + robot)
        state.commands[robot] = (x + 0.1, 0.15, 0.0, START, 1.0, 0.0)
    speeds = np.random.default_rng(0).uniform(-noise, noise, (PERIODS, ROBOTS, 2))
    if broken_period is not None:
        speeds[broken_period, 0, 0] = np.nan
    samples, raw = new_samples(PERIODS, ROBOTS), new_raw_samples(1000, ROBOTS)
    progress = DRIVERS[driver](motors).advance(plant, state, speeds, samples, raw, 0)
    for motor in motors:
        motor.close()
    return progress, state, samples, raw


def test_drivers_agree_in_every_bit(motor_fmu):
    compiled = advance(motor_fmu, "compiled")
    reference = advance(motor_fmu, "reference")
    assert compiled[0] == reference[0] == (PERIODS, 0)
    for a, b in zip(compiled[1:], reference[1:], strict=True):
        for name in a._fields:
            assert np.array_equal(getattr(a, name), getattr(b, name)), name
    assert np.abs(compiled[2].omega[-1]).min() > 800.0  # the motors did run


def test_runs_repeat_in_every_bit(motor_fmu):
    first, second = (advance(motor_fmu, "compiled") for _ in range(2))
    assert np.array_equal(first[1].bodies, second[1].bodies)
    other = advance(motor_fmu, "compiled", noise=41.0)
    assert not np.array_equal(first[1].bodies, other[1].bodies)


@pytest.mark.parametrize("driver", DRIVERS)
def test_collision_ends_the_advance(motor_fmu, driver):
    progress, *_ = advance(motor_fmu, driver, gap_m=0.0499)
    assert progress == (1, COLLISION)


@pytest.mark.parametrize("driver", DRIVERS)
def test_failing_fmu_is_named_with_its_time(motor_fmu, driver):
    with pytest.raises(FmuError, match=r"instance r1\.D, at 0\.00300 s .*: .*omega_noise"):
        advance(motor_fmu, driver, broken_period=3)

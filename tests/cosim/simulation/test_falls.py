"""Robots that do not stand any more end episodes and trials with an error that names them."""

import numpy as np
import pytest

from cosim.calibration.trial import Trial
from cosim.coupling.master import FallError
from cosim.fmi.motor import MotorFmu
from cosim.model.config import CoSimConfig
from cosim.model.params import STEERING
from cosim.model.scenario import Scenario
from cosim.physics.body_state import V_X, W_Y, Y, Z
from cosim.physics.properties import LAW
from cosim.simulation.batch import Batch

PAIR = Scenario("pair", "", ((5, 20), (20, 20)), (((5, 5),), ((20, 5),)))
DRIVES = STEERING.forward_speed_rad_s * np.array([-1.0, 1.0])


def batch_of_three(fmu, driver="compiled"):
    batch = Batch(fmu, CoSimConfig(), 2, 3, driver)
    for place in range(3):
        batch.begin(place, PAIR, ((5, 5), (20, 5)), np.random.SeedSequence(place))
    return batch, dict.fromkeys(range(3), np.array([2, 2]))


@pytest.mark.parametrize(
    "driver", ["compiled", "fmpy", pytest.param("reference", marks=pytest.mark.slow)]
)
def test_a_robot_that_tips_over_in_an_episode_is_named_with_the_time(driver, array_fmu):
    """The second robot of the last place, which turns in the air."""
    batch, actions = batch_of_three(array_fmu, driver)
    batch.state.bodies.motion[Z, 5] += 0.1
    batch.state.bodies.motion[W_Y, 5] = 50.0
    with pytest.raises(FallError, match=r"^robot 2 tips over at 0\.02 s of simulated time; lower"):
        batch.advance(actions)
    batch.close()


def test_contacts_that_are_not_solved_are_refused(array_fmu):
    """None is, for 3 ms, after many that were not."""
    batch, actions = batch_of_three(array_fmu)
    batch.state.bodies.properties[LAW + 3, 1], batch.state.bodies.unsolved[1] = -1.0, 750.0
    with pytest.raises(FallError, match=r"^the contacts of robot 2 .* not solved .* to 0\.00 s;"):
        batch.advance(actions)
    batch.close()


def test_a_robot_that_tips_over_in_a_trial_is_named_with_the_time(motor_fmu):
    """It slides at first, and friction turns it over: its centre of mass is high."""
    config = CoSimConfig().having("test", com_height_m=0.2, height_m=0.25)
    with Trial(MotorFmu(motor_fmu), config, np.zeros(2), np.random.SeedSequence(0)) as trial:
        trial.set_motors(DRIVES)
        trial.bodies[V_X, 1] = 1.0
        trial.advance(100)
        with pytest.raises(FallError, match=r"^robot 2 of a trial tips over at 0\.\d\d s"):
            trial.advance(1000)


def test_the_floor_of_a_trial_has_no_end(motor_fmu):
    """A robot near the corner of what would be a board drives on beyond it."""
    config = CoSimConfig()
    with Trial(
        MotorFmu(motor_fmu), config, np.array([-np.pi / 2]), np.random.SeedSequence(0)
    ) as trial:
        trial.bodies[Y] = 1e-3
        trial.set_motors(DRIVES)
        position = trial.advance(1000).position[:, 0]
    assert position[-1, 1] < -1e-3
    assert position[:, 2].min() > 0.9 * config.robot.com_height_m

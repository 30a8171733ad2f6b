"""Our master on the robots of a system: constant set points, open floor, no noise, no steering."""

import numpy as np

from cosim.coupling.assembly import Motors, new_plant, robot_properties
from cosim.coupling.fmu import MotorFmu
from cosim.coupling.master import CompiledDriver
from cosim.coupling.signals import new_raw_samples, new_samples, new_state
from cosim.model.config import CoSimConfig, Order
from cosim.model.params import TIMING
from cosim.onboard.steering import DIRECT, MODE, OMEGA_D, OMEGA_E
from cosim.physics.body_state import POSITION, QUATERNION, standing_state
from cosim.physics.trig import sine_cosine
from fmus.build import cached_fmu
from fmus.ssp.system import PAIR, Robot

PERIOD_S = TIMING.control_period_s


def drive(
    duration_s: float,
    order: Order = "gauss-seidel",
    step_s: float = TIMING.dt_s,
    robots: tuple[Robot, ...] = PAIR,
    *,
    exchange_first: bool = False,
) -> np.ndarray:
    """Poses (n, robots, 7) after every millisecond: x, y, z in m, and the quaternion.

    Args:
        duration_s: simulated time.
        order: of the coupling.
        step_s: communication step.
        robots: commands of each, and where it starts.
        exchange_first: whether bodies know the motors' outputs of the start in the first step,
            instead of motors without any acceleration.
    """
    config = CoSimConfig(order=order, timing=TIMING._replace(communication_step_s=step_s))
    n, dt_s = len(robots), config.timing.dt_s
    plant = new_plant(config, 1, end_on_collision=False)
    state, motors = new_state(n, 1, n), Motors(MotorFmu(cached_fmu()), config, n)
    for column, robot in enumerate(robots):
        sine, cosine = sine_cosine(robot.heading / 2.0)
        state.properties[:, column] = robot_properties(config)
        state.bodies[:, column] = standing_state(config.robot, robot.x, robot.y, 0.0)
        state.bodies[QUATERNION, column] = cosine, 0.0, 0.0, sine
        state.commands[column, [OMEGA_D, OMEGA_E]] = robot.speeds
        state.commands[column, MODE] = DIRECT
        state.inputs[:2, column] = robot.speeds
        motors.restart([column], ((config.motor, config.motor),))
    state.running[:] = 1
    if exchange_first:
        motors.set_inputs(state.inputs, dt_s)
        motors.get_outputs(state.outputs, dt_s)
    driver, noise = CompiledDriver(motors, 2 - n % 2), np.zeros((1, n, 2))
    samples, raw = new_samples(1, n), new_raw_samples(0, n)
    poses = np.empty((round(duration_s / PERIOD_S), n, 7))
    for pose in poses:
        driver.advance(plant, state, noise, samples, raw)
        pose[:, :3], pose[:, 3:] = state.bodies[POSITION].T, state.bodies[QUATERNION].T
    motors.close()
    return poses

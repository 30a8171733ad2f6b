"""The coupled system between two FMU steps: kernels that both drivers of the master call.

A control period is: steer every robot and set the motors' inputs; per tick, step the motors and
then the bodies with the forces at the end of the tick; sample. The drivers differ only in how they
reach the FMUs, so that their signals are the same bits.
"""

import math
from typing import NamedTuple

import numpy as np

from cosim.body import STATE_SIZE, BodyParams, step_body
from cosim.forces import MotorMount, motor_wrench
from cosim.jit import kernel
from cosim.params import SteeringParams
from cosim.rotation import heading
from cosim.steering import COMMAND_SIZE, HEADING_ERROR, MODE, steer

MOTORS = 2  # D, E
FEET = 3  # A, B, C
RUNNING, COLLISION, OUT_OF_BOARD = 0, 1, 2


class Plant(NamedTuple):
    """Constants of the coupled system.

    Attributes:
        body: equations of motion of every robot.
        mount_d, mount_e: motors D and E.
        steering: gains and speeds.
        diameter: robots closer than this (centres, m) collide.
        board_x, board_y: extent of the board in m, its corner at the origin.
        ticks_per_period: communication steps per control period.
    """

    body: BodyParams
    mount_d: MotorMount
    mount_e: MotorMount
    steering: SteeringParams
    diameter: float
    board_x: float
    board_y: float
    ticks_per_period: int


class State(NamedTuple):
    """Variables of the coupled system; float64 arrays for N robots.

    Attributes:
        bodies: (N, STATE_SIZE), layout in cosim.body.
        commands: (N, COMMAND_SIZE), layout in cosim.steering.
        inputs: (N, 2, 3) omega_des, omega_noise, d of motors D and E.
        outputs: (N, 2, 3) theta, omega, omega_dot.
        electrical: (N, 2, 2) V_s, i.
        normal_peak: (N, 3) largest normal impulse of each foot in this control period, N s.
        friction_peak: (N, 3) largest friction impulse, squared, N² s².
        lifted: (N,) ticks of this period in which a foot carried nothing.
    """

    bodies: np.ndarray
    commands: np.ndarray
    inputs: np.ndarray
    outputs: np.ndarray
    electrical: np.ndarray
    normal_peak: np.ndarray
    friction_peak: np.ndarray
    lifted: np.ndarray


class Samples(NamedTuple):
    """Signals sampled at the end of each of n control periods; float64, SI units.

    Attributes:
        omega, omega_des, theta, voltage, current: (n, N, 2), motors D and E.
        position: (n, N, 3) centre of mass in the world.
        quaternion: (n, N, 4) world from body, (w, x, y, z).
        velocity: (n, N, 3) in the world.
        yaw_rate: (n, N).
        normal_max, friction_max: (n, N, 3) largest forces of feet A, B, C in the period, N.
        lifted_share: (n, N) share of the period in which a foot carried nothing.
        heading_error: (n, N), rad.
        mode: (n, N) of the steering.
    """

    omega: np.ndarray
    omega_des: np.ndarray
    theta: np.ndarray
    voltage: np.ndarray
    current: np.ndarray
    position: np.ndarray
    quaternion: np.ndarray
    velocity: np.ndarray
    yaw_rate: np.ndarray
    normal_max: np.ndarray
    friction_max: np.ndarray
    lifted_share: np.ndarray
    heading_error: np.ndarray
    mode: np.ndarray


class RawSamples(NamedTuple):
    """Signals at every tick of a short burst of m ticks; float64, SI units.

    Attributes:
        omega: (m, N, 2), motors D and E.
        position: (m, N, 3) of the centre of mass.
        normal: (m, N, 3) normal forces of A, B, C in N.
        friction: (m, N, 6) friction forces, x and y in the body frame of A, B, C in N.
    """

    omega: np.ndarray
    position: np.ndarray
    normal: np.ndarray
    friction: np.ndarray


def new_state(robots: int) -> State:
    """Zero state of N robots."""
    n = robots
    shapes = [(STATE_SIZE,), (COMMAND_SIZE,), (MOTORS, 3), (MOTORS, 3), (MOTORS, 2), (FEET,)]
    return State(*(np.zeros((n, *shape)) for shape in [*shapes, (FEET,), ()]))


def new_samples(periods: int, robots: int) -> Samples:
    """Room for the samples of `periods` control periods."""
    motors, feet = (MOTORS,), (FEET,)
    shapes = [motors] * 5 + [(3,), (4,), (3,), (), feet, feet, (), (), ()]
    return Samples(*(np.zeros((periods, robots, *shape)) for shape in shapes))


def new_raw_samples(ticks: int, robots: int) -> RawSamples:
    """Room for a burst of `ticks` ticks."""
    shapes = [(MOTORS,), (3,), (FEET,), (2 * FEET,)]
    return RawSamples(*(np.zeros((ticks, robots, *shape)) for shape in shapes))


@kernel
def begin_period(plant: Plant, state: State, noise: np.ndarray) -> None:
    """Steer every robot and put the motors' inputs in place.

    Args:
        plant: constants.
        state: variables; commands and inputs change.
        noise: (N, 2) speed measurement noise of this period, rad/s.
    """
    for robot in range(state.bodies.shape[0]):
        body = state.bodies[robot]
        angle = heading((body[3], body[4], body[5], body[6]))
        omega_d, omega_e = steer(state.commands[robot], body[0], body[1], angle, plant.steering)
        inputs = state.inputs[robot]
        inputs[0, 0], inputs[1, 0] = omega_d, omega_e
        inputs[0, 1], inputs[1, 1] = noise[robot, 0], noise[robot, 1]
        state.normal_peak[robot] = 0.0
        state.friction_peak[robot] = 0.0
        state.lifted[robot] = 0.0


@kernel
def step_bodies(plant: Plant, state: State) -> None:
    """Move every robot by one tick with the forces of its motors at the end of the tick."""
    for robot in range(state.bodies.shape[0]):
        body, out = state.bodies[robot], state.outputs[robot]
        d = motor_wrench(plant.mount_d, out[0, 0], out[0, 1], out[0, 2])
        e = motor_wrench(plant.mount_e, out[1, 0], out[1, 1], out[1, 2])
        force = (d[0] + e[0], 0.0, d[1] + e[1])
        step_body(body, plant.body, force, (d[2] + e[2], d[3] + e[3], d[4] + e[4]))
        lifted = 0.0
        for foot in range(FEET):
            normal = body[13 + foot]
            qx, qy, qz = body[16 + 3 * foot], body[17 + 3 * foot], body[18 + 3 * foot]
            friction = qx * qx + qy * qy + qz * qz
            state.normal_peak[robot, foot] = max(state.normal_peak[robot, foot], normal)
            state.friction_peak[robot, foot] = max(state.friction_peak[robot, foot], friction)
            if normal == 0.0:
                lifted = 1.0
        state.lifted[robot] += lifted


@kernel
def sample_tick(plant: Plant, state: State, raw: RawSamples, row: int) -> None:
    """Write one tick of a burst."""
    for robot in range(state.bodies.shape[0]):
        body = state.bodies[robot]
        raw.position[row, robot] = body[0:3]
        for motor in range(MOTORS):
            raw.omega[row, robot, motor] = state.outputs[robot, motor, 1]
        for foot in range(FEET):
            raw.normal[row, robot, foot] = body[13 + foot] / plant.body.dt
            for axis in range(2):
                impulse = body[16 + 3 * foot + axis]
                raw.friction[row, robot, 2 * foot + axis] = impulse / plant.body.dt


@kernel
def end_period(plant: Plant, state: State, samples: Samples, row: int) -> int:
    """Sample the end of a control period; returns RUNNING, COLLISION or OUT_OF_BOARD."""
    robots = state.bodies.shape[0]
    event = RUNNING
    dt = plant.body.dt
    for robot in range(robots):
        body = state.bodies[robot]
        for motor in range(MOTORS):
            samples.theta[row, robot, motor] = state.outputs[robot, motor, 0]
            samples.omega[row, robot, motor] = state.outputs[robot, motor, 1]
            samples.omega_des[row, robot, motor] = state.inputs[robot, motor, 0]
            samples.voltage[row, robot, motor] = state.electrical[robot, motor, 0]
            samples.current[row, robot, motor] = state.electrical[robot, motor, 1]
        samples.position[row, robot] = body[0:3]
        samples.quaternion[row, robot] = body[3:7]
        samples.velocity[row, robot] = body[7:10]
        samples.yaw_rate[row, robot] = body[12]
        for foot in range(FEET):
            samples.normal_max[row, robot, foot] = state.normal_peak[robot, foot] / dt
            samples.friction_max[row, robot, foot] = (
                math.sqrt(state.friction_peak[robot, foot]) / dt
            )
        samples.lifted_share[row, robot] = state.lifted[robot] / plant.ticks_per_period
        samples.heading_error[row, robot] = state.commands[robot, HEADING_ERROR]
        samples.mode[row, robot] = state.commands[robot, MODE]
        if not (0.0 <= body[0] <= plant.board_x and 0.0 <= body[1] <= plant.board_y):
            event = OUT_OF_BOARD
    for robot in range(robots):
        for other in range(robot):
            dx = state.bodies[robot, 0] - state.bodies[other, 0]
            dy = state.bodies[robot, 1] - state.bodies[other, 1]
            if dx * dx + dy * dy <= plant.diameter * plant.diameter:
                event = COLLISION
    return event

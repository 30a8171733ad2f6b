"""The coupled system between two FMU steps: kernels that both drivers of the master call.

A control period is: steer every robot and set the motors' inputs; per tick, step the motors and
then the bodies with the forces at the end of the tick; sample. The drivers differ only in how they
reach the FMUs, so that their signals are the same bits.
"""

import math
from typing import NamedTuple

import numpy as np

from cosim.base.jit import inlined
from cosim.base.outcome import COLLISION, OUT_OF_BOARD, RUNNING
from cosim.base.params import SteeringParams
from cosim.coupling.signals import FEET, MOTORS, RawSamples, Samples, State
from cosim.coupling.steering import HEADING_ERROR, MODE, steer
from cosim.physics.body import BodyParams, step_body
from cosim.physics.collision import PairParams, find_near_pairs, push_apart
from cosim.physics.forces import MotorMount, motor_wrench
from cosim.physics.obstacle import touches_obstacle
from cosim.physics.rotation import heading, rotation_matrix, to_body
from cosim.physics.trig import sine_cosine

# Share of the squared friction limit from which a foot slides; the solver's projection rounds.
AT_LIMIT = 1.0 - 1e-9


class Plant(NamedTuple):
    """Constants of the coupled system; no arrays, whose references numba would count all the time.

    Attributes:
        body: equations of motion of every robot.
        mount_d, mount_e: motors D and E.
        steering: gains and speeds.
        pair: contact between robots.
        end_on_collision: whether a contact between robots is a COLLISION that ends the run; one
            with an obstacle always is.
        board_x, board_y: extent of the board in m, its corner at the origin.
        ticks_per_period: ticks of dt per control period.
        ticks_per_step: ticks of dt per communication step with the FMUs.
        jacobi: bodies see the motors' outputs of the start of a step (extrapolated), not of its
            end (interpolated).
        reaction: whether the motors feel the acceleration of the body.
        exchange_tolerance: bound on the error of interpolated motor angles in rad, for drivers
            that choose the communication step.
    """

    body: BodyParams
    mount_d: MotorMount
    mount_e: MotorMount
    steering: SteeringParams
    pair: PairParams
    end_on_collision: bool
    board_x: float
    board_y: float
    ticks_per_period: int
    ticks_per_step: int
    jacobi: bool
    reaction: bool
    exchange_tolerance: float


@inlined
def begin_period(plant: Plant, state: State, noise: np.ndarray) -> None:
    """Steer every robot and put the motors' inputs in place.

    Args:
        plant: constants.
        state: variables; commands and inputs change.
        noise: (N, 2) speed measurement noise of this period, rad/s.
    """
    period_s = plant.ticks_per_period * plant.body.dt
    for robot in range(state.bodies.shape[0]):
        body = state.bodies[robot]
        angle = heading((body[3], body[4], body[5], body[6]))
        omega_d, omega_e = steer(
            state.commands[robot], body[0], body[1], angle, period_s, plant.steering
        )
        inputs = state.inputs[robot]
        inputs[0, 0], inputs[1, 0] = omega_d, omega_e
        inputs[0, 1], inputs[1, 1] = noise[robot, 0], noise[robot, 1]
        for foot in range(FEET):
            state.normal_peak[robot, foot] = 0.0
            state.friction_peak[robot, foot] = 0.0
            state.slipping[robot, foot] = 0.0
        state.lifted[robot] = 0.0
        state.touching[robot] = 0.0
    state.near_count[0] = find_near_pairs(state.bodies, plant.pair, state.near)


@inlined
def begin_step(plant: Plant, state: State) -> None:
    """Keep what both sides know at the start of a communication step, if it will be needed."""
    # Element by element, here and below: numba takes longer to compile one slice assignment than
    # all of this module.
    for robot in range(state.bodies.shape[0]):
        if plant.jacobi or plant.ticks_per_step > 1:
            for motor in range(MOTORS):
                for k in range(3):
                    state.held[robot, motor, k] = state.outputs[robot, motor, k]
        if plant.reaction:
            for k in range(6):
                state.held_velocities[robot, k] = state.bodies[robot, 7 + k]


@inlined
def exchanged(
    plant: Plant, state: State, robot: int, motor: int, tick: int
) -> tuple[float, float, float]:
    """Output (θ, ω, ω̇) of a motor as the body sees it at the end of a tick of the step."""
    outputs, held = state.outputs, state.held
    if plant.jacobi:
        tau = (tick + 1) * plant.body.dt
        omega_0, omega_dot_0 = held[robot, motor, 1], held[robot, motor, 2]
        omega = omega_0 + omega_dot_0 * tau
        return held[robot, motor, 0] + 0.5 * (omega_0 + omega) * tau, omega, omega_dot_0
    theta = outputs[robot, motor, 0]
    omega = outputs[robot, motor, 1]
    omega_dot = outputs[robot, motor, 2]
    if plant.ticks_per_step == 1:
        return theta, omega, omega_dot
    share = (tick + 1) / plant.ticks_per_step
    return (
        held[robot, motor, 0] + share * (theta - held[robot, motor, 0]),
        held[robot, motor, 1] + share * (omega - held[robot, motor, 1]),
        held[robot, motor, 2] + share * (omega_dot - held[robot, motor, 2]),
    )


@inlined
def step_robot(plant: Plant, state: State, robot: int, tick: int) -> None:
    """Move one robot by one tick with the forces of its motors at the end of the tick.

    Args:
        plant: constants.
        state: variables; the robot's body moves.
        robot: index.
        tick: of the communication step, from 0.
    """
    body = state.bodies[robot]
    theta_d, omega_d, omega_dot_d = exchanged(plant, state, robot, 0, tick)
    theta_e, omega_e, omega_dot_e = exchanged(plant, state, robot, 1, tick)
    d = motor_wrench(plant.mount_d, theta_d, omega_d, omega_dot_d)
    e = motor_wrench(plant.mount_e, theta_e, omega_e, omega_dot_e)
    force = (d[0] + e[0], 0.0, d[1] + e[1])
    step_body(body, plant.body, force, (d[2] + e[2], d[3] + e[3], d[4] + e[4]))
    lifted = 0.0
    for foot in range(FEET):
        normal = body[13 + foot]
        qx, qy, qz = body[16 + 3 * foot], body[17 + 3 * foot], body[18 + 3 * foot]
        friction = qx * qx + qy * qy + qz * qz
        state.normal_peak[robot, foot] = max(state.normal_peak[robot, foot], normal)
        state.friction_peak[robot, foot] = max(state.friction_peak[robot, foot], friction)
        limit = plant.body.contact.mu * normal
        if normal == 0.0:
            lifted = 1.0
        elif friction >= AT_LIMIT * limit * limit:
            state.slipping[robot, foot] += 1.0
    state.lifted[robot] += lifted


@inlined
def push_pairs(plant: Plant, state: State) -> None:
    """Apply the contact impulses between robots at the end of a tick."""
    for k in range(state.near_count[0]):
        i, j = state.near[k, 0], state.near[k, 1]
        if push_apart(state.bodies[i], state.bodies[j], plant.pair, plant.body) > 0.0:
            state.touching[i] += 1.0
            state.touching[j] += 1.0


@inlined
def react(plant: Plant, state: State) -> None:
    """Put the torque that the body's acceleration exerts on each eccentric mass into input d.

    With the mass at r (−sin φ sin θ, −cos θ) from the shaft, the torque −m a · ∂position/∂θ of the
    acceleration a of the motor's mount, averaged over the communication step. Eq. (13) has only
    the weight's, which is the same with a = (0, 0, g).
    """
    rate = 1.0 / (plant.ticks_per_step * plant.body.dt)
    for robot in range(state.bodies.shape[0]):
        body, held = state.bodies[robot], state.held_velocities[robot]
        matrix = rotation_matrix((body[3], body[4], body[5], body[6]))
        ax, _, az = to_body(
            matrix,
            ((body[7] - held[0]) * rate, (body[8] - held[1]) * rate, (body[9] - held[2]) * rate),
        )
        wx, wy, wz = body[10] - held[3], body[11] - held[4], body[12] - held[5]
        for motor in range(MOTORS):
            mount = plant.mount_d if motor == 0 else plant.mount_e
            s, c = sine_cosine(state.outputs[robot, motor, 0])
            mount_x = ax + rate * (wy * mount.z - wz * mount.y)
            mount_z = az + rate * wx * mount.y
            torque = mount.m * mount.r * (mount.sin_phi * c * mount_x - s * mount_z)
            state.inputs[robot, motor, 2] = torque


@inlined
def sample_tick(plant: Plant, state: State, raw: RawSamples, row: int) -> None:
    """Write one tick of a burst."""
    for robot in range(state.bodies.shape[0]):
        body = state.bodies[robot]
        for axis in range(3):
            raw.position[row, robot, axis] = body[axis]
        for motor in range(MOTORS):
            raw.theta[row, robot, motor] = state.outputs[robot, motor, 0]
            raw.omega[row, robot, motor] = state.outputs[robot, motor, 1]
        for foot in range(FEET):
            raw.normal[row, robot, foot] = body[13 + foot] / plant.body.dt
            for axis in range(2):
                impulse = body[16 + 3 * foot + axis]
                raw.friction[row, robot, 2 * foot + axis] = impulse / plant.body.dt


@inlined
def end_period(plant: Plant, state: State, samples: Samples, row: int) -> int:
    """Sample the end of a control period.

    Board and obstacles are looked at here: robots move by some micrometres within a period.

    Args:
        plant: constants.
        state: variables; every robot's event is written.
        samples: written at `row`.
        row: of the period.

    Returns:
        RUNNING, COLLISION or OUT_OF_BOARD, that of the robots' events that outranks the others.
    """
    robots = state.bodies.shape[0]
    event = RUNNING
    dt = plant.body.dt
    radius = 0.5 * plant.pair.diameter
    for robot in range(robots):
        body = state.bodies[robot]
        for motor in range(MOTORS):
            samples.theta[row, robot, motor] = state.outputs[robot, motor, 0]
            samples.omega[row, robot, motor] = state.outputs[robot, motor, 1]
            samples.omega_des[row, robot, motor] = state.inputs[robot, motor, 0]
            samples.disturbance[row, robot, motor] = state.inputs[robot, motor, 2]
            samples.voltage[row, robot, motor] = state.electrical[robot, motor, 0]
            samples.current[row, robot, motor] = state.electrical[robot, motor, 1]
        for axis in range(3):
            samples.position[row, robot, axis] = body[axis]
            samples.velocity[row, robot, axis] = body[7 + axis]
        for k in range(4):
            samples.quaternion[row, robot, k] = body[3 + k]
        samples.yaw_rate[row, robot] = body[12]
        for foot in range(FEET):
            samples.normal_max[row, robot, foot] = state.normal_peak[robot, foot] / dt
            samples.friction_max[row, robot, foot] = (
                math.sqrt(state.friction_peak[robot, foot]) / dt
            )
            samples.slipping_share[row, robot, foot] = (
                state.slipping[robot, foot] / plant.ticks_per_period
            )
        samples.lifted_share[row, robot] = state.lifted[robot] / plant.ticks_per_period
        samples.heading_error[row, robot] = state.commands[robot, HEADING_ERROR]
        samples.mode[row, robot] = state.commands[robot, MODE]
        samples.touching_share[row, robot] = state.touching[robot] / plant.ticks_per_period
        if not (0.0 <= body[0] <= plant.board_x and 0.0 <= body[1] <= plant.board_y):
            state.events[robot] = OUT_OF_BOARD
        elif touches_obstacle(body[0], body[1], radius * radius, state.obstacles) or (
            plant.end_on_collision and state.touching[robot] > 0.0
        ):
            state.events[robot] = COLLISION
        else:
            state.events[robot] = RUNNING
        event = max(event, state.events[robot])
    return event

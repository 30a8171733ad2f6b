"""The coupled system between two FMU steps: kernels that both drivers of the master call.

A control period is: steer every robot and set the motors' inputs (`cosim.coupling.period`); per
tick, step the motors and then the bodies with the forces at the end of the tick; sample. What
happens every tick happens to the robots in the lanes of a vector at once, whichever episodes they
belong to; the rest robot by robot.
"""

from typing import NamedTuple

import numpy as np

from cosim.base.jit import inlined
from cosim.coupling.signals import (
    AIRBORNE,
    FRICTION,
    IMPACT,
    LANDING,
    LIFTED,
    MOTORS,
    NORMAL,
    SLIPPING,
    State,
)
from cosim.model.params import EstimatorParams, ShieldParams, SteeringParams
from cosim.physics.body import at_axis, stepped
from cosim.physics.body_state import (
    V_X,
    V_Y,
    V_Z,
    W_X,
    W_Y,
    W_Z,
    orientation_of,
    read_body,
    write_body,
)
from cosim.physics.collision import PairParams, push_apart, push_off
from cosim.physics.contact import Impulse
from cosim.physics.forces import MotorMount, motor_wrench
from cosim.physics.lanes import Width, any_lane, load, select, store, width_of
from cosim.physics.properties import BodyParams, feet_of, read_mount, read_params
from cosim.physics.rotation import Vector, dot, rotation_matrix, to_body
from cosim.physics.trig import sine_cosine

# Share of the squared friction limit from which a foot slides; the solver's projection rounds.
AT_LIMIT = 1.0 - 1e-9
_ONE = width_of(1)
_LARGEST = float(np.finfo(np.float64).max)


class Plant(NamedTuple):
    """Constants of the coupled system; no arrays, because numba would count their references."""

    robots: int  # of an episode
    # equations of motion; what differs from robot to robot is in `State.properties`
    body: BodyParams
    # mount_d, mount_e: motors D and E, likewise
    mount_d: MotorMount
    mount_e: MotorMount
    steering: SteeringParams  # gains and speeds
    estimator: EstimatorParams  # of every robot
    shield: ShieldParams  # distances that the shield keeps
    shielded: bool  # whether the shield is enabled
    pair: PairParams  # contact of robots with each other and with obstacles
    # whether such a contact, or a robot's centre where it is forbidden, is a COLLISION that ends
    # the run
    end_on_collision: bool
    ticks_per_period: int  # ticks of dt per control period
    ticks_per_step: int  # ticks of dt per communication step with the FMUs
    reaction: bool  # whether the motors feel the acceleration of the body
    portable: bool  # whether angles have the same bits on every machine, see `cosim.physics.trig`
    open_loop: bool  # whether the motors' input is a voltage instead of a set point
    # volts_per_speed, friction_volts: that voltage, see `cosim.model.params.open_loop_voltage`
    volts_per_speed: float
    friction_volts: float


@inlined
def begin_step(plant: Plant, state: State) -> None:
    """Keep the values of both sides at the start of a communication step, if needed later."""
    # Element by element, here and below: numba takes longer to compile one slice assignment than
    # all of this module.
    rows, columns = state.held.shape
    if plant.ticks_per_step > 1:
        for row in range(rows):
            for column in range(columns):
                state.held[row, column] = state.outputs[row, column]
    if plant.reaction:
        for row in range(rows):
            for column in range(columns):
                state.held_velocities[row, column] = state.bodies[V_X + row, column]


@inlined
def exchanged(
    plant: Plant, state: State, motor: int, column: int, tick: int, width: Width
) -> tuple[float, float, float]:
    """Output (θ, ω, ω̇) of motors as the bodies see it at the end of a tick of the step.

    The motors are D (0) or E (1) of the robots from `column` on; ticks count from 0.
    """
    theta, omega, omega_dot = _signals(state.outputs, motor, column, width)
    if plant.ticks_per_step == 1:
        return theta, omega, omega_dot
    theta_0, omega_0, omega_dot_0 = _signals(state.held, motor, column, width)
    share = (tick + 1) / plant.ticks_per_step
    return (
        theta_0 + share * (theta - theta_0),
        omega_0 + share * (omega - omega_0),
        omega_dot_0 + share * (omega_dot - omega_dot_0),
    )


@inlined
def _signals(array: np.ndarray, motor: int, column: int, width: Width) -> Vector:
    return (
        load(array, motor, column, width),
        load(array, MOTORS + motor, column, width),
        load(array, 2 * MOTORS + motor, column, width),
    )


@inlined
def step_robots(plant: Plant, state: State, column: int, tick: int, width: Width) -> bool:
    """Move the robots of a vector by one tick with the forces of their motors at its end.

    Returns whether all of them have a finite place and velocity.
    """
    theta_d, omega_d, omega_dot_d = exchanged(plant, state, 0, column, tick, width)
    theta_e, omega_e, omega_dot_e = exchanged(plant, state, 1, column, tick, width)
    params = read_params(state.properties, column, width, plant.body, feet_of(plant.body))
    mount_d = read_mount(state.properties, 0, column, width, plant.mount_d)
    mount_e = read_mount(state.properties, 1, column, width, plant.mount_e)
    d = motor_wrench(mount_d, theta_d, omega_d, omega_dot_d)
    e = motor_wrench(mount_e, theta_e, omega_e, omega_dot_e)
    force = (d[0] + e[0], 0.0, d[1] + e[1])
    moment = (d[2] + e[2], d[3] + e[3], d[4] + e[4])
    before = read_body(state.bodies, column, width)
    body = stepped(before, params, force, moment)
    write_body(state.bodies, column, width, body)
    statistics, mu = state.statistics, params.contact.mu
    lifted_a = _watch_foot(statistics, 0, column, width, before.at_a, body.at_a, mu[0])
    lifted_b = _watch_foot(statistics, 1, column, width, before.at_b, body.at_b, mu[1])
    lifted_c = _watch_foot(statistics, 2, column, width, before.at_c, body.at_c, mu[2])
    lifted = lifted_a + lifted_b + lifted_c
    _count(statistics, LIFTED, column, width, lifted > 0.0)
    _count(statistics, AIRBORNE, column, width, lifted > 2.0)
    (x, y, z), (vx, vy, vz), (wx, wy, wz) = body.position, body.velocity, body.omega
    sum_of_all = x + y + z + vx + vy + vz + wx + wy + wz
    return not any_lane(select(abs(sum_of_all) <= _LARGEST, 0.0, 1.0) > 0.0)


@inlined
def _watch_foot(
    statistics: np.ndarray,
    foot: int,
    column: int,
    width: Width,
    before: Impulse,
    impulse: Impulse,
    mu: float,
) -> float:
    """Note a foot's impulses, of the last tick and of this one; 1.0 if it carries nothing."""
    normal, friction = impulse[0], dot(impulse[1], impulse[1])
    _add(statistics, NORMAL + foot, column, width, normal)
    _add(statistics, FRICTION + 2 * foot, column, width, impulse[1][0])
    _add(statistics, FRICTION + 2 * foot + 1, column, width, impulse[1][1])
    limit = mu * normal
    carries = normal > 0.0
    lands = select(carries & (before[0] <= 0.0), 1.0, 0.0)
    stops = load(statistics, LANDING + foot, column, width)
    _add(statistics, IMPACT + foot, column, width, select(lands + stops > 0.0, normal, 0.0))
    store(statistics, LANDING + foot, column, width, lands)
    slides = carries & (friction >= AT_LIMIT * limit * limit)
    _count(statistics, SLIPPING + foot, column, width, slides)
    return select(carries, 0.0, 1.0)


@inlined
def _add(statistics: np.ndarray, row: int, column: int, width: Width, value: float) -> None:
    total = load(statistics, row, column, width)
    store(statistics, row, column, width, total + value)


@inlined
def _count(statistics: np.ndarray, row: int, column: int, width: Width, holds: bool) -> None:
    _add(statistics, row, column, width, select(holds, 1.0, 0.0))


@inlined
def push_bodies(plant: Plant, state: State) -> None:
    """Apply the contact impulses of robots and obstacles at the end of a tick."""
    inverse_dt = plant.body.inverse_dt
    for k in range(state.near_count[0]):
        i, j = state.near[k, 0], state.near[k, 1]
        if push_apart(state.bodies, state.properties, i, j, plant.pair, inverse_dt) > 0.0:
            state.touched[i] = state.touched[j] = 1
    for k in range(state.near_count[1]):
        i, j = state.near_walls[k, 0], state.near_walls[k, 1]
        wall = state.obstacles[i // plant.robots, j]
        if push_off(state.bodies, state.properties, i, wall, plant.pair, inverse_dt) > 0.0:
            state.touched[i] = 1
    for k in range(state.near_count[0]):
        _count_contact(state, state.near[k, 0])
        _count_contact(state, state.near[k, 1])
    for k in range(state.near_count[1]):
        _count_contact(state, state.near_walls[k, 0])


@inlined
def _count_contact(state: State, column: int) -> None:
    """Count this tick, once however much the robot touches in it."""
    state.touching[column] += state.touched[column]
    state.touched[column] = 0


@inlined
def react(plant: Plant, state: State) -> None:
    """Put the torque that the body's acceleration exerts on each eccentric mass into input d.

    With the mass at r (−sin φ sin θ, −cos θ) from the shaft, the torque −m a · ∂position/∂θ of the
    acceleration a of the motor's mount, averaged over the communication step. Eq. (13) has only
    the weight's, which is the same with a = (0, 0, g).
    """
    rate = 1.0 / (plant.ticks_per_step * plant.body.dt)
    for column in range(state.bodies.shape[1]):
        body, held = state.bodies[:, column], state.held_velocities[:, column]
        matrix = rotation_matrix(orientation_of(body))
        change = (
            (body[V_X] - held[0]) * rate,
            (body[V_Y] - held[1]) * rate,
            (body[V_Z] - held[2]) * rate,
        )
        wx, wy, wz = body[W_X] - held[3], body[W_Y] - held[4], body[W_Z] - held[5]
        params = read_params(state.properties, column, _ONE, plant.body, feet_of(plant.body))
        turn = (rate * wx, rate * wy, rate * wz)
        ax, _, az = at_axis(to_body(matrix, change), turn, params)
        for motor in range(MOTORS):
            common = plant.mount_d if motor == 0 else plant.mount_e
            mount = read_mount(state.properties, motor, column, _ONE, common)
            s, c = sine_cosine(state.outputs[motor, column])
            mount_x = ax + rate * (wy * mount.z - wz * mount.y)
            mount_z = az + rate * wx * mount.y
            torque = mount.m * mount.r * (mount.sin_phi * c * mount_x - s * mount_z)
            state.inputs[2 * MOTORS + motor, column] = torque

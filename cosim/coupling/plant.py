"""The coupled system between two FMU steps: kernels that both drivers of the master call.

A control period is: steer every robot and set the motors' inputs (`cosim.coupling.period`); per
tick, step the motors and then the bodies with the forces at the end of the tick; sample. What
happens every tick happens to the robots in the lanes of a vector at once, whichever episodes they
belong to; the rest robot by robot.
"""

import math
from typing import NamedTuple

import numpy as np

from cosim.base.jit import inlined, unrolled
from cosim.coupling.signals import (
    AIRBORNE,
    FOOT,
    FRICTION_X,
    FRICTION_Y,
    IMPACT,
    LANDING,
    LIFTED,
    NORMAL,
    SLIPPING,
    UNSOLVED,
    Contacts,
    State,
)
from cosim.model.params import EstimatorParams, ShieldParams, SteeringParams
from cosim.physics.body import stepped
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
from cosim.physics.feet import Impulse, Pairing
from cosim.physics.forces import MotorMount, motor_wrenches, reaction_torque
from cosim.physics.inertia import BodyParams, at_axis
from cosim.physics.lanes import Width, any_lane, floor, load, select, store, width_of
from cosim.physics.properties import read_mounts, read_params
from cosim.physics.rotation import Vector, dot, plus, rotation_matrix, to_body

# Share of the squared friction limit from which a foot slides; the solver's projection rounds.
AT_LIMIT = 1.0 - 1e-9
_ONE = width_of(1)
_LARGEST = float(np.finfo(np.float64).max)


class Plant(NamedTuple):
    """Constants of the coupled system; no arrays, because numba would count their references."""

    robots: int  # of an episode
    # equations of motion; what differs from robot to robot is in `Bodies.properties`
    body: BodyParams
    motors: Pairing
    # of the motors in the order of their pairing, likewise; z from the floor
    mounts: tuple[MotorMount, ...]
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
    open_loop: bool  # whether the motors' input is a voltage instead of a set point
    # Of each motor, that voltage: V per rad/s, and V, see `cosim.model.params.open_loop_voltage`
    voltages: tuple[tuple[float, float], ...]


@inlined
def begin_step(plant: Plant, state: State) -> None:
    """Keep the values of both sides at the start of a communication step, if needed later."""
    # Element by element, here and below: numba takes longer to compile one slice assignment than
    # all of this module.
    motors, bodies, columns = state.motors, state.bodies, state.motors.held.shape[1]
    if plant.ticks_per_step > 1:
        for row in range(motors.held.shape[0]):
            for column in range(columns):
                motors.held[row, column] = motors.outputs[row, column]
    if plant.reaction:
        for row in range(bodies.held_velocities.shape[0]):
            for column in range(columns):
                bodies.held_velocities[row, column] = bodies.motion[V_X + row, column]


@unrolled
def _outputs(
    order: tuple[int, ...],
    outputs: np.ndarray,
    held: np.ndarray,
    column: int,
    share: float,
    step_s: float,
    width: Width,
) -> tuple[Vector, ...]:
    """Output (θ, ω, ω̇) of motors in an order, as the bodies of a vector see it in a step.

    An angle that the FMU wraps, at whatever multiple of 2π, is unwrapped by the speed.

    Args:
        outputs, held: (3 · motors, B) at the end of the communication step and at its start.
        share: of the step that is over; negative where nothing is held, because it is all over.
        step_s: the step.
    """
    if len(order) == 0:
        return ()
    output = _output(outputs, order[0], column, width)
    if share >= 0.0:
        start = _output(held, order[0], column, width)
        turned, faster, change = plus(output, -1.0, start)
        beyond = turned - 0.5 * step_s * (start[1] + output[1])
        turned = turned - 2.0 * math.pi * floor(beyond * (0.5 / math.pi) + 0.5)
        output = plus(start, share, (turned, faster, change))
    return (output, *_outputs(order[1:], outputs, held, column, share, step_s, width))


@inlined
def _output(array: np.ndarray, motor: int, column: int, width: Width) -> Vector:
    motors = array.shape[0] // 3
    return (
        load(array, motor, column, width),
        load(array, motors + motor, column, width),
        load(array, 2 * motors + motor, column, width),
    )


@inlined
def step_robots(plant: Plant, state: State, column: int, tick: int, width: Width) -> bool:
    """Move the robots of a vector by one tick with the forces of their motors at its end.

    Args:
        tick: of the communication step, from 0.

    Returns whether all of them have a finite place and velocity.
    """
    order, steps, bodies = plant.motors.order, plant.ticks_per_step, state.bodies
    share = (tick + 1) / steps if steps > 1 else -1.0
    outputs, held = state.motors.outputs, state.motors.held
    signals = _outputs(order, outputs, held, column, share, steps * plant.body.dt, width)
    mounts = read_mounts(bodies.properties, order, column, width, plant.mounts)
    force, moment = motor_wrenches(plant.motors.pairs, mounts, signals)
    params = read_params(bodies.properties, column, width, plant.body)
    order = plant.body.feet.pairing.order
    before = read_body(bodies.motion, column, width, order, plant.body.contact.legs)
    body, unsolved = stepped(before, params, force, moment)
    write_body(bodies.motion, column, width, order, body)
    statistics = bodies.statistics
    lifted = _watch_feet(
        statistics, order, column, width, before.impulses, body.impulses, params.feet.mu
    )
    _count(statistics, LIFTED, column, width, lifted > 0.0)
    _count(statistics, AIRBORNE, column, width, lifted > len(order) - 0.5)
    _count(statistics, UNSOLVED, column, width, unsolved)
    (x, y, z), (vx, vy, vz), (wx, wy, wz) = body.position, body.velocity, body.omega
    sum_of_all = x + y + z + vx + vy + vz + wx + wy + wz
    return not any_lane(select(abs(sum_of_all) <= _LARGEST, 0.0, 1.0) > 0.0)


@unrolled
def _watch_feet(
    statistics: np.ndarray,
    order: tuple[int, ...],
    column: int,
    width: Width,
    before: tuple[Impulse, ...],
    impulses: tuple[Impulse, ...],
    mu: tuple[float, ...],
) -> float:
    """Note the impulses of feet, of the last tick and of this one; how many carry nothing."""
    if len(order) == 0:
        return 0.0
    lifted = _watch_foot(statistics, order[0], column, width, before[0], impulses[0], mu[0])
    return lifted + _watch_feet(
        statistics, order[1:], column, width, before[1:], impulses[1:], mu[1:]
    )


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
    normal, friction, row = impulse[0], dot(impulse[1], impulse[1]), FOOT * foot
    _add(statistics, row + NORMAL, column, width, normal)
    _add(statistics, row + FRICTION_X, column, width, impulse[1][0])
    _add(statistics, row + FRICTION_Y, column, width, impulse[1][1])
    limit = mu * normal
    carries = normal > 0.0
    lands = select(carries & (before[0] <= 0.0), 1.0, 0.0)
    stops = load(statistics, row + LANDING, column, width)
    _add(statistics, row + IMPACT, column, width, select(lands + stops > 0.0, normal, 0.0))
    store(statistics, row + LANDING, column, width, lands)
    slides = carries & (friction >= AT_LIMIT * limit * limit)
    _count(statistics, row + SLIPPING, column, width, slides)
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
    inverse_dt, contacts = plant.body.inverse_dt, state.contacts
    motion, properties = state.bodies.motion, state.bodies.properties
    for k in range(contacts.counts[0]):
        i, j = contacts.pairs[k, 0], contacts.pairs[k, 1]
        if push_apart(motion, properties, i, j, plant.pair, inverse_dt) > 0.0:
            contacts.touched[i] = contacts.touched[j] = 1
    for k in range(contacts.counts[1]):
        i, j = contacts.walls[k, 0], contacts.walls[k, 1]
        wall = state.floor.obstacles[i // plant.robots, j]
        if push_off(motion, properties, i, wall, plant.pair, inverse_dt) > 0.0:
            contacts.touched[i] = 1
    for k in range(contacts.counts[0]):
        _count_contact(contacts, contacts.pairs[k, 0])
        _count_contact(contacts, contacts.pairs[k, 1])
    for k in range(contacts.counts[1]):
        _count_contact(contacts, contacts.walls[k, 0])


@inlined
def _count_contact(contacts: Contacts, column: int) -> None:
    """Count this tick, once however much the robot touches in it."""
    contacts.touching[column] += contacts.touched[column]
    contacts.touched[column] = 0


@inlined
def react(plant: Plant, state: State) -> None:
    """Put the torque that the body's acceleration exerts on each eccentric mass into input d.

    The torque −m a · ∂position/∂θ of the acceleration a of the motor's mount, averaged over the
    communication step. Eq. (13) has only the weight's, which is the same with a = (0, 0, g).
    """
    rate = 1.0 / (plant.ticks_per_step * plant.body.dt)
    motors, bodies = state.motors, state.bodies
    for column in range(bodies.motion.shape[1]):
        body, held = bodies.motion[:, column], bodies.held_velocities[:, column]
        matrix = rotation_matrix(orientation_of(body))
        change = (
            (body[V_X] - held[0]) * rate,
            (body[V_Y] - held[1]) * rate,
            (body[V_Z] - held[2]) * rate,
        )
        wx, wy, wz = body[W_X] - held[3], body[W_Y] - held[4], body[W_Z] - held[5]
        params = read_params(bodies.properties, column, _ONE, plant.body)
        spin = (wx, wy, wz)
        turn = (rate * wx, rate * wy, rate * wz)
        along = at_axis(to_body(matrix, change), turn, params)
        order = plant.motors.order
        mounts = read_mounts(bodies.properties, order, column, _ONE, plant.mounts)
        for k in range(len(order)):
            angle = motors.outputs[order[k], column]
            torque = reaction_torque(mounts[k], angle, along, spin, rate)
            motors.inputs[2 * len(order) + order[k], column] = torque

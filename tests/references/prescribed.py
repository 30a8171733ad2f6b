"""One robot whose motors turn at prescribed, constant speeds: the mechanics without any FMU.

For what the friction drive alone does: calibration, convergence, comparison with other engines,
tests. The motors' own dynamics and control live in the FMU, the coupled system in
cosim.coupling.plant.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from cosim.base.jit import inlined, kernel
from cosim.model.params import MotorParams, RobotParams, motors_of
from cosim.physics.body import stepped
from cosim.physics.body_state import (
    NORMALS,
    V_X,
    W_X,
    read_body,
    standing_state,
    state_size,
    write_body,
)
from cosim.physics.contact.rigid import CONTACT_TOLERANCE
from cosim.physics.forces import MotorMount, motor_mounts, motor_wrench
from cosim.physics.inertia import BodyParams
from cosim.physics.lanes import width_of
from cosim.physics.properties import body_params
from cosim.physics.rotation import Vector, cross, dot, plus, rotation_matrix, to_body, to_centre

_ONE = width_of(1)
# Of a state with three feet.
STATE_SIZE = state_size(3)
NORMAL_IMPULSE, FRICTION_IMPULSE = slice(NORMALS, NORMALS + 3), slice(NORMALS + 3, STATE_SIZE)


class Drive(NamedTuple):
    """Constant speeds of motors D and E in rad/s, and their angles in rad at t = 0."""

    omega_d: float
    omega_e: float
    theta_d: float = 0.0
    theta_e: float = 0.0


class Rig(NamedTuple):
    """Constants of a robot's equations of motion, and of its motors D and E."""

    body: BodyParams
    mounts: tuple[MotorMount, MotorMount]


class MeanMotion(NamedTuple):
    """Time averages of a motion."""

    # Velocity of the centre of mass along the robot's heading and to the left of it
    forward_m_s: float
    lateral_m_s: float
    yaw_rate_rad_s: float  # counter-clockwise positive
    least_normal_n: float  # of any foot
    airborne_share: float  # of the time


def rig(
    robot: RobotParams, motor: MotorParams, dt_s: float, *, tolerance: float = CONTACT_TOLERANCE
) -> Rig:
    """Constants of a robot with its motors D and E; arguments as of `body_params`."""
    mount_d, mount_e = motor_mounts(robot, (motor, motor))
    return Rig(body_params(robot, motor, dt_s, tolerance=tolerance), (mount_d, mount_e))


@kernel
def drive_wrench(rig: Rig, drive: Drive, tick: int) -> tuple[Vector, Vector]:
    """Force in N and moment in N m of both motors at time tick·dt, body frame, centre of mass."""
    t = tick * rig.body.dt
    d, e = rig.mounts
    f, m = motor_wrench(d, drive.theta_d + drive.omega_d * t, drive.omega_d, 0.0)
    g, n = motor_wrench(e, drive.theta_e + drive.omega_e * t, drive.omega_e, 0.0)
    return plus(f, 1.0, g), plus(m, 1.0, n)


@inlined
def step_body(state: np.ndarray, params: BodyParams, force: Vector, moment: Vector) -> bool:
    """Advance one robot by dt, in place, and return whether its contacts were not solved.

    Arguments are those of `cosim.physics.body.stepped`.
    """
    bodies, order = state.reshape(state.size, 1), params.feet.pairing.order
    before = read_body(bodies, 0, _ONE, order, params.contact.legs)
    after, unsolved = stepped(before, params, force, moment)
    write_body(bodies, 0, _ONE, order, after)
    return unsolved


@kernel
def coast(state: np.ndarray, body: BodyParams, ticks: int) -> None:
    """Advance a robot without motors by some ticks, in place, see `cosim.physics.body_state`."""
    for _ in range(ticks):
        step_body(state, body, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))


@kernel
def push(state: np.ndarray, params: BodyParams, wrenches: np.ndarray, tally: np.ndarray) -> None:
    """Advance a robot, in place, by a tick for each wrench, and add up what forces do.

    Args:
        wrenches: (T, 6) force in N and moment about its axis at the height of its centre of mass in
            N m, body frame.
        tally: (5,) work in J of the wrenches, of normal forces and of friction, the largest work of
            both in one tick, and the number of ticks with unsolved contacts; added to.
    """
    (pairing, feet, z, _), (off_x, off_y), count = params.feet, params.centre, len(params.feet.mu)
    for tick in range(len(wrenches)):
        w = wrenches[tick]
        force, moment = (w[0], w[1], w[2]), (w[3], w[4], w[5])
        axes = rotation_matrix((state[3], state[4], state[5], state[6]))
        before = to_body(axes, (state[V_X], state[V_X + 1], state[V_X + 2]))
        spin = state[W_X], state[W_X + 1], state[W_X + 2]
        if step_body(state, params, force, moment):
            tally[4] += 1
        # Work is impulse times mean velocity, in the frame of the body before the step.
        after = to_body(axes, (state[V_X], state[V_X + 1], state[V_X + 2]))
        turned = state[W_X], state[W_X + 1], state[W_X + 2]
        v = plus((0.0, 0.0, 0.0), 0.5, plus(before, 1.0, after))
        o = plus((0.0, 0.0, 0.0), 0.5, plus(spin, 1.0, turned))
        at_axis = plus(v, -1.0, cross(o, (off_x, off_y, 0.0)))
        tally[0] += params.dt * (dot(force, at_axis) + dot(moment, o))
        pressed = rubbed = 0.0
        for k in range(count):
            foot, (x, y) = pairing.order[k], feet[k]
            of_foot = plus(v, 1.0, cross(o, (x - off_x, y - off_y, z)))
            first = NORMALS + count + 3 * foot
            pressed += state[NORMALS + foot] * dot(axes[2], of_foot)
            rubbed += dot((state[first], state[first + 1], state[first + 2]), of_foot)
        tally[1] += pressed
        tally[2] += rubbed
        tally[3] = max(tally[3], pressed + rubbed)


def turning(
    robot: RobotParams,
    motor: MotorParams,
    drive: Sequence[tuple[float, float]],
    ticks: int,
    dt_s: float,
) -> np.ndarray:
    """Wrenches (ticks, 6) of motors at constant speeds, for `push`; body frame.

    Args:
        drive: speed of each motor in rad/s, and its angle at t = 0 in rad.
    """
    found, time_s = np.zeros((ticks, 6)), dt_s * np.arange(1, ticks + 1)
    mounts = motor_mounts(robot, motors_of(robot, motor))
    for mount, (omega, theta) in zip(mounts, drive, strict=True):
        down, ahead, up = (
            np.concatenate(motor_wrench(mount, quarter * math.pi / 2.0, omega, 0.0))
            for quarter in range(3)
        )
        mean, angles = 0.5 * (down + up), theta + omega * time_s
        found += (
            mean + np.outer(np.cos(angles), down - mean) + np.outer(np.sin(angles), ahead - mean)
        )
    return found


def solved_out(params: BodyParams) -> BodyParams:
    """Constants of a body whose contacts are iterated until their tolerance is met."""
    return params._replace(contact=params.contact._replace(max_sweeps=20_000))


@kernel
def energy(state: np.ndarray, params: BodyParams) -> float:
    """Kinetic and potential energy in J."""
    i, matrix = params.inertia, rotation_matrix((state[3], state[4], state[5], state[6]))
    x = plus((state[0], state[1], state[2]), 1.0, to_centre(matrix, params.centre))
    v = state[V_X], state[V_X + 1], state[V_X + 2]
    w = state[W_X], state[W_X + 1], state[W_X + 2]
    spin = dot((i[0] * w[0], i[1] * w[1], i[2] * w[2]), w) + 2.0 * params.product * w[0] * w[1]
    return (0.5 * dot(v, v) - dot(params.gravity, x)) / params.inverse_mass + 0.5 * spin


@kernel
def audit(state: np.ndarray, params: BodyParams, ticks: int) -> tuple[float, float, float, float]:
    """Coast, and return the energy gained over all steps in J, and extremes of all feet.

    These are the excess over the cone of friction, the least normal impulse, and the depth in m.
    """
    gained, excess, least, deepest = 0.0, 0.0, 0.0, 0.0
    feet, count = params.feet, len(params.feet.mu)
    before = energy(state, params)
    for _ in range(ticks):
        step_body(state, params, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
        after = energy(state, params)
        gained += max(0.0, after - before)
        before = after
        normal = rotation_matrix((state[3], state[4], state[5], state[6]))[2]
        for x, y in feet.places:
            deepest = max(deepest, -state[2] - dot(normal, (x, y, feet.z)))
        for foot in range(count):
            first, pressed = NORMALS + count + 3 * foot, state[NORMALS + foot]
            q = state[first], state[first + 1], state[first + 2]
            limit = feet.mu[foot] * pressed * (1.0 + 1e-15)
            excess = max(excess, math.sqrt(dot(q, q)) - limit)
            least = min(least, pressed)
    return gained, excess, least, deepest


@kernel
def drive_body(
    state: np.ndarray, rig: Rig, drive: Drive, first_tick: int, ticks: int, means: np.ndarray
) -> None:
    """Advance a robot by some ticks, in place, with the forces at the end of every tick.

    Args:
        state: shape (25,), layout in `cosim.physics.body_state`.
        first_tick: ticks done before; time is an integer, so that no rounding accumulates.
        ticks: to do, at least 1.
        means: shape (5,), the fields of `MeanMotion`, overwritten.
    """
    forward, lateral, turned, airborne = 0.0, 0.0, 0.0, 0
    least = math.inf
    for tick in range(first_tick + 1, first_tick + ticks + 1):
        force, moment = drive_wrench(rig, drive, tick)
        step_body(state, rig.body, force, moment)
        axes = rotation_matrix((state[3], state[4], state[5], state[6]))
        cosine, sine = axes[0][0], axes[1][0]
        length = math.sqrt(cosine * cosine + sine * sine)
        forward += (cosine * state[7] + sine * state[8]) / length
        lateral += (cosine * state[8] - sine * state[7]) / length
        # Rate of the heading of a body whose axis is almost vertical.
        turned += axes[2][0] * state[10] + axes[2][1] * state[11] + axes[2][2] * state[12]
        least = min(least, state[13], state[14], state[15])
        if state[13] == 0.0 and state[14] == 0.0 and state[15] == 0.0:
            airborne += 1
    means[0] = forward / ticks
    means[1] = lateral / ticks
    means[2] = turned / ticks
    means[3] = least / rig.body.dt
    means[4] = airborne / ticks


@kernel
def trace_body(state: np.ndarray, rig: Rig, drive: Drive, every: int, trace: np.ndarray) -> None:
    """Drive from t = 0 and write the state every `every` ticks into the rows of trace."""
    tick = 0
    for row in range(trace.shape[0]):
        for _ in range(every):
            tick += 1
            force, moment = drive_wrench(rig, drive, tick)
            step_body(state, rig.body, force, moment)
        trace[row] = state


def mean_motion(
    robot: RobotParams,
    motor: MotorParams,
    drive: Drive,
    *,
    dt_s: float,
    settle_s: float = 0.5,
    duration_s: float = 2.0,
    tolerance: float = CONTACT_TOLERANCE,
) -> MeanMotion:
    """Mean velocity and yaw rate of a robot that starts at rest with its motors at full speed.

    The averages begin after `settle_s`, over whole turns of the faster motor: within a turn the
    robot moves back and forth by more than it gains.
    """
    constants = rig(robot, motor, dt_s, tolerance=tolerance)
    state = standing_state(robot, 0.0, 0.0, 0.0)
    means = np.empty(len(MeanMotion._fields))
    turn_s = 2.0 * math.pi / max(abs(drive.omega_d), abs(drive.omega_e))
    settle = round(settle_s / dt_s)
    duration = round(max(1, round(duration_s / turn_s)) * turn_s / dt_s)
    if settle:
        drive_body(state, constants, drive, 0, settle, means)
    drive_body(state, constants, drive, settle, duration, means)
    return MeanMotion(*means.tolist())

"""Robots that differ in everything, with prescribed motor speeds: many parameter sets at once.

The equations of motion are those of `cosim.physics`; every robot has a lane of a vector, and in it
a mass, feet and motors of its own. Motors turn as prescribed, so that no FMU is stepped: they do
not feel the bodies.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from cosim.base.jit import inlined, kernel
from cosim.model.params import TABLE_II, MotorParams, RobotParams
from cosim.physics.body import stepped
from cosim.physics.body_state import (
    STATE_SIZE,
    X,
    Y,
    orientation_of,
    read_body,
    standing_state,
    write_body,
)
from cosim.physics.contact import ContactParams
from cosim.physics.forces import MotorMount, motor_mounts, motor_wrench
from cosim.physics.lanes import Width, host_lanes, load, width_of
from cosim.physics.properties import (
    CENTRE,
    PROPERTIES,
    BodyParams,
    body_params,
    properties_of,
    read_mount,
    read_params,
)
from cosim.physics.rotation import heading, rotation_matrix

# Rows of the shapes, in m: feet A (x, y, z) and B (x), motor D (y, z); the others are mirrored.
_A, _B, _D = 0, 3, 4
_SHAPE = 6


class Machine(NamedTuple):
    """A robot and its motors D and E."""

    robot: RobotParams
    motor_d: MotorParams = TABLE_II
    motor_e: MotorParams = TABLE_II


def tracks(
    machines: Sequence[Machine], omega: np.ndarray, ticks: int, dt_s: float, every: int
) -> np.ndarray:
    """Simulate what an overhead camera sees of robots that start at rest, heading along +x.

    Args:
        machines: B of them.
        omega: (P + 1, 2) or (P + 1, 2, B) speeds of motors D and E at the ends of control periods
            in rad/s, linear in between; motors start hanging down.
        ticks: steps of a control period.
        dt_s: step in s.
        every: control periods from one look to the next.

    Returns:
        (P // every + 1, B, 3) x and y of the robot's axis in m, and the heading in rad, continuous.
    """
    lanes = host_lanes()
    columns = -(-len(machines) // lanes) * lanes
    padded = [*machines, *[machines[0]] * (columns - len(machines))]
    own = np.zeros((len(omega), 2, columns))
    own[:, :, : len(machines)] = omega.reshape(*omega.shape[:2], -1)
    own[:, :, len(machines) :] = own[:, :, :1]
    bodies, properties = np.zeros((STATE_SIZE, columns)), np.zeros((PROPERTIES, columns))
    shapes = np.zeros((_SHAPE, columns))
    for column, (robot, motor_d, motor_e) in enumerate(padded):
        mounts = motor_mounts(robot, motor_d)[0], motor_mounts(robot, motor_e)[1]
        params = body_params(robot, motor_d, dt_s)
        properties[:, column] = properties_of(params, *mounts)
        shapes[:, column] = *params.contact.a, params.contact.b[0], mounts[0].y, mounts[0].z
        bodies[:, column] = standing_state(robot, *params.centre, 0.0)
    seen = np.zeros((1 + (len(omega) - 1) // every, columns, 3))
    common = body_params(machines[0].robot, machines[0].motor_d, dt_s)
    mount = motor_mounts(machines[0].robot, machines[0].motor_d)[0]
    _drive(bodies, properties, shapes, common, mount, own, ticks, seen, every, width_of(lanes))
    seen = seen[:, : len(machines)]
    seen[..., 2] = np.unwrap(seen[..., 2], axis=0)
    return seen


@kernel
def _drive(
    bodies: np.ndarray,
    properties: np.ndarray,
    shapes: np.ndarray,
    body: BodyParams,
    mount: MotorMount,
    omega: np.ndarray,
    ticks: int,
    seen: np.ndarray,
    every: int,
    width: Width,
) -> None:
    """Advance all robots; the arguments of `tracks`, as arrays.

    Args:
        bodies: (STATE_SIZE, B), layout in `cosim.physics.body_state`; change.
        properties: (PROPERTIES, B), layout in `cosim.physics.properties`.
        shapes: (_SHAPE, B), layout above.
        body, mount: what all robots and motors share.
        omega: (P + 1, 2, B).
        ticks: steps of a control period.
        seen: (P // every + 1, B, 3), overwritten from the second row on.
        every: control periods.
        width: of the vectors.
    """
    dt = body.dt
    share = 1.0 / ticks
    for first in range(0, bodies.shape[1], len(width)):
        common = _shaped(body, shapes, first, width)
        params = read_params(properties, first, width, common)
        y, z = load(shapes, _D, first, width), load(shapes, _D + 1, first, width)
        at_d = MotorMount(mount.m, mount.r, mount.J, mount.g, y, z, 1.0)
        at_e = MotorMount(mount.m, mount.r, mount.J, mount.g, -y, z, -1.0)
        mount_d = read_mount(properties, 0, first, width, at_d)
        mount_e = read_mount(properties, 1, first, width, at_e)
        omega_d, omega_e = load(omega[0], 0, first, width), load(omega[0], 1, first, width)
        theta_d, theta_e = 0.0 * omega_d, 0.0 * omega_e
        for period in range(omega.shape[0] - 1):
            end_d = load(omega[period + 1], 0, first, width)
            end_e = load(omega[period + 1], 1, first, width)
            change_d, change_e = share * (end_d - omega_d), share * (end_e - omega_e)
            dot_d, dot_e = body.inverse_dt * change_d, body.inverse_dt * change_e
            for _ in range(ticks):
                omega_d, omega_e = omega_d + change_d, omega_e + change_e
                theta_d += dt * (omega_d - 0.5 * change_d)
                theta_e += dt * (omega_e - 0.5 * change_e)
                d = motor_wrench(mount_d, theta_d, omega_d, dot_d)
                e = motor_wrench(mount_e, theta_e, omega_e, dot_e)
                force = (d[0] + e[0], 0.0, d[1] + e[1])
                moment = (d[2] + e[2], d[3] + e[3], d[4] + e[4])
                after = stepped(read_body(bodies, first, width), params, force, moment)
                write_body(bodies, first, width, after)
            omega_d, omega_e = end_d, end_e
            if (period + 1) % every == 0:
                for column in range(first, first + len(width)):
                    _look(bodies, properties, column, seen[(period + 1) // every])


@inlined
def _shaped(body: BodyParams, shapes: np.ndarray, column: int, width: Width) -> BodyParams:
    """Return the plant that robots share, with feet of their own."""
    x, y = load(shapes, _A, column, width), load(shapes, _A + 1, column, width)
    z, behind = load(shapes, _A + 2, column, width), load(shapes, _B, column, width)
    feet = body.contact
    return BodyParams(
        body.inverse_mass,
        body.inertia,
        body.inverse_inertia,
        body.product,
        body.inverse_product,
        body.centre,
        body.off_axis,
        body.gravity,
        body.restitution,
        body.bounces,
        body.dt,
        body.inverse_dt,
        ContactParams(
            (x, y, z),
            (behind, 0.0 * y, z),
            (x, -y, z),
            feet.mu,
            feet.step_normal,
            feet.step_tangential,
            feet.spin_inertia,
            feet.tolerance,
            feet.max_sweeps,
        ),
    )


@inlined
def _look(bodies: np.ndarray, properties: np.ndarray, column: int, seen: np.ndarray) -> None:
    body = bodies[:, column]
    q = orientation_of(body)
    axes = rotation_matrix(q)
    x, y = properties[CENTRE, column], properties[CENTRE + 1, column]
    seen[column, 0] = body[X] - (axes[0][0] * x + axes[0][1] * y)
    seen[column, 1] = body[Y] - (axes[1][0] * x + axes[1][1] * y)
    seen[column, 2] = heading(q)

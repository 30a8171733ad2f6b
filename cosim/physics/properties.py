"""Constants of a robot's equations of motion, as numbers and as a column of an array.

Robots of one batch may live in different worlds: everything that a world changes has a row here.
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from cosim.base.jit import by_class, inlined, kernel, unrolled
from cosim.model.params import MotorParams, RobotParams
from cosim.model.world import IDEAL, World
from cosim.physics.body_state import X, Y, orientation_of, read_vector
from cosim.physics.contact import elastic, rigid
from cosim.physics.contact.elastic import elastic_contact
from cosim.physics.contact.rigid import CONTACT_TOLERANCE, rigid_contact
from cosim.physics.feet import OWN_MU, Feet, feet_of
from cosim.physics.forces import MotorMount
from cosim.physics.inertia import BodyParams
from cosim.physics.lanes import Width, any_lane, load
from cosim.physics.mass import mass_of
from cosim.physics.rotation import Vector, dot, rotation_matrix
from cosim.physics.trig import sine_cosine

# Rows of the properties, in SI units; of vectors the first one. Names are those of `BodyParams`,
# `MotorMount` and of the parameters of a law of contact.
INVERSE_MASS = 0
INERTIA, INVERSE_INERTIA = 1, 4
PRODUCT, INVERSE_PRODUCT = 7, 8
CENTRE = 9
GRAVITY = 11
RESTITUTION = 14
LAW = 15  # of the law of contact, five
FEET_Z = 20
MU = 21  # now under each of M feet
# After them: these where no patch is, then r and J of each motor.

_read_contact: Any = by_class({rigid.Rigid: rigid.read, elastic.Elastic: elastic.read})


def properties_size(feet: int, motors: int) -> int:
    """Number of rows."""
    return MU + 2 * feet + 2 * motors


def body_params(
    robot: RobotParams,
    motor: MotorParams,
    dt_s: float,
    *,
    gravity: Vector | None = None,
    tolerance: float = CONTACT_TOLERANCE,
    world: World = IDEAL,
) -> BodyParams:
    """Constants of a robot.

    Args:
        gravity: in the world frame, m/s²; default g straight down.
        tolerance: contact sweeps end when impulses change by less than this share of weight·dt;
            elastic feet need none.
    """
    mass = mass_of(robot, world)
    feet = feet_of(robot)
    if robot.elastic:
        contact = elastic_contact(robot, feet.pairing.order, mass, dt_s)
    else:
        contact = rigid_contact(robot, tolerance * mass.total * motor.g * dt_s, mass)
    return BodyParams(
        inverse_mass=1.0 / mass.total,
        inertia=mass.inertia,
        inverse_inertia=mass.inverse_inertia,
        product=mass.product,
        inverse_product=mass.inverse_product,
        centre=mass.centre,
        off_axis=any(mass.centre),
        gravity=gravity or (0.0, 0.0, -motor.g),
        restitution=world.restitution or 0.0,
        bounces=bool(world.restitution),
        dt=dt_s,
        inverse_dt=1.0 / dt_s,
        feet=feet,
        contact=contact,
    )


def properties_of(params: BodyParams, mounts: Sequence[MotorMount]) -> np.ndarray:
    """Column of a robot with motors, in their order, layout above."""
    feet = params.feet
    mu = np.empty(len(feet.mu))
    mu[list(feet.pairing.order)] = feet.mu
    return np.array(
        [
            params.inverse_mass,
            *(*params.inertia, *params.inverse_inertia, params.product, params.inverse_product),
            *(*params.centre, *params.gravity, params.restitution),
            *(*params.contact.rows, feet.z, *mu, *mu),
            *(value for mount in mounts for value in (mount.r, mount.J)),
        ]
    )


@kernel
def write_own(properties: np.ndarray, column: int, gravity: Vector, motors: np.ndarray) -> None:
    """Write what is a robot's own in a world: gravity in m/s², and its motors' r and J (M, 2)."""
    for axis in range(3):
        properties[GRAVITY + axis, column] = gravity[axis]
    first = properties.shape[0] - motors.size
    for motor in range(len(motors)):
        for k in range(2):
            properties[first + 2 * motor + k, column] = motors[motor, k]


@kernel
def gravity(tilt_deg: float, direction_deg: float, g: float) -> tuple[float, float, float]:
    """Return the gravitational acceleration in m/s² in the frame of a floor, z away from it.

    It falls by an angle in a direction, counter-clockwise from +x.
    """
    sine, down = sine_cosine(math.radians(tilt_deg))
    aside, ahead = sine_cosine(math.radians(direction_deg))
    along = g * sine
    return along * ahead, along * aside, -g * down


@inlined
def read_params(
    properties: np.ndarray, column: int, width: Width, common: BodyParams
) -> BodyParams:
    """Constants of the robots from a column of properties on, one for every lane.

    Args:
        common: has the time step, places of feet and the bound of sweeps.
    """
    x, y = load(properties, CENTRE, column, width), load(properties, CENTRE + 1, column, width)
    restitution = load(properties, RESTITUTION, column, width)
    pairing, places, _, _ = common.feet
    return BodyParams(
        load(properties, INVERSE_MASS, column, width),
        read_vector(properties, INERTIA, column, width),
        read_vector(properties, INVERSE_INERTIA, column, width),
        load(properties, PRODUCT, column, width),
        load(properties, INVERSE_PRODUCT, column, width),
        (x, y),
        any_lane(abs(x) + abs(y) > 0.0),
        read_vector(properties, GRAVITY, column, width),
        restitution,
        any_lane(restitution > 0.0),
        common.dt,
        common.inverse_dt,
        Feet(
            pairing,
            places,
            load(properties, FEET_Z, column, width),
            _read_rows(properties, MU, column, width, pairing.order),
        ),
        _read_contact(common.contact, properties, LAW, column, width),
    )


@unrolled
def _read_rows(
    rows: np.ndarray, first: int, column: int, width: Width, order: tuple[int, ...]
) -> tuple[float, ...]:
    """Values of rows from one on, in an order, one for every lane."""
    if len(order) == 0:
        return ()
    value = load(rows, first + order[0], column, width)
    return (value, *_read_rows(rows, first, column, width, order[1:]))


@inlined
def read_mounts(
    properties: np.ndarray,
    order: tuple[int, ...],
    column: int,
    width: Width,
    common: tuple[MotorMount, ...],
) -> tuple[MotorMount, ...]:
    """Motors, in an order, of the robots from a column on, with their own r, J and z.

    Args:
        common: with z from the floor.
    """
    first = properties.shape[0] - 2 * len(order)
    z = load(properties, FEET_Z, column, width)
    return _read_mounts(properties, first, order, column, width, common, z)


@unrolled
def _read_mounts(
    properties: np.ndarray,
    first: int,
    order: tuple[int, ...],
    column: int,
    width: Width,
    common: tuple[MotorMount, ...],
    feet_z: float,
) -> tuple[MotorMount, ...]:
    if len(order) == 0:
        return ()
    row, mount = first + 2 * order[0], common[0]
    r, inertia = load(properties, row, column, width), load(properties, row + 1, column, width)
    m, _, _, g, weight, x, y, height, axis, hanging, ahead, across = mount
    z = height + feet_z
    own = MotorMount(m, r, inertia, g, weight, x, y, z, axis, hanging, ahead, across)
    return (own, *_read_mounts(properties, first, order[1:], column, width, common[1:], feet_z))


@inlined
def feel_patches(
    properties: np.ndarray, bodies: np.ndarray, column: int, patches: np.ndarray, common: BodyParams
) -> None:
    """Put the friction coefficients that are under a robot's feet among its properties.

    Args:
        patches: (P, 5) left, bottom, right, top in m, and mu or OWN_MU; later ones cover
            earlier ones.
    """
    axes = rotation_matrix(orientation_of(bodies[:, column]))
    (pairing, feet, _, _), z = common.feet, properties[FEET_Z, column]
    for k in range(len(feet)):
        x, y = feet[k]
        arm = (x, y, z)
        at_x, at_y = bodies[X, column] + dot(axes[0], arm), bodies[Y, column] + dot(axes[1], arm)
        row = MU + pairing.order[k]
        own = mu = properties[row + len(feet), column]
        for p in range(len(patches)):
            if patches[p, 0] <= at_x < patches[p, 2] and patches[p, 1] <= at_y < patches[p, 3]:
                mu = own if patches[p, 4] == OWN_MU else patches[p, 4]
        properties[row, column] = mu

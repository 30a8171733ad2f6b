"""One rigid robot on the floor: Newton–Euler equations (Eq. 2) with three contacts.

Semi-implicit Euler with step dt: velocities first (applied wrench, gyroscopic moment by the
implicit midpoint rule, contact impulses), then the pose with the new velocities. The centre of
mass moves in the world frame and the angular velocity is kept in the body frame, so that a free
body keeps its momenta to rounding. The caller owns time and forces.
"""

import math
from typing import NamedTuple

from cosim.base.jit import inlined
from cosim.base.params import MotorParams, RobotParams, cylinder_inertia
from cosim.physics.body_state import Body
from cosim.physics.contact import (
    CONTACT_TOLERANCE,
    ContactParams,
    Impulse,
    allowed_approach,
    contact_params,
    gradient_step,
)
from cosim.physics.lanes import any_lane, select
from cosim.physics.rotation import (
    Vector,
    cross,
    dot,
    plus,
    rotated,
    rotation_matrix,
    to_body,
    to_world,
)


class BodyParams(NamedTuple):
    """Constants of one robot's equations of motion; SI units, body frame.

    Attributes:
        inverse_mass: 1/kg.
        inertia, inverse_inertia: principal moments in kg m² and their inverses.
        gravity: in the world frame, m/s².
        dt, inverse_dt: step in s and its inverse.
        contact: contact solver parameters.
    """

    inverse_mass: float
    inertia: Vector
    inverse_inertia: Vector
    gravity: Vector
    dt: float
    inverse_dt: float
    contact: ContactParams


def body_params(
    robot: RobotParams,
    motor: MotorParams,
    dt_s: float,
    *,
    gravity: Vector | None = None,
    tolerance: float = CONTACT_TOLERANCE,
) -> BodyParams:
    """Constants of a robot.

    Args:
        robot: Table I and the assumed geometry.
        motor: for g, and for the tolerance through the weight.
        dt_s: step in s.
        gravity: in the world frame, m/s²; default g straight down.
        tolerance: contact sweeps end when impulses change by less than this share of weight·dt.
    """
    i_xx, i_yy, i_zz = cylinder_inertia(robot)
    return BodyParams(
        inverse_mass=1.0 / robot.mass_kg,
        inertia=(i_xx, i_yy, i_zz),
        inverse_inertia=(1.0 / i_xx, 1.0 / i_yy, 1.0 / i_zz),
        gravity=gravity or (0.0, 0.0, -motor.g),
        dt=dt_s,
        inverse_dt=1.0 / dt_s,
        contact=contact_params(robot, tolerance * robot.mass_kg * motor.g * dt_s),
    )


@inlined
def spun(omega: Vector, params: BodyParams) -> Vector:
    """Angular velocity after dt without any moment: I ω̇ + ω × I ω = 0 of Eq. (2), body frame.

    Implicit midpoint rule; two fixed-point iterations leave an error of (|ω| dt)³, which is below
    rounding for any speed a robot reaches.
    """
    inertia, inverse, dt = params.inertia, params.inverse_inertia, params.dt
    middle = omega
    after = omega
    for _ in range(2):
        spin = (inertia[0] * middle[0], inertia[1] * middle[1], inertia[2] * middle[2])
        # Eq. (2), left side
        rate = cross(spin, middle)
        after = (
            omega[0] + dt * inverse[0] * rate[0],
            omega[1] + dt * inverse[1] * rate[1],
            omega[2] + dt * inverse[2] * rate[2],
        )
        middle = (
            0.5 * (omega[0] + after[0]),
            0.5 * (omega[1] + after[1]),
            0.5 * (omega[2] + after[2]),
        )
    return after


@inlined
def with_impulses(
    velocity: Vector,
    omega: Vector,
    params: BodyParams,
    normal: Vector,
    at_a: Impulse,
    at_b: Impulse,
    at_c: Impulse,
) -> tuple[Vector, Vector, Vector]:
    """Velocities (body frame) after the contact impulses, and the total impulse in N s.

    A and C are mirror images: adding them first keeps the mirror symmetry exact in rounding.
    """
    a = plus(at_a[1], at_a[0], normal)
    b = plus(at_b[1], at_b[0], normal)
    c = plus(at_c[1], at_c[0], normal)
    both = plus(a, 1.0, c)
    total = plus(both, 1.0, b)
    contact, inverse = params.contact, params.inverse_inertia
    (x, y, z), x_b = contact.a, contact.b[0]
    # Σ r × j of feet A (x, y, z), B (x_b, 0, z), C (x, −y, z)
    twist = (
        y * (a[2] - c[2]) - z * total[1],
        z * total[0] - (x * both[2] + x_b * b[2]),
        x * both[1] + x_b * b[1] - y * (a[0] - c[0]),
    )
    omega = (
        omega[0] + inverse[0] * twist[0],
        omega[1] + inverse[1] * twist[1],
        omega[2] + inverse[2] * twist[2],
    )
    return plus(velocity, params.inverse_mass, total), omega, total


@inlined
def foot_velocities(
    velocity: Vector, omega: Vector, contact: ContactParams
) -> tuple[Vector, Vector, Vector]:
    """Velocities v + ω × r of feet A, B, C in m/s, all in the body frame."""
    (x, y, z), x_b = contact.a, contact.b[0]
    along, aside = velocity[0] + omega[1] * z, velocity[1] - omega[0] * z
    across = aside + omega[2] * x
    up, swing, roll = velocity[2] - omega[1] * x, omega[2] * y, omega[0] * y
    return (
        (along - swing, across, up + roll),
        (along, aside + omega[2] * x_b, velocity[2] - omega[1] * x_b),
        (along + swing, across, up - roll),
    )


@inlined
def _where(condition: bool, yes: Impulse, no: Impulse) -> Impulse:
    return select(condition, yes[0], no[0]), (
        select(condition, yes[1][0], no[1][0]),
        select(condition, yes[1][1], no[1][1]),
        select(condition, yes[1][2], no[1][2]),
    )


@inlined
def stepped(body: Body, params: BodyParams, force: Vector, moment: Vector) -> Body:
    """The body after dt (Eq. 2).

    Args:
        body: before.
        params: constants of the robot.
        force: applied force without gravity and contacts, body frame, N.
        moment: applied moment about the centre of mass, body frame, N m.
    """
    dt, contact = params.dt, params.contact
    world_from_body = rotation_matrix(body.orientation)

    # Eq. (2): M v̇ = R Σ f, before contacts and seen from the body.
    free_velocity = plus(
        to_body(world_from_body, plus(body.velocity, dt, params.gravity)),
        dt * params.inverse_mass,
        force,
    )
    spun_omega = spun(body.omega, params)
    inverse = params.inverse_inertia
    free_omega = (
        spun_omega[0] + dt * inverse[0] * moment[0],
        spun_omega[1] + dt * inverse[1] * moment[1],
        spun_omega[2] + dt * inverse[2] * moment[2],
    )
    # What a free body turns by: the mean of before and after, which with the Cayley map of
    # `rotated` keeps the angular momentum. Moments and impulses act before the turn.
    half_spin = plus(body.omega, -1.0, spun_omega)

    normal, height = world_from_body[2], body.position[2]
    least_a = allowed_approach(height + dot(normal, contact.a), params.inverse_dt)
    least_b = allowed_approach(height + dot(normal, contact.b), params.inverse_dt)
    least_c = allowed_approach(height + dot(normal, contact.c), params.inverse_dt)
    at_a, at_b, at_c = body.at_a, body.at_b, body.at_c
    v, omega, total = with_impulses(free_velocity, free_omega, params, normal, at_a, at_b, at_c)
    change = select(height < math.inf, math.inf, 0.0)
    for _ in range(contact.max_sweeps):
        # A lane whose sweeps have ended keeps what it has, to the bit, and so changes no more.
        going_on = change >= contact.tolerance
        if not any_lane(going_on):
            break
        u_a, u_b, u_c = foot_velocities(v, omega, contact)
        a = gradient_step(at_a, u_a, normal, least_a, contact)
        b = gradient_step(at_b, u_b, normal, least_b, contact)
        c = gradient_step(at_c, u_c, normal, least_c, contact)
        a, b, c = _where(going_on, a, at_a), _where(going_on, b, at_b), _where(going_on, c, at_c)
        before, spin = total, omega[2]
        v, omega, total = with_impulses(free_velocity, free_omega, params, normal, a, b, c)
        change = abs(a[0] - at_a[0]) + abs(c[0] - at_c[0]) + abs(b[0] - at_b[0])
        change += abs(total[0] - before[0]) + abs(total[1] - before[1])
        change += contact.spin_inertia * abs(omega[2] - spin)
        at_a, at_b, at_c = a, b, c

    velocity = plus(body.velocity, dt, params.gravity)
    velocity = plus(
        velocity, params.inverse_mass, to_world(world_from_body, plus(total, dt, force))
    )
    turning = plus(omega, 0.5, half_spin)
    return Body(
        plus(body.position, dt, velocity),
        rotated(body.orientation, (dt * turning[0], dt * turning[1], dt * turning[2])),
        velocity,
        omega,
        at_a,
        at_b,
        at_c,
    )

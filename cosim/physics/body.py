"""One rigid robot on the floor: Newton–Euler equations (Eq. 2) with three contacts.

Semi-implicit Euler with step dt: velocities first (applied wrench, gyroscopic moment by the
implicit midpoint rule, contact impulses), then the pose with the new velocities. The centre of
mass moves in the world frame and the angular velocity is kept in the body frame, so that a free
body keeps its momenta to rounding. Feet and motors have places relative to the robot's axis, which
a payload moves off the axis. The caller owns time and forces.
"""

import math

from cosim.base.jit import inlined
from cosim.physics.body_state import Body
from cosim.physics.contact import (
    ContactParams,
    Impulse,
    allowed_approach,
    gradient_step,
    impact_speed,
)
from cosim.physics.lanes import any_lane, select
from cosim.physics.properties import BodyParams
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


@inlined
def about_centre(moment: Vector, force: Vector, params: BodyParams) -> Vector:
    """Moment about the centre of mass, from that about the robot's axis at its height: − s × f."""
    x, y = params.centre
    if params.off_axis:
        moment = (
            moment[0] - y * force[2],
            moment[1] + x * force[2],
            moment[2] - (x * force[1] - y * force[0]),
        )
    return moment


@inlined
def at_axis(velocity: Vector, omega: Vector, params: BodyParams) -> Vector:
    """Velocity of the robot's axis at the height of the centre of mass, body frame: v − ω × s."""
    x, y = params.centre
    if params.off_axis:
        velocity = (
            velocity[0] + y * omega[2],
            velocity[1] - x * omega[2],
            velocity[2] - (y * omega[0] - x * omega[1]),
        )
    return velocity


@inlined
def _times(diagonal: Vector, product: float, v: Vector, params: BodyParams) -> Vector:
    """Product of a tensor, with xy as its only other element, and a vector."""
    x, y, z = diagonal[0] * v[0], diagonal[1] * v[1], diagonal[2] * v[2]
    if params.off_axis:
        x, y = x + product * v[1], y + product * v[0]
    return x, y, z


@inlined
def spun(omega: Vector, params: BodyParams) -> Vector:
    """Angular velocity after dt without any moment: I ω̇ + ω × I ω = 0 of Eq. (2), body frame.

    Implicit midpoint rule; two fixed-point iterations leave an error of (|ω| dt)³, which is below
    rounding for any speed a robot reaches.
    """
    dt = params.dt
    middle = omega
    after = omega
    for _ in range(2):
        spin = _times(params.inertia, params.product, middle, params)
        # Eq. (2), left side
        after = _turned(omega, dt, cross(spin, middle), params)
        middle = (
            0.5 * (omega[0] + after[0]),
            0.5 * (omega[1] + after[1]),
            0.5 * (omega[2] + after[2]),
        )
    return after


@inlined
def _turned(omega: Vector, dt: float, moment: Vector, params: BodyParams) -> Vector:
    """The angular velocity after a moment has acted for dt."""
    x, y, z = params.inverse_inertia
    inverse = (dt * x, dt * y, dt * z)
    return plus(omega, 1.0, _times(inverse, dt * params.inverse_product, moment, params))


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
    contact = params.contact
    (x, y, z), x_b = contact.a, contact.b[0]
    # Σ r × j of feet A (x, y, z), B (x_b, 0, z), C (x, −y, z)
    twist = (
        y * (a[2] - c[2]) - z * total[1],
        z * total[0] - (x * both[2] + x_b * b[2]),
        x * both[1] + x_b * b[1] - y * (a[0] - c[0]),
    )
    twist = about_centre(twist, total, params)
    turn = _times(params.inverse_inertia, params.inverse_product, twist, params)
    omega = plus(omega, 1.0, turn)
    return plus(velocity, params.inverse_mass, total), omega, total


@inlined
def foot_velocities(
    velocity: Vector, omega: Vector, contact: ContactParams
) -> tuple[Vector, Vector, Vector]:
    """Velocities v + ω × r of feet A, B, C in m/s, from that of the axis, all in the body frame."""
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
def _least(foot: Vector, body: Body, normal: Vector, mu: float, params: BodyParams) -> float:
    """Least normal speed of a foot after the step: any where no floor is below it."""
    if params.off_axis:
        x, y = params.centre
        foot = foot[0] - x, foot[1] - y, foot[2]
    gap = body.position[2] + dot(normal, foot)
    least = allowed_approach(gap, params.inverse_dt)
    if params.bounces:
        before = body.velocity[2] + dot(cross(normal, body.omega), foot)
        least = impact_speed(gap, before, least, params.restitution, params.inverse_dt)
    return select(mu < 0.0, -math.inf, least)


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
        force: applied force without gravity and contacts, body frame, N.
        moment: applied moment about the axis at the height of the centre of mass, body frame, N m.
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
    free_omega = _turned(spun_omega, dt, about_centre(moment, force, params), params)
    # What a free body turns by: the mean of before and after, which with the Cayley map of
    # `rotated` keeps the angular momentum. Moments and impulses act before the turn.
    half_spin = plus(body.omega, -1.0, spun_omega)

    normal = world_from_body[2]
    least_a = _least(contact.a, body, normal, contact.mu[0], params)
    least_b = _least(contact.b, body, normal, contact.mu[1], params)
    least_c = _least(contact.c, body, normal, contact.mu[2], params)
    at_a, at_b, at_c = body.at_a, body.at_b, body.at_c
    v, omega, total = with_impulses(free_velocity, free_omega, params, normal, at_a, at_b, at_c)
    change = select(body.position[2] < math.inf, math.inf, 0.0)
    for _ in range(contact.max_sweeps):
        # A lane that has ended its sweeps keeps its values, to the bit, and so changes no more.
        going_on = change >= contact.tolerance
        if not any_lane(going_on):
            break
        u_a, u_b, u_c = foot_velocities(at_axis(v, omega, params), omega, contact)
        a = gradient_step(at_a, u_a, normal, least_a, contact.mu[0], contact)
        b = gradient_step(at_b, u_b, normal, least_b, contact.mu[1], contact)
        c = gradient_step(at_c, u_c, normal, least_c, contact.mu[2], contact)
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

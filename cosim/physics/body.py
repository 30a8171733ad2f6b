"""One rigid robot on the floor: Newton–Euler equations (Eq. 2) with contacts at its feet.

Semi-implicit Euler with step dt: velocities first (applied wrench, gyroscopic moment by the
implicit midpoint rule, contact impulses), then the pose with the new velocities. The velocity is
the centre of mass's in the world frame and the angular velocity is kept in the body frame, so that
a free body keeps its momenta to rounding. The position is that of the robot's axis, to which all
geometry refers: feet, motors, the outline and what sees it. The caller owns time and forces.
"""

import math

from cosim.base.jit import inlined, unrolled
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
    Quaternion,
    Vector,
    cross,
    dot,
    plus,
    rotated,
    rotation_matrix,
    to_body,
    to_centre,
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
    impulses: tuple[Impulse, ...],
) -> tuple[Vector, Vector, Vector]:
    """Velocities (body frame) after the contact impulses, and the total impulse in N s."""
    contact = params.contact
    total, levers = _summed(contact.pairing.pairs, contact.feet, impulses, normal)
    # Σ r × j of feet (x, y, z)
    twist = (
        levers[1] - contact.z * total[1],
        contact.z * total[0] - levers[0],
        levers[2] - levers[3],
    )
    twist = about_centre(twist, total, params)
    turn = _times(params.inverse_inertia, params.inverse_product, twist, params)
    omega = plus(omega, 1.0, turn)
    return plus(velocity, params.inverse_mass, total), omega, total


@unrolled
def _summed(
    pairs: tuple[int, ...],
    feet: tuple[tuple[float, float], ...],
    impulses: tuple[Impulse, ...],
    normal: Vector,
) -> tuple[Vector, Quaternion]:
    """Sum of the impulses j of feet, in pairs and then one by one; and Σ of x jz, y jz, x jy, y jx.

    Mirror images are added first, which keeps the mirror symmetry exact in rounding.
    """
    x, y = feet[0]
    both = apart = plus(impulses[0][1], impulses[0][0], normal)
    if len(pairs) > 0:
        second = plus(impulses[1][1], impulses[1][0], normal)
        both, apart = plus(both, 1.0, second), plus(both, -1.0, second)
    levers = x * both[2], y * apart[2], x * both[1], y * apart[0]
    # A sum ends with its last foot: adding a zero would take time in every tick.
    if len(pairs) > 0:
        if len(feet) == 2:
            return both, levers
        rest, others = _summed(pairs[1:], feet[2:], impulses[2:], normal)
    else:
        if len(feet) == 1:
            return both, levers
        rest, others = _summed(pairs, feet[1:], impulses[1:], normal)
    return plus(both, 1.0, rest), (
        levers[0] + others[0],
        levers[1] + others[1],
        levers[2] + others[2],
        levers[3] + others[3],
    )


@unrolled
def _change_of_loads(
    pairs: tuple[int, ...], after: tuple[Impulse, ...], impulses: tuple[Impulse, ...]
) -> float:
    """Sum of the changes of normal impulses, in the order of `_summed`."""
    change = abs(after[0][0] - impulses[0][0])
    if len(pairs) > 0:
        change += abs(after[1][0] - impulses[1][0])
        if len(impulses) == 2:
            return change
        return change + _change_of_loads(pairs[1:], after[2:], impulses[2:])
    if len(impulses) == 1:
        return change
    return change + _change_of_loads(pairs, after[1:], impulses[1:])


@unrolled
def _least_speeds(
    feet: tuple[tuple[float, float], ...],
    mu: tuple[float, ...],
    body: Body,
    normal: Vector,
    params: BodyParams,
) -> tuple[float, ...]:
    """Least normal speed of each foot after the step: any where no floor is below it."""
    if len(feet) == 0:
        return ()
    x, y = feet[0]
    gap = body.position[2] + dot(normal, (x, y, params.contact.z))
    least = allowed_approach(gap, params.inverse_dt)
    if params.bounces:
        if params.off_axis:
            x, y = x - params.centre[0], y - params.centre[1]
        foot = x, y, params.contact.z
        before = body.velocity[2] + dot(cross(normal, body.omega), foot)
        least = impact_speed(gap, before, least, params.restitution, params.inverse_dt)
    least = select(mu[0] < 0.0, -math.inf, least)
    return (least, *_least_speeds(feet[1:], mu[1:], body, normal, params))


@unrolled
def _after_sweep(
    feet: tuple[tuple[float, float], ...],
    impulses: tuple[Impulse, ...],
    mu: tuple[float, ...],
    least: tuple[float, ...],
    velocity: Vector,
    omega: Vector,
    normal: Vector,
    contact: ContactParams,
    going_on: bool,
) -> tuple[Impulse, ...]:
    """Impulses of feet after a gradient step, where it is going on.

    Args:
        velocity: of the robot's axis at the height of the feet, body frame, m/s.
    """
    if len(feet) == 0:
        return ()
    x, y = feet[0]
    along, across, up = velocity
    of_foot = along - omega[2] * y, across + omega[2] * x, up - omega[1] * x + omega[0] * y
    after = gradient_step(impulses[0], of_foot, normal, least[0], mu[0], contact)
    kept = _where(going_on, after, impulses[0])
    rest = _after_sweep(
        feet[1:], impulses[1:], mu[1:], least[1:], velocity, omega, normal, contact, going_on
    )
    return (kept, *rest)


@inlined
def _where(condition: bool, yes: Impulse, no: Impulse) -> Impulse:
    return select(condition, yes[0], no[0]), (
        select(condition, yes[1][0], no[1][0]),
        select(condition, yes[1][1], no[1][1]),
        select(condition, yes[1][2], no[1][2]),
    )


@inlined
def stepped(body: Body, params: BodyParams, force: Vector, moment: Vector) -> tuple[Body, bool]:
    """The body after dt (Eq. 2), and whether its contacts did not converge within their sweeps.

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
    feet, mu, impulses, pairs = contact.feet, contact.mu, body.impulses, contact.pairing.pairs
    least = _least_speeds(feet, mu, body, normal, params)
    v, omega, total = with_impulses(free_velocity, free_omega, params, normal, impulses)
    change = select(body.position[2] < math.inf, math.inf, 0.0)
    for _ in range(contact.max_sweeps):
        # A lane that has ended its sweeps keeps its values, to the bit, and so changes no more.
        going_on = change >= contact.tolerance
        if not any_lane(going_on):
            break
        of_axis = at_axis(v, omega, params)
        lowest = of_axis[0] + omega[1] * contact.z, of_axis[1] - omega[0] * contact.z, of_axis[2]
        after = _after_sweep(feet, impulses, mu, least, lowest, omega, normal, contact, going_on)
        before, spin = total, omega[2]
        v, omega, total = with_impulses(free_velocity, free_omega, params, normal, after)
        change = _change_of_loads(pairs, after, impulses)
        change += abs(total[0] - before[0]) + abs(total[1] - before[1])
        change += contact.spin_inertia * abs(omega[2] - spin)
        impulses = after

    velocity = plus(body.velocity, dt, params.gravity)
    velocity = plus(
        velocity, params.inverse_mass, to_world(world_from_body, plus(total, dt, force))
    )
    turning = plus(omega, 0.5, half_spin)
    orientation = rotated(body.orientation, (dt * turning[0], dt * turning[1], dt * turning[2]))
    position = plus(body.position, dt, velocity)
    if params.off_axis:  # the axis turns about the centre of mass
        before = to_centre(world_from_body, params.centre)
        after = to_centre(rotation_matrix(orientation), params.centre)
        position = plus(position, 1.0, plus(before, -1.0, after))
    return Body(position, orientation, velocity, omega, impulses), change >= contact.tolerance

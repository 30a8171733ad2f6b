"""Rigid feet: unilateral contacts with Coulomb friction, solved as impulses per time step.

Moreau time stepping in the body frame: there the contact points, the inertia and so the Delassus
operator are constant, only the floor normal changes. Each sweep is one projected gradient step on
all contacts at once, which keeps mirror symmetry exact; impulses of the last step start the next.
First order in the time step. Tests: tests/cosim/physics/test_contact.py and test_body.py.

Loads of more than three feet of a rigid body are not defined: a compliance of the contacts spreads
them as equal springs would. It is a share of the operator, so that a machine of another mass moves
alike, and so stiff that the body rocks on it far faster than motors turn.
"""

import math
from typing import NamedTuple

import numpy as np

from cosim.base.jit import inlined, unrolled
from cosim.model.params import RobotParams
from cosim.physics.body_state import Body
from cosim.physics.feet import Impulse, Response, delassus
from cosim.physics.inertia import BodyParams, about_centre, at_axis, times
from cosim.physics.lanes import Width, any_lane, load, select
from cosim.physics.mass import Mass, mass_of
from cosim.physics.rotation import Matrix, Quaternion, Vector, cross, dot, either, plus, scaled

# Share of a penetration removed per step. Solver residuals leave some 1e-12 m; removing them at
# once would act as noise on the normal force, never removing them would let the robot sink.
GAP_CORRECTION = 0.1

# Sweeps end when impulses change by less than this share of weight·dt: in smooth sliding the warm
# start needs one sweep, after a foot lands or sticks some ten. Mean speeds stay within 0.3 % of
# converged contacts (benchmarks/convergence.py). Some landings on eight feet, or of bodies with
# very unequal moments of inertia, need hundreds.
CONTACT_TOLERANCE = 0.01
MAX_SWEEPS = 1000

# Compliance of contacts of more than three feet, see the head of this file, over the mean of the
# eigenvalues of the normal part of the Delassus operator that are not zero (three).
COMPLIANCE = 1.0 / 6.0


class Rigid(NamedTuple):
    """Step sizes of the contact solver."""

    # step_normal, step_tangential: step sizes of the projected gradient in kg
    step_normal: float
    step_tangential: float
    spin_inertia: float  # friction impulse at a foot, in N s, that changes a spin by 1 rad/s: kg m
    # sweeps end when the impulses, that of the spin included, change by less than this, N s
    tolerance: float
    compliance: float  # normal speed that a contact yields per normal impulse, 1/kg
    max_sweeps: int  # bound on the gradient steps of one time step
    legs: tuple[()] = ()

    @property
    def rows(self) -> tuple[float, ...]:
        """Values that a world changes."""
        return self[:5]


def rigid_contact(robot: RobotParams, tolerance: float, mass: Mass | None = None) -> Rigid:
    """Solver parameters of a robot; the step sizes let no sweep expand.

    Normal and tangential rows are scaled by their own largest eigenvalues, then both by the
    largest eigenvalue of the scaled whole, so that the gradient step is stable for any mass and
    geometry. The operator includes the compliance.
    """
    mass = mass or mass_of(robot)
    operator = delassus(robot, mass)
    normal = np.arange(len(operator)) % 3 == 2
    compliance = 0.0
    if len(robot.feet) > 3:
        compliance = _rounded(COMPLIANCE * np.diag(operator)[normal].sum() / 3.0)
        operator[normal, normal] += compliance
    scale = np.empty(len(operator))
    scale[normal] = np.linalg.eigvalsh(operator[np.ix_(normal, normal)])[-1]
    scale[~normal] = np.linalg.eigvalsh(operator[np.ix_(~normal, ~normal)])[-1]
    root = np.sqrt(scale)
    largest = np.linalg.eigvalsh(operator / np.outer(root, root))[-1]
    return Rigid(
        step_normal=_rounded(1.0 / (largest * scale[2])),
        step_tangential=_rounded(1.0 / (largest * scale[0])),
        spin_inertia=mass.inertia[2] / robot.foot_radius_m,
        tolerance=tolerance,
        compliance=compliance,
        max_sweeps=MAX_SWEEPS,
    )


def _rounded(value: float) -> float:
    """To 12 digits: the last ones of LAPACK differ from processor to processor."""
    return float(f"{value:.12g}")


@inlined
def read(contact: Rigid, properties: np.ndarray, row: int, column: int, width: Width) -> Rigid:
    """Parameters of the robots from a column of properties on, whose `rows` begin at a row."""
    return Rigid(
        load(properties, row, column, width),
        load(properties, row + 1, column, width),
        load(properties, row + 2, column, width),
        load(properties, row + 3, column, width),
        load(properties, row + 4, column, width),
        contact.max_sweeps,
    )


@inlined
def allowed_approach(gap: float, inverse_dt: float) -> float:
    """Least normal speed in m/s of a foot at that gap (m): it may close the gap, not pass it."""
    return select(gap > 0.0, -gap * inverse_dt, -GAP_CORRECTION * gap * inverse_dt)


@inlined
def impact_speed(
    gap: float, before: float, allowed: float, restitution: float, inverse_dt: float
) -> float:
    """Least normal speed in m/s of a foot after a step by Newton's impact law.

    Args:
        gap: at the start of the step in m.
        before: normal speed of the foot at that time; if it closes the gap within the step, the
            foot leaves with that times `restitution`.
        allowed: what `allowed_approach` returned; holds for a foot that does not land.
    """
    bounce = -restitution * before
    lands = (gap * inverse_dt + before <= 0.0) & (bounce > 0.0) & (bounce > allowed)
    return select(lands, bounce, allowed)


@inlined
def gradient_step(
    impulse: Impulse,
    velocity: Vector,
    normal: Vector,
    least_normal_speed: float,
    mu: float,
    contact: Rigid,
) -> Impulse:
    """One projected gradient step of one contact: Signorini's condition and Coulomb's cone.

    Args:
        impulse: (λ, q): normal impulse and friction impulse vector in N s, body frame.
        velocity: of the foot with these impulses applied, body frame, m/s.
        normal: unit normal of the floor in the body frame.

    Returns:
        The impulse after the step: λ ≥ 0 and |q| ≤ μ λ.
    """
    speed = dot(normal, velocity)
    friction = plus(impulse[1], -contact.step_tangential, plus(velocity, -speed, normal))
    yielding = speed + contact.compliance * impulse[0]
    pressed = impulse[0] - contact.step_normal * (yielding - least_normal_speed)
    pressed = select(pressed > 0.0, pressed, 0.0)
    limit = mu * pressed
    length_2 = dot(friction, friction)
    slides = length_2 > limit * limit
    shrink = select(slides, limit / math.sqrt(length_2), 1.0)
    return pressed, scaled(shrink, friction)


@inlined
def with_impulses(
    velocity: Vector,
    omega: Vector,
    params: BodyParams,
    normal: Vector,
    impulses: tuple[Impulse, ...],
) -> tuple[Vector, Vector, Vector]:
    """Velocities (body frame) after the contact impulses, and the total impulse in N s."""
    feet = params.feet
    total, levers = _summed(feet.pairing.pairs, feet.places, impulses, normal)
    # Σ r × j of feet (x, y, z)
    twist = (
        levers[1] - feet.z * total[1],
        feet.z * total[0] - levers[0],
        levers[2] - levers[3],
    )
    twist = about_centre(twist, total, params)
    turn = times(params.inverse_inertia, params.inverse_product, twist, params)
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
    gap = body.position[2] + dot(normal, (x, y, params.feet.z))
    least = allowed_approach(gap, params.inverse_dt)
    if params.bounces:
        if params.off_axis:
            x, y = x - params.centre[0], y - params.centre[1]
        foot = x, y, params.feet.z
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
    contact: Rigid,
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
    friction = either(going_on, after[1], impulses[0][1])
    kept = select(going_on, after[0], impulses[0][0]), friction
    rest = _after_sweep(
        feet[1:], impulses[1:], mu[1:], least[1:], velocity, omega, normal, contact, going_on
    )
    return (kept, *rest)


@inlined
def response(
    contact: Rigid,
    params: BodyParams,
    body: Body,
    world_from_body: Matrix,
    velocity: Vector,
    omega: Vector,
) -> Response:
    """What the floor does to a body in a step, see `cosim.physics.contact`."""
    free_velocity, free_omega, normal = velocity, omega, world_from_body[2]
    (pairing, feet, z, mu), impulses = params.feet, body.impulses
    least = _least_speeds(feet, mu, body, normal, params)
    v, omega, total = with_impulses(free_velocity, free_omega, params, normal, impulses)
    change = select(body.position[2] < math.inf, math.inf, 0.0)
    for _ in range(contact.max_sweeps):
        # A lane that has ended its sweeps keeps its values, to the bit, and so changes no more.
        going_on = change >= contact.tolerance
        if not any_lane(going_on):
            break
        of_axis = at_axis(v, omega, params)
        lowest = of_axis[0] + omega[1] * z, of_axis[1] - omega[0] * z, of_axis[2]
        after = _after_sweep(feet, impulses, mu, least, lowest, omega, normal, contact, going_on)
        before, spin = total, omega[2]
        v, omega, total = with_impulses(free_velocity, free_omega, params, normal, after)
        change = _change_of_loads(pairing.pairs, after, impulses)
        change += abs(total[0] - before[0]) + abs(total[1] - before[1])
        change += contact.spin_inertia * abs(omega[2] - spin)
        impulses = after
    return omega, total, impulses, body.legs, change >= contact.tolerance

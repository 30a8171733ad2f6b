"""Elastic legs that end in tips: linear beams without mass, closed form for each foot.

Beam of Euler and Bernoulli with axial and bending stiffness, Kelvin–Voigt damping (stiffness and
damping are proportional), a tip that is a point with Coulomb friction, static = kinetic. The state
of a leg is the deflection of its tip and where the tip is on the floor. A tip sticks where it is
if friction can hold it, else it slides by what brings the force back to the edge of the cone; stick
comes first, which makes the answer unique where a leg that is pushed against its lean jams. A tip
in the air relaxes, and a tip that lands is where it lands.

Explicit in the deflection, implicit in its rate, first order in the time step. Deflections are
small against the leg. A body on rigid feet is the limit of stiff legs.
Tests: tests/cosim/physics/test_elastic.py.
"""

import math
from typing import NamedTuple

import numpy as np

from cosim.base.arguments import ConfigError
from cosim.base.jit import inlined, unrolled
from cosim.model.params import Leg, RobotParams
from cosim.physics.body_state import Body
from cosim.physics.feet import Impulse, LegState, Response, delassus
from cosim.physics.inertia import BodyParams, about_centre, times
from cosim.physics.lanes import Width, select
from cosim.physics.mass import Mass
from cosim.physics.rotation import (
    Matrix,
    Vector,
    cross,
    dot,
    either,
    plus,
    scaled,
    to_body,
    to_world,
)
from cosim.physics.trig import sine_cosine


class Beam(NamedTuple):
    """Constants of a leg for a time step; τ is its relaxation time."""

    axis: Vector  # from root to tip, unit vector, body frame
    bending: float  # bending stiffness (1 + τ/dt) k_b, N/m
    stiffening: float  # what is added to it along the axis, (1 + τ/dt) (k_a − k_b)
    memory: float  # share τ/(τ + dt) of its deflection that a free leg keeps in a step


class Elastic(NamedTuple):
    """Elastic legs of a robot, in the order of its feet, where straight legs have their tips."""

    legs: tuple[Beam, ...]
    rows = (0.0,) * 5  # a world changes none of its values


def elastic_contact(robot: RobotParams, order: tuple[int, ...], mass: Mass, dt_s: float) -> Elastic:
    """Legs of a robot, in an order; a step that is too long for them raises a ConfigError."""
    _require_stable(robot, mass, dt_s)
    legs = [robot.feet[k].leg for k in order]
    return Elastic(tuple(_beam(leg, dt_s) for leg in legs if leg))


def _beam(leg: Leg, dt_s: float) -> Beam:
    damped = 1.0 + leg.relaxation_s / dt_s
    stiffening = damped * (leg.axial_n_m - leg.bending_n_m)
    memory = leg.relaxation_s / (leg.relaxation_s + dt_s)
    return Beam(axis_of(leg), damped * leg.bending_n_m, stiffening, memory)


def axis_of(leg: Leg) -> Vector:
    """Unit vector from root to tip, body frame."""
    level, down = sine_cosine(math.radians(leg.lean_deg))
    aside, ahead = sine_cosine(math.radians(leg.lean_towards_deg))
    return level * ahead, level * aside, -down


def stiffness(leg: Leg) -> np.ndarray:
    """Stiffness matrix of a leg at its tip, (3, 3), body frame, N/m."""
    along = np.outer(axis_of(leg), axis_of(leg))
    return leg.bending_n_m * np.eye(3) + (leg.axial_n_m - leg.bending_n_m) * along


def modes_rad_s(robot: RobotParams, mass: Mass) -> np.ndarray:
    """Angular frequencies of a body on its legs, tips held, (6,) or fewer, slowest first."""
    operator = delassus(robot, mass)
    for k, foot in enumerate(robot.feet):
        columns = slice(3 * k, 3 * k + 3)
        operator[:, columns] = operator[:, columns] @ stiffness(foot.leg) if foot.leg else 0.0
    squares = np.sort(np.abs(np.linalg.eigvals(operator)))
    return np.sqrt(squares[-6:])


def settling_s(robot: RobotParams, mass: Mass) -> float:
    """Time in which every oscillation of a body on its legs falls to a millionth."""
    modes = modes_rad_s(robot, mass)
    zeta = 0.5 * modes * min(foot.leg.relaxation_s for foot in robot.feet if foot.leg)
    rates = modes * (zeta - np.sqrt(np.maximum(zeta * zeta - 1.0, 0.0)))
    return math.log(1e6) / float(rates.min())


def _require_stable(robot: RobotParams, mass: Mass, dt_s: float) -> None:
    """Refuse a time step that is too long: ω dt < 2 (√(1 + ζ²) − ζ) of the fastest oscillation."""
    omega = float(modes_rad_s(robot, mass)[-1])
    zeta = 0.5 * omega * max(foot.leg.relaxation_s for foot in robot.feet if foot.leg)
    longest_s = 2.0 * (math.sqrt(1.0 + zeta * zeta) - zeta) / omega
    if dt_s >= longest_s:
        raise ConfigError(
            f"the legs are too stiff for dt_s = {dt_s:g}: the fastest oscillation of the body on "
            f"them has {omega / (2.0 * math.pi):.0f} Hz and needs a step below {longest_s:.2g} s; "
            "choose a shorter one, softer legs, less damping, or rigid feet"
        )


@inlined
def read(contact: Elastic, properties: np.ndarray, row: int, column: int, width: Width) -> Elastic:
    """Parameters of the robots from a column of properties on: those of all."""
    return contact


@inlined
def response(
    contact: Elastic,
    params: BodyParams,
    body: Body,
    world_from_body: Matrix,
    velocity: Vector,
    omega: Vector,
) -> Response:
    """What the floor does to a body in a step, see `cosim.physics.contact`."""
    _, feet, z, mu = params.feet
    impulses, legs, total, moment = _pushed(
        feet, contact.legs, mu, body, body.impulses, body.legs, z, world_from_body, params.dt
    )
    moment = about_centre(moment, total, params)
    turn = times(params.inverse_inertia, params.inverse_product, moment, params)
    never = body.position[2] > math.inf
    return plus(omega, 1.0, turn), total, impulses, legs, never


@unrolled
def _pushed(
    feet: tuple[tuple[float, float], ...],
    beams: tuple[Beam, ...],
    mu: tuple[float, ...],
    body: Body,
    before: tuple[Impulse, ...],
    states: tuple[LegState, ...],
    z: float,
    world_from_body: Matrix,
    dt: float,
) -> tuple[tuple[Impulse, ...], tuple[LegState, ...], Vector, Vector]:
    """Impulses and legs of feet after a step; sums of impulses and of their moments, body frame."""
    arm = feet[0][0], feet[0][1], z
    root = plus(body.position, 1.0, to_world(world_from_body, arm))
    impulse, state = _pushed_leg(
        beams[0], root, mu[0], before[0][0], states[0], world_from_body, dt
    )
    push = plus(impulse[1], impulse[0], world_from_body[2])
    moment = cross(plus(arm, 1.0, state[0]), push)
    if len(feet) == 1:
        return (impulse,), (state,), push, moment
    impulses, others, pushes, moments = _pushed(
        feet[1:], beams[1:], mu[1:], body, before[1:], states[1:], z, world_from_body, dt
    )
    total, levers = plus(push, 1.0, pushes), plus(moment, 1.0, moments)
    return (impulse, *impulses), (state, *others), total, levers


@inlined
def _pushed_leg(
    beam: Beam,
    root: Vector,
    mu: float,
    pressed: float,
    state: LegState,
    world_from_body: Matrix,
    dt: float,
) -> tuple[Impulse, LegState]:
    """Impulse on one leg, and its state, after a step.

    Args:
        root: where the tip would be if the leg were straight, world frame, m.
        pressed: normal impulse of the step before: the tip was on the floor if it is positive.
    """
    deflection, (tip_x, tip_y) = state
    relaxed = scaled(beam.memory, deflection)
    rest = plus(root, 1.0, to_world(world_from_body, relaxed))  # of the tip, if it were free
    axis = to_world(world_from_body, beam.axis)
    free = (rest[2] >= 0.0) | (mu < 0.0)
    stays = pressed > 0.0
    tip_x, tip_y = select(stays, tip_x, rest[0]), select(stays, tip_y, rest[1])

    # Force with a tip that sticks
    force = _elastic_force(beam, axis, (tip_x - rest[0], tip_y - rest[1], -rest[2]))
    along_2 = force[0] * force[0] + force[1] * force[1]
    limit = mu * force[2]
    sticks = (force[2] >= 0.0) & (along_2 <= limit * limit)

    # Slides by s against the force, until that is μ times the load: a quadratic equation
    size = math.sqrt(select(along_2 > 0.0, along_2, 1.0))
    against = force[0] / size, force[1] / size, 0.0 * size
    less = _elastic_force(beam, axis, against)
    mu_2 = mu * mu
    a = less[0] * less[0] + less[1] * less[1] - mu_2 * less[2] * less[2]
    b = force[0] * less[0] + force[1] * less[1] - mu_2 * force[2] * less[2]
    c = along_2 - limit * limit
    square = b * b - a * c
    divisor = b + math.sqrt(select(square > 0.0, square, 0.0))
    s = c / select(divisor > 0.0, divisor, 1.0)
    slides = (square >= 0.0) & (divisor > 0.0) & (s >= 0.0) & (force[2] - s * less[2] >= 0.0)

    # Where that cannot be, to the least energy, without any friction
    level_2 = axis[0] * axis[0] + axis[1] * axis[1]
    lean = axis[0] * force[0] + axis[1] * force[1]
    lean = beam.stiffening * lean / (beam.bending + beam.stiffening * level_2)
    slip_x = (force[0] - lean * axis[0]) / beam.bending
    slip_y = (force[1] - lean * axis[1]) / beam.bending
    lifted = beam.stiffening * axis[2] * (axis[0] * slip_x + axis[1] * slip_y)
    slid = either(slides, plus(force, -s, less), (0.0, 0.0, force[2] - lifted))
    slip_x, slip_y = select(slides, s * against[0], slip_x), select(slides, s * against[1], slip_y)
    tip_x = select(sticks, tip_x, tip_x - slip_x)
    tip_y = select(sticks, tip_y, tip_y - slip_y)

    bent = to_body(world_from_body, (tip_x - root[0], tip_y - root[1], -root[2]))
    x, y, z = either(free, (0.0, 0.0, 0.0), scaled(dt, either(sticks, force, slid)))
    impulse = z, to_body(world_from_body, (x, y, 0.0 * x))
    return impulse, (either(free, relaxed, bent), (tip_x, tip_y))


@inlined
def _elastic_force(beam: Beam, axis: Vector, deflection: Vector) -> Vector:
    """Force of a leg on the body by a deflection of its tip; all in one frame."""
    along = beam.stiffening * dot(axis, deflection)
    return plus(scaled(beam.bending, deflection), along, axis)

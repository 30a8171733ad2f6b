"""Rigid unilateral contacts with Coulomb friction, solved as impulses per time step.

Moreau time stepping in the body frame: there the contact points, the inertia and so the Delassus
operator are constant, only the floor normal changes. Each sweep is one projected gradient step on
all contacts at once, which keeps mirror symmetry exact; impulses of the last step start the next.
Nothing here knows motors or time integration.

Loads of more than three feet of a rigid body are not defined: a compliance of the contacts spreads
them as equal springs would. It is a share of the operator, so that a machine of another mass moves
alike, and so stiff that the body rocks on it far faster than motors turn.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from cosim.base.jit import inlined
from cosim.model.params import RobotParams
from cosim.model.world import World
from cosim.physics.lanes import select
from cosim.physics.mass import Mass, mass_of
from cosim.physics.rotation import Vector, dot, plus

Impulse = tuple[float, Vector]

# Share of a penetration removed per step. Solver residuals leave some 1e-12 m; removing them at
# once would act as noise on the normal force, never removing them would let the robot sink.
GAP_CORRECTION = 0.1


# Sweeps end when impulses change by less than this share of weight·dt: in smooth sliding the warm
# start needs one sweep, after a foot lands or sticks some ten. Mean speeds stay within 0.3 % of
# converged contacts (benchmarks/convergence.py). Some landings on eight feet, or of bodies with
# very unequal moments of inertia, need hundreds.
CONTACT_TOLERANCE = 0.01
MAX_SWEEPS = 1000
OWN_MU = -2.0  # of a patch, in place of a friction coefficient: that of each foot
NO_FLOOR = -1.0  # in place of a friction coefficient: no floor is below the foot

# Compliance of contacts of more than three feet, see the head of this file, over the mean of the
# eigenvalues of the normal part of the Delassus operator that are not zero (three).
COMPLIANCE = 1.0 / 6.0


class Pairing(NamedTuple):
    """Order in which kernels take motors or feet: first those that are mirror images, in pairs.

    What is summed is summed by pairs, which keeps the mirror symmetry exact in rounding.
    """

    # One zero per pair: the number of pairs is part of the type, and kernels are compiled for it
    pairs: tuple[int, ...]
    order: tuple[int, ...]  # of kernels: indices in the machine's order


def paired(places_m: Sequence[tuple[float, float]]) -> Pairing:
    """Find mirror images, at (x, y) and (x, −y) from the axis in m."""
    left = dict(enumerate(places_m))
    pairs: list[int] = []
    for k, (x, y) in enumerate(places_m):
        twins = [i for i in left if i > k and left[i] == (x, -y) and y != 0.0]
        if k in left and twins:
            pairs += [k, twins[0]]
            del left[k], left[twins[0]]
    return Pairing((0,) * (len(pairs) // 2), (*pairs, *left))


class ContactParams(NamedTuple):
    """Geometry and step sizes of the contact solver (body frame)."""

    pairing: Pairing
    # Positions (x, y) of feet, from the robot's axis, in the order of the pairing, m
    feet: tuple[tuple[float, float], ...]
    z: float  # of all of them, from the height of the centre of mass, m
    # Coulomb friction coefficient under each of them, static = kinetic; or NO_FLOOR
    mu: tuple[float, ...]
    # step_normal, step_tangential: step sizes of the projected gradient in kg
    step_normal: float
    step_tangential: float
    spin_inertia: float  # friction impulse at a foot, in N s, that changes a spin by 1 rad/s: kg m
    # sweeps end when the impulses, that of the spin included, change by less than this, N s
    tolerance: float
    compliance: float  # normal speed that a contact yields per normal impulse, 1/kg
    max_sweeps: int  # bound on the gradient steps of one time step


def foot_positions(robot: RobotParams) -> np.ndarray:
    """Feet from the robot's axis at the height of the centre of mass, shape (M, 3), m."""
    return np.array([(foot.x_m, foot.y_m, -robot.com_height_m) for foot in robot.feet])


def floor_margin(robot: RobotParams, world: World) -> float:
    """Return how far the robot's axis is from the floor's edge, feet on it, m; 0 without edge."""
    feet = foot_positions(robot)[:, :2]
    return float(np.linalg.norm(feet, axis=1).max()) if world.edge else 0.0


def delassus(robot: RobotParams, mass: Mass | None = None) -> np.ndarray:
    """Delassus operator of M contacts, shape (3 M, 3 M), 1/kg: impulses to velocities.

    Rows and columns are x, y, z of each foot in the body frame; `mass` is by default that of the
    robot without payload.
    """
    mass = mass or mass_of(robot)
    jacobian = np.zeros((3 * len(robot.feet), 6))
    for i, (x, y, z) in enumerate(foot_positions(robot) - (*mass.centre, 0.0)):
        jacobian[3 * i : 3 * i + 3, :3] = np.eye(3)
        jacobian[3 * i : 3 * i + 3, 3:] = [[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]]
    inverse = np.diag([1.0 / mass.total] * 6)
    inverse[3:, 3:] = mass.inverse_tensor()
    return jacobian @ inverse @ jacobian.T


def contact_params(robot: RobotParams, tolerance: float, mass: Mass | None = None) -> ContactParams:
    """Solver parameters of a robot; the step sizes let no sweep expand.

    Normal and tangential rows are scaled by their own largest eigenvalues, then both by the
    largest eigenvalue of the scaled whole, so that the gradient step is stable for any mass and
    geometry. The operator includes the compliance.
    """
    mass = mass or mass_of(robot)
    pairing = paired([(foot.x_m, foot.y_m) for foot in robot.feet])
    feet = [robot.feet[k] for k in pairing.order]
    operator = delassus(robot, mass)
    normal = np.arange(len(operator)) % 3 == 2
    compliance = 0.0
    if len(feet) > 3:
        compliance = _rounded(COMPLIANCE * np.diag(operator)[normal].sum() / 3.0)
        operator[normal, normal] += compliance
    scale = np.empty(len(operator))
    scale[normal] = np.linalg.eigvalsh(operator[np.ix_(normal, normal)])[-1]
    scale[~normal] = np.linalg.eigvalsh(operator[np.ix_(~normal, ~normal)])[-1]
    root = np.sqrt(scale)
    largest = np.linalg.eigvalsh(operator / np.outer(root, root))[-1]
    return ContactParams(
        pairing,
        tuple((foot.x_m, foot.y_m) for foot in feet),
        -robot.com_height_m,
        mu=tuple(robot.mu if foot.mu is None else foot.mu for foot in feet),
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
    contact: ContactParams,
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
    return pressed, (shrink * friction[0], shrink * friction[1], shrink * friction[2])

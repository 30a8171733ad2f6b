"""Three rigid unilateral contacts with Coulomb friction, solved as impulses per time step.

Moreau time stepping in the body frame: there the contact points, the inertia and so the Delassus
operator are constant, only the floor normal changes. Each sweep is one projected gradient step on
all three contacts at once, which keeps mirror symmetry exact; impulses of the last step start the
next. Nothing here knows motors or time integration.
"""

import math
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
# converged contacts (benchmarks/convergence.py).
CONTACT_TOLERANCE = 0.01
MAX_SWEEPS = 50
NO_FLOOR = -1.0  # in place of a friction coefficient: no floor is below the foot


class ContactParams(NamedTuple):
    """Geometry and step sizes of the contact solver (body frame)."""

    # a, b, c: positions of feet A, B, C in m; origin: the robot's axis at the height of the centre
    # of mass
    a: Vector
    b: Vector
    c: Vector
    mu: Vector  # Coulomb friction coefficient under each of them, static = kinetic; or NO_FLOOR
    # step_normal, step_tangential: step sizes of the projected gradient in kg
    step_normal: float
    step_tangential: float
    spin_inertia: float  # friction impulse at a foot, in N s, that changes a spin by 1 rad/s: kg m
    # sweeps end when the impulses, that of the spin included, change by less than this, N s
    tolerance: float
    max_sweeps: int  # bound on the gradient steps of one time step


def foot_positions(robot: RobotParams) -> np.ndarray:
    """Feet A, B, C from the robot's axis, shape (3, 3), m: A and C at +x, B at −x (Fig. 4b)."""
    angles = np.deg2rad([60.0, 180.0, -60.0])
    feet = np.empty((3, 3))
    feet[:, 0] = robot.foot_radius_m * np.cos(angles)
    feet[:, 1] = robot.foot_radius_m * np.sin(angles)
    feet[:, 2] = -robot.com_height_m
    feet[2, :2] = feet[0, 0], -feet[0, 1]  # exact mirror images
    feet[1, 1] = 0.0
    return feet


def floor_margin(robot: RobotParams, world: World) -> float:
    """Return how far the centre of mass is from the edge of a floor with all feet on it, m.

    It is 0 where the floor does not end.
    """
    feet = foot_positions(robot)[:, :2] - mass_of(robot, world).centre
    return float(np.hypot(*feet.T).max()) if world.edge else 0.0


def delassus(robot: RobotParams, mass: Mass | None = None) -> np.ndarray:
    """Delassus operator of the three contacts, shape (9, 9), 1/kg: impulses to velocities.

    Rows and columns are x, y, z of A, B, C in the body frame; `mass` is by default that of the
    robot without payload.
    """
    mass = mass or mass_of(robot)
    jacobian = np.zeros((9, 6))
    for i, (x, y, z) in enumerate(foot_positions(robot) - (*mass.centre, 0.0)):
        jacobian[3 * i : 3 * i + 3, :3] = np.eye(3)
        jacobian[3 * i : 3 * i + 3, 3:] = [[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]]
    inverse = np.diag([1.0 / mass.total] * 6)
    inverse[3:, 3:] = mass.inverse_tensor()
    return jacobian @ inverse @ jacobian.T


def contact_params(robot: RobotParams, tolerance: float, mass: Mass | None = None) -> ContactParams:
    """Solver parameters of a robot; the step sizes make every sweep a contraction.

    Normal and tangential rows are scaled by their own largest eigenvalues, then both by the
    largest eigenvalue of the scaled whole, so that the gradient step is stable for any geometry.
    """
    mass = mass or mass_of(robot)
    feet = foot_positions(robot)
    operator = delassus(robot, mass)
    normal = np.arange(9) % 3 == 2
    scale = np.empty(9)
    scale[normal] = np.linalg.eigvalsh(operator[np.ix_(normal, normal)])[-1]
    scale[~normal] = np.linalg.eigvalsh(operator[np.ix_(~normal, ~normal)])[-1]
    root = np.sqrt(scale)
    largest = np.linalg.eigvalsh(operator / np.outer(root, root))[-1]
    return ContactParams(
        *((float(x), float(y), float(z)) for x, y, z in feet),
        mu=(robot.mu, robot.mu, robot.mu),
        step_normal=_rounded(1.0 / (largest * scale[2])),
        step_tangential=_rounded(1.0 / (largest * scale[0])),
        spin_inertia=mass.inertia[2] / robot.foot_radius_m,
        tolerance=tolerance,
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
    pressed = impulse[0] - contact.step_normal * (speed - least_normal_speed)
    pressed = select(pressed > 0.0, pressed, 0.0)
    limit = mu * pressed
    length_2 = dot(friction, friction)
    slides = length_2 > limit * limit
    shrink = select(slides, limit / math.sqrt(length_2), 1.0)
    return pressed, (shrink * friction[0], shrink * friction[1], shrink * friction[2])

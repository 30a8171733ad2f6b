"""Robots against robots and obstacles: upright cylinders, rigid, Coulomb friction, inelastic.

What is in contact gets one impulse per tick, after the floor contacts; the feet answer in the next
tick. The line of contact is taken as a point at the height of the centre of mass (assumed), so
that a push does not tip, and the axes as vertical: a robot tilts by less than a milliradian.
Rims are circles around the robots' axes; impulses act about their centres of mass. Arrays are those
of a `State` in `cosim.coupling.signals`.
"""

import math
from typing import NamedTuple

import numpy as np

from cosim.base.jit import inlined
from cosim.model.scenario import touches_obstacle as definition
from cosim.physics.body_state import V_X, V_Y, W_Z, X, Y, orientation_of
from cosim.physics.contact.rigid import allowed_approach
from cosim.physics.neighbours import FOUND, find_near, list_by_cells
from cosim.physics.properties import CENTRE, INVERSE_INERTIA, INVERSE_MASS
from cosim.physics.rotation import rotation_matrix, to_centre

touches_obstacle = inlined(definition)  # whether a robot touches an obstacle, for kernels

FASTEST_M_S = 1.0  # assumed: no robot is faster


class PairParams(NamedTuple):
    """Contact of robots."""

    diameter: float  # of each robot in m
    mu: float  # friction coefficient between robots, and between robots and obstacles (assumed)
    # distance in m from contact, within which it is checked every tick: more than two robots of
    # FASTEST_M_S can close until all are looked at again, a control period later
    near: float


@inlined
def find_near_pairs(
    bodies: np.ndarray,
    first: int,
    robots: int,
    board: np.ndarray,
    lists: np.ndarray,
    pair: PairParams,
    near: np.ndarray,
    count: int,
) -> int:
    """Write the pairs of an episode's robots that may touch soon; returns the rows until now.

    Args:
        near: (P, 2) int64, columns of pairs, written from row `count` on.
    """
    reach = pair.diameter + pair.near
    grid = list_by_cells(lists, bodies[X], bodies[Y], first, robots, board, reach)
    for i in range(first, first + robots):
        for k in range(first, first + find_near(lists, grid, bodies[X, i], bodies[Y, i])):
            j = lists[FOUND, k]
            if j >= i:
                break
            dx, dy = bodies[X, i] - bodies[X, j], bodies[Y, i] - bodies[Y, j]
            if dx * dx + dy * dy < reach * reach:
                near[count, 0], near[count, 1] = i, j
                count += 1
    return count


@inlined
def push_apart(
    bodies: np.ndarray, properties: np.ndarray, a: int, b: int, pair: PairParams, inverse_dt: float
) -> float:
    """Apply the contact impulse between two robots, in place; returns its normal part in N s."""
    dx, dy = bodies[X, b] - bodies[X, a], bodies[Y, b] - bodies[Y, a]
    distance = math.sqrt(dx * dx + dy * dy)
    nx, ny = dx / distance, dy / distance  # from a to b; the tangent is (−ny, nx)
    radius = 0.5 * pair.diameter
    centre_a, velocity_a = _planar(bodies, properties, a)
    centre_b, velocity_b = _planar(bodies, properties, b)
    vx, vy = velocity_b[0] - velocity_a[0], velocity_b[1] - velocity_a[1]
    approach = vx * nx + vy * ny
    excess = approach - allowed_approach(distance - pair.diameter, inverse_dt)
    if excess >= 0.0:
        return 0.0
    mass_a, mass_b = properties[INVERSE_MASS, a], properties[INVERSE_MASS, b]  # inverse
    slip = vy * nx - vx * ny - radius * (bodies[W_Z, a] + bodies[W_Z, b])
    # moments of a unit of each impulse about the centres of mass, and the spins that they give
    turn_a = centre_a[1] * nx - centre_a[0] * ny
    turn_b = -(centre_b[1] * nx - centre_b[0] * ny)
    lever_a = radius - (centre_a[0] * nx + centre_a[1] * ny)
    lever_b = radius + (centre_b[0] * nx + centre_b[1] * ny)
    twist_a = turn_a * properties[INVERSE_INERTIA + 2, a]
    twist_b = turn_b * properties[INVERSE_INERTIA + 2, b]
    spin_a = lever_a * properties[INVERSE_INERTIA + 2, a]
    spin_b = lever_b * properties[INVERSE_INERTIA + 2, b]
    impulse, friction = _impulses(
        excess,
        slip,
        mass_a + mass_b + (turn_a * twist_a + turn_b * twist_b),
        turn_a * spin_a + turn_b * spin_b,
        mass_a + mass_b + (lever_a * spin_a + lever_b * spin_b),
        pair.mu,
    )
    jx, jy = impulse * nx - friction * ny, impulse * ny + friction * nx
    bodies[V_X, a] -= jx * mass_a
    bodies[V_Y, a] -= jy * mass_a
    bodies[V_X, b] += jx * mass_b
    bodies[V_Y, b] += jy * mass_b
    bodies[W_Z, a] -= spin_a * friction + twist_a * impulse
    bodies[W_Z, b] -= spin_b * friction + twist_b * impulse
    return impulse


@inlined
def _planar(
    bodies: np.ndarray, properties: np.ndarray, column: int
) -> tuple[tuple[float, float], tuple[float, float]]:
    """Place of a robot's centre of mass from its axis, and the axis's velocity; world frame."""
    centre = properties[CENTRE, column], properties[CENTRE + 1, column]
    if centre[0] == 0.0 and centre[1] == 0.0:
        return centre, (bodies[V_X, column], bodies[V_Y, column])
    x, y, _ = to_centre(rotation_matrix(orientation_of(bodies[:, column])), centre)
    rate = bodies[W_Z, column]
    return (x, y), (bodies[V_X, column] + rate * y, bodies[V_Y, column] - rate * x)


@inlined
def _impulses(
    excess: float, slip: float, normal: float, both: float, tangential: float, mu: float
) -> tuple[float, float]:
    """Normal and friction impulses that end the excess, and the slip within Coulomb's limit.

    Args:
        excess, slip: relative velocities along the normal and the tangent, m/s.
        normal, both, tangential: elements of the symmetric matrix from impulses to them, 1/kg.
        mu: friction coefficient.
    """
    without = -excess / normal  # impulse without friction
    share = both / normal if both != 0.0 else 0.0
    friction = -(slip + both * without) / (tangential - both * share)
    limit = mu * without
    if share != 0.0:
        # Friction changes the normal impulse too: the limit is μ of what it leaves. Where it adds
        # more than it needs, any slip ends.
        room = 1.0 + math.copysign(mu, friction) * share
        limit = limit / room if room > 0.0 else math.inf
    friction = min(limit, max(-limit, friction))
    return without - share * friction, friction


@inlined
def find_near_obstacles(
    bodies: np.ndarray,
    column: int,
    obstacles: np.ndarray,
    pair: PairParams,
    near: np.ndarray,
    count: int,
) -> int:
    """Write the obstacles that a robot may touch soon; returns the rows until now.

    Args:
        near: (P, 2) int64, column and obstacle, written from row `count` on.
    """
    reach = 0.5 * pair.diameter + pair.near
    for k in range(len(obstacles)):
        dx, dy = away_from(obstacles[k], bodies[X, column], bodies[Y, column])
        if dx * dx + dy * dy < reach * reach:
            near[count, 0], near[count, 1] = column, k
            count += 1
    return count


@inlined
def away_from(rectangle: np.ndarray, x: float, y: float) -> tuple[float, float]:
    """From the closest point of a rectangle to a point, m."""
    dx = x - min(max(x, rectangle[0]), rectangle[2])
    return dx, y - min(max(y, rectangle[1]), rectangle[3])


@inlined
def push_off(
    bodies: np.ndarray,
    properties: np.ndarray,
    column: int,
    rectangle: np.ndarray,
    pair: PairParams,
    inverse_dt: float,
) -> float:
    """Apply the contact impulse of an obstacle, which stays; returns its normal part in N s."""
    dx, dy = away_from(rectangle, bodies[X, column], bodies[Y, column])
    distance = math.sqrt(dx * dx + dy * dy)
    nx, ny = dx / distance, dy / distance  # to the robot; the tangent is (−ny, nx)
    radius = 0.5 * pair.diameter
    (x, y), (vx, vy) = _planar(bodies, properties, column)
    excess = vx * nx + vy * ny - allowed_approach(distance - radius, inverse_dt)
    if excess >= 0.0:
        return 0.0
    inverse_mass = properties[INVERSE_MASS, column]
    slip = vy * nx - vx * ny - radius * bodies[W_Z, column]
    turn, lever = -(y * nx - x * ny), radius + (x * nx + y * ny)  # as of robot b of a pair
    twist = turn * properties[INVERSE_INERTIA + 2, column]
    spin = lever * properties[INVERSE_INERTIA + 2, column]
    impulse, friction = _impulses(
        excess,
        slip,
        inverse_mass + turn * twist,
        turn * spin,
        inverse_mass + lever * spin,
        pair.mu,
    )
    bodies[V_X, column] += inverse_mass * (impulse * nx - friction * ny)
    bodies[V_Y, column] += inverse_mass * (impulse * ny + friction * nx)
    bodies[W_Z, column] -= spin * friction + twist * impulse
    return impulse

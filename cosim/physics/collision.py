"""Robots against robots and obstacles: upright cylinders, rigid, Coulomb friction, inelastic.

What is in contact gets one impulse per tick, after the floor contacts; the feet answer in the next
tick. The line of contact is taken as a point at the height of the centre of mass (assumed), so
that a push does not tip, and the axes as vertical: a robot tilts by less than a milliradian.
Arrays are those of a `State` in `cosim.coupling.signals`.
"""

import math
from typing import NamedTuple

import numpy as np

from cosim.base.jit import inlined
from cosim.model.scenario import touches_obstacle as definition
from cosim.physics.body_state import V_X, V_Y, W_Z, X, Y
from cosim.physics.contact import allowed_approach
from cosim.physics.neighbours import FOUND, find_near, list_by_cells
from cosim.physics.properties import INVERSE_INERTIA, INVERSE_MASS

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
    vx, vy = bodies[V_X, b] - bodies[V_X, a], bodies[V_Y, b] - bodies[V_Y, a]
    approach = vx * nx + vy * ny
    excess = approach - allowed_approach(distance - pair.diameter, inverse_dt)
    if excess >= 0.0:
        return 0.0
    mass_a, mass_b = properties[INVERSE_MASS, a], properties[INVERSE_MASS, b]  # inverse
    impulse = -excess / (mass_a + mass_b)
    slip = vy * nx - vx * ny - radius * (bodies[W_Z, a] + bodies[W_Z, b])
    spin_a = radius * properties[INVERSE_INERTIA + 2, a]  # per impulse
    spin_b = radius * properties[INVERSE_INERTIA + 2, b]
    stopping = -slip / (mass_a + mass_b + radius * (spin_a + spin_b))
    limit = pair.mu * impulse
    friction = min(limit, max(-limit, stopping))
    jx, jy = impulse * nx - friction * ny, impulse * ny + friction * nx
    bodies[V_X, a] -= jx * mass_a
    bodies[V_Y, a] -= jy * mass_a
    bodies[V_X, b] += jx * mass_b
    bodies[V_Y, b] += jy * mass_b
    bodies[W_Z, a] -= spin_a * friction
    bodies[W_Z, b] -= spin_b * friction
    return impulse


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
    vx, vy = bodies[V_X, column], bodies[V_Y, column]
    excess = vx * nx + vy * ny - allowed_approach(distance - radius, inverse_dt)
    if excess >= 0.0:
        return 0.0
    inverse_mass = properties[INVERSE_MASS, column]
    spin = radius * properties[INVERSE_INERTIA + 2, column]  # per impulse
    impulse = -excess / inverse_mass
    slip = vy * nx - vx * ny - radius * bodies[W_Z, column]
    limit = pair.mu * impulse
    friction = min(limit, max(-limit, -slip / (inverse_mass + radius * spin)))
    bodies[V_X, column] += inverse_mass * (impulse * nx - friction * ny)
    bodies[V_Y, column] += inverse_mass * (impulse * ny + friction * nx)
    bodies[W_Z, column] -= spin * friction
    return impulse

"""Robots against robots: upright cylinders, rigid, Coulomb friction, inelastic.

A pair in contact gets one impulse per tick, after the floor contacts; the feet answer in the next
tick. The line of contact is taken as a point at the height of the centre of mass (assumed), so
that a push does not tip, and the axes as vertical: a robot tilts by less than a milliradian.
"""

import math
from typing import NamedTuple

import numpy as np

from cosim.base.jit import inlined
from cosim.physics.contact import allowed_approach
from cosim.physics.properties import INVERSE_INERTIA, INVERSE_MASS
from cosim.scenarios.scenario import touches_obstacle as definition

touches_obstacle = inlined(definition)  # whether a robot touches an obstacle, for kernels

# Pairs within this distance of contact are checked every tick, the others once per control period:
# robots slower than 1 m/s cannot close it within 1 ms.
NEAR_M = 2e-3


class PairParams(NamedTuple):
    """Contact between two robots.

    Attributes:
        diameter: of each robot in m.
        mu: friction coefficient between robots.
    """

    diameter: float
    mu: float


@inlined
def find_near_pairs(
    bodies: np.ndarray, first: int, robots: int, pair: PairParams, near: np.ndarray, count: int
) -> int:
    """Write the pairs of an episode's robots that are close enough to touch soon.

    Args:
        bodies: (STATE_SIZE, B).
        first: column of the episode's first robot; the others follow.
        robots: their number.
        pair: contact parameters.
        near: (P, 2) int64, columns of pairs, written from row `count` on.
        count: pairs written before.

    Returns:
        Number of pairs written until now.
    """
    reach = pair.diameter + NEAR_M
    for i in range(first, first + robots):
        for j in range(first, i):
            dx, dy = bodies[0, i] - bodies[0, j], bodies[1, i] - bodies[1, j]
            if dx * dx + dy * dy < reach * reach:
                near[count, 0], near[count, 1] = i, j
                count += 1
    return count


@inlined
def push_apart(
    bodies: np.ndarray,
    properties: np.ndarray,
    a: int,
    b: int,
    pair: PairParams,
    inverse_dt: float,
) -> float:
    """Apply the contact impulse between two robots, in place.

    Args:
        bodies: (STATE_SIZE, B).
        properties: (PROPERTIES, B), see `cosim.physics.properties`.
        a, b: columns of the robots.
        pair: contact parameters.
        inverse_dt: of the tick, 1/s.

    Returns:
        The normal impulse in N s, 0 if they do not touch.
    """
    dx, dy = bodies[0, b] - bodies[0, a], bodies[1, b] - bodies[1, a]
    distance = math.sqrt(dx * dx + dy * dy)
    nx, ny = dx / distance, dy / distance  # from a to b; the tangent is (−ny, nx)
    radius = 0.5 * pair.diameter
    vx, vy = bodies[7, b] - bodies[7, a], bodies[8, b] - bodies[8, a]
    approach = vx * nx + vy * ny
    excess = approach - allowed_approach(distance - pair.diameter, inverse_dt)
    if excess >= 0.0:
        return 0.0
    mass_a, mass_b = properties[INVERSE_MASS, a], properties[INVERSE_MASS, b]  # inverse
    impulse = -excess / (mass_a + mass_b)
    slip = vy * nx - vx * ny - radius * (bodies[12, a] + bodies[12, b])
    spin_a = radius * properties[INVERSE_INERTIA + 2, a]  # per impulse
    spin_b = radius * properties[INVERSE_INERTIA + 2, b]
    stopping = -slip / (mass_a + mass_b + radius * (spin_a + spin_b))
    limit = pair.mu * impulse
    friction = min(limit, max(-limit, stopping))
    jx, jy = impulse * nx - friction * ny, impulse * ny + friction * nx
    bodies[7, a] -= jx * mass_a
    bodies[8, a] -= jy * mass_a
    bodies[7, b] += jx * mass_b
    bodies[8, b] += jy * mass_b
    bodies[12, a] -= spin_a * friction
    bodies[12, b] -= spin_b * friction
    return impulse

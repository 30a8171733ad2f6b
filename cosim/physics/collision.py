"""Robots against robots: upright cylinders, rigid, Coulomb friction, inelastic.

A pair in contact gets one impulse per tick, after the floor contacts; the feet answer in the next
tick. The line of contact is taken as a point at the height of the centre of mass (assumed), so
that a push does not tip, and the axes as vertical: a robot tilts by less than a milliradian.
"""

import math
from typing import NamedTuple

import numpy as np

from cosim.base.jit import inlined
from cosim.physics.body import BodyParams
from cosim.physics.contact import allowed_approach

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
def find_near_pairs(bodies: np.ndarray, pair: PairParams, near: np.ndarray) -> int:
    """Write the pairs of robots close enough to touch soon.

    Args:
        bodies: (N, STATE_SIZE).
        pair: contact parameters.
        near: (N (N − 1) / 2, 2) int64, written.

    Returns:
        Number of pairs written.
    """
    count = 0
    reach = pair.diameter + NEAR_M
    for i in range(bodies.shape[0]):
        for j in range(i):
            dx, dy = bodies[i, 0] - bodies[j, 0], bodies[i, 1] - bodies[j, 1]
            if dx * dx + dy * dy < reach * reach:
                near[count, 0], near[count, 1] = i, j
                count += 1
    return count


@inlined
def push_apart(a: np.ndarray, b: np.ndarray, pair: PairParams, params: BodyParams) -> float:
    """Apply the contact impulse between two robots, in place.

    Args:
        a, b: states of the robots, shape (STATE_SIZE,).
        pair: contact parameters.
        params: constants of both robots.

    Returns:
        The normal impulse in N s, 0 if they do not touch.
    """
    dx, dy = b[0] - a[0], b[1] - a[1]
    distance = math.sqrt(dx * dx + dy * dy)
    nx, ny = dx / distance, dy / distance  # from a to b; the tangent is (−ny, nx)
    radius = 0.5 * pair.diameter
    approach = (b[7] - a[7]) * nx + (b[8] - a[8]) * ny
    excess = approach - allowed_approach(distance - pair.diameter, params.inverse_dt)
    if excess >= 0.0:
        return 0.0
    impulse = -excess / (2.0 * params.inverse_mass)
    slip = (b[8] - a[8]) * nx - (b[7] - a[7]) * ny - radius * (a[12] + b[12])
    spin_per_impulse = radius * params.inverse_inertia[2]
    stopping = -slip / (2.0 * params.inverse_mass + 2.0 * radius * spin_per_impulse)
    limit = pair.mu * impulse
    friction = min(limit, max(-limit, stopping))
    jx, jy = impulse * nx - friction * ny, impulse * ny + friction * nx
    a[7] -= jx * params.inverse_mass
    a[8] -= jy * params.inverse_mass
    b[7] += jx * params.inverse_mass
    b[8] += jy * params.inverse_mass
    a[12] -= spin_per_impulse * friction
    b[12] -= spin_per_impulse * friction
    return impulse

"""Feet of a robot: where they are, their order in kernels, and what laws of contact make of them.

No law is here; nothing here knows motors or time integration.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from cosim.model.params import RobotParams
from cosim.model.world import World
from cosim.physics.mass import Mass, mass_of
from cosim.physics.rotation import Vector

Impulse = tuple[float, Vector]  # normal impulse, and that of friction in the body frame, N s
# Of an elastic leg: deflection of its tip (body frame), and place x, y of the tip on the floor, m
LegState = tuple[Vector, tuple[float, float]]
# Angular velocity of a body after a step, and the sum of impulses in it (body frame); what becomes
# of its feet and legs; and whether that is not solved
Response = tuple[Vector, Vector, tuple[Impulse, ...], tuple[LegState, ...], bool]

OWN_MU = -2.0  # of a patch, in place of a friction coefficient: that of each foot
NO_FLOOR = -1.0  # in place of a friction coefficient: no floor is below the foot


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


class Feet(NamedTuple):
    """Feet of a robot, or of the robots in lanes, in the order of their pairing; body frame."""

    pairing: Pairing
    places: tuple[tuple[float, float], ...]  # x, y from the robot's axis, m
    z: float  # of all of them, from the height of the centre of mass, m
    # Coulomb friction coefficient under each of them, static = kinetic; or NO_FLOOR
    mu: tuple[float, ...]


def feet_of(robot: RobotParams) -> Feet:
    """Return the feet of a robot on its usual floor."""
    pairing = paired([(foot.x_m, foot.y_m) for foot in robot.feet])
    feet = [robot.feet[k] for k in pairing.order]
    return Feet(
        pairing,
        tuple((foot.x_m, foot.y_m) for foot in feet),
        -robot.com_height_m,
        tuple(robot.mu if foot.mu is None else foot.mu for foot in feet),
    )


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

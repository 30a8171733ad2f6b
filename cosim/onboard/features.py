"""Features that a robot sees of the others: distance class (Eq. 9) and gradient sign (Eq. 10).

Distances are squared and in cells (integers), so that no rounding decides a class. The learning
process and the co-simulation both call these functions: one definition for both.
"""

import math
from typing import NamedTuple

import numpy as np

from cosim.base.jit import inlined
from cosim.model.scenario import Scenario

NEAR, MEDIUM, LARGE = 0, 1, 2
DISTANCE_CLASSES = ("near", "medium", "large")
GRADIENT_SIGNS = ("closer", "same", "farther")  # index = sign + 1

# The eight directions of the action set: index k is k·45°, counter-clockwise from +x.
DIRECTIONS = np.array(
    [(1, 0), (1, 1), (0, 1), (-1, 1), (-1, 0), (-1, -1), (0, -1), (1, -1)], dtype=np.int64
)
DIRECTION_COUNT = len(DIRECTIONS)
# The paper's robot drives forwards as well as backwards: what its heading costs depends on its axis
# only. Other machines need more turns, or fewer (`SteeringParams.facings`, a power of two).
AXIS_COUNT = DIRECTION_COUNT // 2
UP, DOWN = 2, 6  # directions


@inlined
def facing_of(direction: int, facings: int) -> int:
    """Return what matters of a heading to a machine that needs different turns for so many."""
    return direction & (facings - 1)


@inlined
def starting_facing(row: int, rows: int, facings: int) -> int:
    """Return it at the start: assumed, robots are set down facing the middle row."""
    return facing_of(UP if 2 * row < rows else DOWN, facings)


class DistanceThresholds(NamedTuple):
    """Squared distances in cells² that bound the classes of Eq. (9), and contact."""

    contact: int
    near: int
    medium: int


def distance_thresholds(scenario: Scenario) -> DistanceThresholds:
    """Thresholds of Eq. (9) (5, 6 and 10 cm for robots of 5 cm) in cells² of the scenario."""
    diameter_cells = scenario.diameter_m / scenario.cell_m
    # Eq. (9) is written for the 5 cm robot: near up to 6/5 and medium up to 2 diameters.
    near, medium = (math.floor((s * diameter_cells) ** 2 + 1e-9) for s in (1.2, 2.0))
    return DistanceThresholds(scenario.squared_contact, near, medium)


@inlined
def distance_class(squared_distance: int, thresholds: DistanceThresholds) -> int:
    """Eq. (9): NEAR, MEDIUM or LARGE; contact distances count as NEAR."""
    # begin distance
    # Eq. (9)
    if squared_distance <= thresholds.near:
        return NEAR
    if squared_distance <= thresholds.medium:
        return MEDIUM
    return LARGE
    # end distance


@inlined
def gradient_sign(squared_distance: int, previous: int) -> int:
    """Eq. (10): sign(distance(t) − distance(t−1)) as −1, 0 or 1."""
    # begin gradient
    # Eq. (10)
    return int(squared_distance > previous) - int(squared_distance < previous)
    # end gradient


class Observation(NamedTuple):
    """Observation at a decision: one row per robot.

    Attributes:
        cells: (N, 2) int64, column and row of each robot.
        distance_class: (N,) int64, Eq. (9), to the nearest other robot; LARGE if alone.
        gradient_sign: (N,) int64, Eq. (10), since that robot's previous decision; 0 at the start.
        direction: (N,) int64, index of the direction the robot faces (for least-rotation ties).
        targets: (N, 2) int64, column and row of each robot's target; empty where an observation is
            made without.
        goals: (N, 2) int64, column and row of the cell that each robot drives to, its own where it
            waits for a decision; empty where an observation is made without.
    """

    cells: np.ndarray
    distance_class: np.ndarray
    gradient_sign: np.ndarray
    direction: np.ndarray
    targets: np.ndarray = np.empty((0, 2), dtype=np.int64)
    goals: np.ndarray = np.empty((0, 2), dtype=np.int64)

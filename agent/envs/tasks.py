"""Tasks of robots that are driven: where they begin, when they have arrived, what they earn.

A task of your own is a subclass of `Task` in any module, and needs no other file:

    gymnasium.make("MiniRobots/Drive-v0", task="my_module:MyTask")
"""

import math
from collections.abc import Mapping
from itertools import combinations, starmap
from typing import NamedTuple

import numpy as np

from cosim.base.arguments import ConfigError
from cosim.model.scenario import Scenario, touches_obstacle
from cosim.physics.trig import sines_cosines

REACH_M = 0.2
REACHED_M = 0.005
_DRAWS = 1000  # of poses, before a board counts as too small


class Driven(NamedTuple):
    """K boards of N robots that are driven; float64."""

    poses: np.ndarray  # (K, N, 3) x, y in m and heading in rad, as the learner knows them
    velocities: np.ndarray  # (K, N, 3) see `cosim.simulation.driving.DriveObservation`
    targets_m: np.ndarray  # (K, N, 2)
    away_m: np.ndarray  # (K, N) true distances from the targets
    dither: np.ndarray  # (K, N, 2) see `agent.envs.drive.set_points`
    # (K, N, 5) of the episodes: µ, motor spread, restitution, slope in deg, payload in 10 g
    worlds: np.ndarray


class Interval(NamedTuple):
    """A control interval of K boards of N robots."""

    before: Driven
    after: Driven
    arrived: np.ndarray  # (K, N) bool, robots that have arrived, in this interval or before
    failed: np.ndarray  # (K, N) bool, robots that touched something or left the board
    lasted_s: float


class Task:
    """The task of `Drive-v0`, to reach drawn targets; a subclass replaces what is different.

    Args:
        reach_m: largest distance of a target that is drawn, in m.
        weights: instead of those of the class.

    Attributes:
        weights: of the terms of the reward, by name; a term without a weight does not count. The
            reward is their sum, and infos have each one, weighted, as `reward_NAME`.
    """

    # assumed: a second costs as much as a millimetre; an arrival is worth 10 cm
    weights: Mapping[str, float] = {"progress": 100.0, "time": -0.1, "end": 10.0}

    def __init__(
        self, reach_m: float = REACH_M, weights: Mapping[str, float] | None = None
    ) -> None:
        self.reach_m, self.weights = reach_m, weights or self.weights

    def place(
        self,
        scenario: Scenario,
        rng: np.random.Generator,
        poses: np.ndarray | None,
        targets_m: np.ndarray | None,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return poses (N, 3) and targets (N, 2) of an episode, those that a reset gave as given.

        By default robots stand anywhere on the board, with targets in reach.
        """
        if poses is None:
            headings = rng.uniform(-math.pi, math.pi, scenario.robots)
            poses = np.column_stack([draw_positions(scenario, rng), headings])
        if targets_m is None:
            targets_m = draw_positions(scenario, rng, poses[:, :2], self.reach_m)
        return poses, targets_m

    def arrived(self, now: Driven) -> np.ndarray:
        """Return which robots have arrived, (K, N) bool; they stop, and earn nothing more."""
        return now.away_m <= REACHED_M

    def terms(self, step: Interval) -> dict[str, np.ndarray | float]:
        """Return the terms of the reward by name, each (K, N) or one number for all robots."""
        return {
            "progress": step.before.away_m - step.after.away_m,
            "time": step.lasted_s,
            "end": 1.0 * step.arrived - 1.0 * step.failed,
        }


def is_free(scenario: Scenario, positions: np.ndarray, margin_m: float = 0.0) -> bool:
    """Return whether (N, 2) positions are on the board, off obstacles, and a diameter apart."""
    diameter_m = scenario.diameter_m
    inside = (positions >= margin_m) & (positions <= np.array(scenario.size_m) - margin_m)
    walls = scenario.walls * scenario.cell_m
    touched = touches_obstacle(
        positions[:, 0], positions[:, 1], (diameter_m / 2.0 + margin_m) ** 2, walls
    )
    gaps = starmap(math.dist, combinations(positions.tolist(), 2))
    return bool(inside.all() and not np.any(touched)) and all(g > diameter_m for g in gaps)


def draw_positions(
    scenario: Scenario,
    rng: np.random.Generator,
    around: np.ndarray | None = None,
    reach_m: float = math.inf,
) -> np.ndarray:
    """Return free (N, 2) positions, uniform on the board, or within reach of others on it."""
    size_m = np.array(scenario.size_m)
    most_m = min(reach_m, math.hypot(*size_m))
    for _ in range(_DRAWS):
        drawn = rng.uniform(0.0, 1.0, (scenario.robots, 2))
        if around is None:
            positions = drawn * size_m
        else:
            away, angle = most_m * np.sqrt(drawn[:, 0]), 2.0 * math.pi * drawn[:, 1]
            positions = around + (away * sines_cosines(angle)[::-1]).T
        if is_free(scenario, positions, REACHED_M):
            return positions
    raise ConfigError(
        f"scenario {scenario.name}: {_DRAWS} draws found no places for its robots within "
        f"reach = {reach_m:g} m; choose a larger reach, or give starts and targets"
    )

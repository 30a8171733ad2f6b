"""Measures along an episode from samples of control periods: path, rotation, energy.

Accumulated RL step by RL step, so that an episode need not be kept. Outcomes are the episode's
(`cosim.simulation.episode`), statistics over episodes those of `minirobots evaluate`.
"""

import math
from itertools import combinations, starmap

import numpy as np

from cosim.base.jit import kernel
from cosim.coupling.signals import Samples
from cosim.physics.rotation import heading, wrapped

# Poses this far apart in time make path and rotation: shorter ones would add up the vibration.
PATH_SAMPLING_S = 0.1


class Measures:
    """Sums and extremes over the samples of one episode of N robots.

    Attributes:
        path_length_m: (N,) path of each robot's centre.
        rotation_rad: (N,) how far each robot has turned, either way.
        min_distance_m: smallest distance between the centres of two robots so far, taken every
            control period: within one, robots of some mm/s move by micrometres. Infinite for a
            robot alone. Robots touch at one diameter.
        energy_j: (N,) ∫ max(V i, 0) dt over the motors of each robot. The battery gives what a
            motor draws and gets nothing back: the simple driver of such a robot cannot
            store what a braked motor returns (assumed). V and i are those at the ends of control
            periods: with the default noise, to which the voltage answers within a period, some
            5 % less than at every tick.
        regenerated_j: (N,) ∫ max(−V i, 0) dt, what is lost by that (0.5 % of a driving motor's).
    """

    def __init__(
        self, positions_m: np.ndarray, headings_rad: np.ndarray, control_period_s: float
    ) -> None:
        """Begin an episode."""
        n = len(positions_m)
        self.path_length_m = np.zeros(n)
        self.rotation_rad = np.zeros(n)
        self.energy_j = np.zeros(n)
        self.regenerated_j = np.zeros(n)
        self.contact_time_s = 0.0
        self.min_distance_m = min(
            starmap(math.dist, combinations(positions_m.tolist(), 2)), default=math.inf
        )
        self._boxes_m = np.empty((n, 4))
        self._period_s = control_period_s
        self._path_periods = max(1, round(PATH_SAMPLING_S / control_period_s))
        self._since_point = 0  # control periods since the last point of the paths
        self._last_m, self._last_rad = positions_m.copy(), headings_rad.copy()

    def add(self, samples: Samples) -> None:
        """Take the samples of one RL step: views of any layout, which decides no bit."""
        # Backwards in time no array is contiguous: all share one compiled version.
        least_m, touched_s = _add(
            samples.position[::-1],
            samples.quaternion[::-1],
            samples.voltage[::-1],
            samples.current[::-1],
            samples.touching_share[::-1],
            (self._period_s, self._path_periods, self._since_point),
            (self._last_m, self._last_rad, self._boxes_m),
            (self.path_length_m, self.rotation_rad, self.energy_j, self.regenerated_j),
        )
        self._since_point = (self._since_point + len(samples.position)) % self._path_periods
        self.min_distance_m = min(self.min_distance_m, least_m)
        self.contact_time_s += touched_s


@kernel
def _add(
    position: np.ndarray,
    quaternion: np.ndarray,
    voltage: np.ndarray,
    current: np.ndarray,
    touching: np.ndarray,
    clock: tuple[float, int, int],
    memory: tuple[np.ndarray, ...],
    sums: tuple[np.ndarray, ...],
) -> tuple[float, float]:
    """Add one RL step to what `Measures` has of each robot.

    Sums run forwards in time, robot by robot, so that nothing else decides their bits. Samples have
    the last period first; the arrays of `Measures` are updated.

    Returns:
        Smallest distance of two robots in m, and time in s in which any touched something.
    """
    period_s, path_periods, since_point = clock
    last_m, last_rad, boxes_m = memory
    path_length_m, rotation_rad, energy_j, regenerated_j = sums
    periods, robots = touching.shape
    least = np.inf
    for i in range(robots):
        for k in range(periods - path_periods + since_point, -1, -path_periods):
            x, y = position[k, i, 0], position[k, i, 1]
            path_length_m[i] += math.sqrt((x - last_m[i, 0]) ** 2 + (y - last_m[i, 1]) ** 2)
            last_m[i, 0], last_m[i, 1] = x, y
            q = quaternion[k, i]
            facing = heading((q[0], q[1], q[2], q[3]))
            rotation_rad[i] += abs(wrapped(facing - last_rad[i]))
            last_rad[i] = facing
        drawn = returned = 0.0
        for k in range(periods - 1, -1, -1):
            for motor in range(voltage.shape[2]):
                power = voltage[k, i, motor] * current[k, i, motor]
                drawn += max(power, 0.0)
                returned += max(-power, 0.0)
        energy_j[i] += drawn * period_s
        regenerated_j[i] += returned * period_s
        left = bottom = np.inf
        right = top = -np.inf
        for k in range(periods):
            left, right = min(left, position[k, i, 0]), max(right, position[k, i, 0])
            bottom, top = min(bottom, position[k, i, 1]), max(top, position[k, i, 1])
        for j in range(i):
            # Between boxes: pairs that are never as close as others before are not looked at.
            dx = max(0.0, left - boxes_m[j, 2], boxes_m[j, 0] - right)
            dy = max(0.0, bottom - boxes_m[j, 3], boxes_m[j, 1] - top)
            if dx * dx + dy * dy >= least:
                continue
            for k in range(periods):
                dx = position[k, i, 0] - position[k, j, 0]
                dy = position[k, i, 1] - position[k, j, 1]
                least = min(least, dx * dx + dy * dy)
        boxes_m[i, 0], boxes_m[i, 1], boxes_m[i, 2], boxes_m[i, 3] = left, bottom, right, top
    touched = 0.0
    for k in range(periods - 1, -1, -1):
        share = 0.0
        for i in range(robots):
            share = max(share, touching[k, i])
        touched += share
    return math.sqrt(least), touched * period_s

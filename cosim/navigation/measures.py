"""What is measured along an episode: path, closeness, energy, contact, from control-period samples.

Accumulated RL step by RL step, so that an episode need not be kept. Outcomes are the episode's
(`cosim.navigation.episode`), statistics over episodes those of `cosim.evaluate`.
"""

import numpy as np

from cosim.coupling.signals import Samples

# Positions this far apart in time make the path length: shorter ones would add up the vibration.
PATH_SAMPLING_S = 0.1


class Measures:
    """Sums and extremes over the samples of one episode of N robots.

    Attributes:
        path_length_m: (N,) path of each robot's centre.
        min_distance_m: smallest distance between the centres of two robots so far, taken every
            control period: within one, robots of some mm/s move by micrometres. Infinite for a
            robot alone. Robots touch at one diameter.
        energy_j: (N,) ∫ max(V i, 0) dt over the motors of each robot. The battery gives what a
            motor draws and gets nothing back: the simple driver of such a robot cannot
            store what a braked motor returns (assumed). V and i are those at the ends of control
            periods: with the default noise, to which the voltage answers within a period, some
            5 % less than at every tick.
        regenerated_j: (N,) ∫ max(−V i, 0) dt, what is lost by that (0.5 % of a driving motor's).
        contact_time_s: time in which any two robots touched.
    """

    def __init__(self, positions_m: np.ndarray, control_period_s: float) -> None:
        """Begin an episode.

        Args:
            positions_m: (N, 2) centres of the robots at its start.
            control_period_s: time between samples.
        """
        n = len(positions_m)
        self.path_length_m = np.zeros(n)
        self.energy_j = np.zeros(n)
        self.regenerated_j = np.zeros(n)
        self.contact_time_s = 0.0
        self._pairs = np.triu_indices(n, 1)
        self._period_s = control_period_s
        self._last_m = positions_m.copy()
        self.min_distance_m = float("inf")
        self._measure_distance(positions_m[None])

    def add(self, samples: Samples) -> None:
        """Take the samples of one RL step."""
        positions = samples.position[:, :, :2]
        every = max(1, round(PATH_SAMPLING_S / self._period_s))
        path = np.concatenate([self._last_m[None], positions[every - 1 :: every]])
        self.path_length_m += np.linalg.norm(np.diff(path, axis=0), axis=2).sum(axis=0)
        self._last_m = path[-1].copy()
        self._measure_distance(positions)
        power = samples.voltage * samples.current
        drawn = np.maximum(power, 0.0)
        self.energy_j += drawn.sum(axis=(0, 2)) * self._period_s
        self.regenerated_j += (drawn - power).sum(axis=(0, 2)) * self._period_s
        touched = samples.touching_share.max(axis=1, initial=0.0).sum()
        self.contact_time_s += float(touched) * self._period_s

    def _measure_distance(self, positions: np.ndarray) -> None:
        first, second = self._pairs
        apart = positions[:, first] - positions[:, second]
        squared = (apart**2).sum(axis=2).min(initial=np.inf)
        self.min_distance_m = min(self.min_distance_m, float(np.sqrt(squared)))

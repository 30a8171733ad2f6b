"""Moving parts of the 3D view of an episode: robots, eccentric masses, forces, tracks and plans.

What stands still is `cosim.recording.scene`; signals over time are `cosim.recording.series`.
"""

import numpy as np
import rerun as rr

from cosim.coupling.rl_step import Step
from cosim.model.config import CoSimConfig
from cosim.onboard.features import DIRECTION_COUNT
from cosim.physics.forces import motor_mounts
from cosim.recording.file import Sink, simulated
from cosim.recording.levels import Detail, periods
from cosim.recording.scene import shaft_end_m
from cosim.recording.stretch import Stretch

_TRAIL_PERIOD_S = 0.5  # between the points of a trail
_TRAIL_PIECE_S = 2.0  # of a trail in a row; the view shows those of late, see the blueprint
# The weight on a foot makes an arrow of 1 cm; a foot that lands would leave the picture.
_METRES_PER_NEWTON = 0.03
_LONGEST_ARROW_M = 0.09
_TRAIL_HEIGHT_M = 0.0005
_VISITED_HEIGHT_M = 0.0001
_PLAN_DIAMETERS = 0.8  # length of the planned direction's arrow
_PLAN_CLEARANCE_M = 0.003


class EpisodeScene:
    """Writes the moving parts of one robot; remembers where it was.

    Args:
        file: recording being written.
        name: of the robot.
        robot: its index.
        cell_m: edge of the board's cells.
        config: geometry and clock.
        detail: rates.
    """

    def __init__(
        self, file: Sink, name: str, robot: int, cell_m: float, config: CoSimConfig, detail: Detail
    ) -> None:
        self._file, self._path, self._robot = file, f"/world/{name}", robot
        self._cell_m, self._config, self._detail = cell_m, config, detail
        timing = config.timing
        self._pose_periods = periods(detail.pose_s, timing.control_period_s, timing.rl_step_s)
        self._last = np.zeros((0, 3))  # point of the trail
        self._visited: set[tuple[int, int]] = set()

    def write(self, steps: list[Step], sampled: Stretch) -> None:
        """Write consecutive RL steps.

        Args:
            steps: the steps.
            sampled: their samples.
        """
        if len(sampled.time_s):
            self._write_body(sampled)
            self._write_masses(sampled)
            self._write_track(sampled)
            self._write_plan([step for step in steps if len(step.samples.omega)])

    def _write_body(self, sampled: Stretch) -> None:
        every, base = self._pose_periods, f"{self._path}/robot"
        ends = sampled.ends(every)
        times = simulated(sampled.time_s[ends])
        # Rerun wants (x, y, z, w).
        quaternion = np.roll(sampled.quaternion[ends, self._robot], -1, axis=1)
        pose = rr.Transform3D.columns(
            translation=sampled.position[ends, self._robot], quaternion=quaternion
        )
        self._file.columns(base, times, pose)
        normal = sampled.rows(lambda s: s.normal_mean[:, self._robot], every, "max")
        arrows = np.zeros((*normal.shape, 3))
        arrows[:, :, 2] = np.minimum(_METRES_PER_NEWTON * normal, _LONGEST_ARROW_M)
        forces = rr.Arrows3D.columns(vectors=arrows.reshape(-1, 3))
        forces = forces.partition([normal.shape[1]] * len(normal))
        self._file.columns(f"{base}/contact", times, forces)

    def _write_masses(self, sampled: Stretch) -> None:
        """Eccentric masses with the poses, and at every control period of the bursts."""
        burst = round(self._detail.burst_s / self._config.timing.control_period_s)
        rows = np.union1d(sampled.ends(self._pose_periods), sampled.bursts(burst))
        theta = sampled.theta[rows, self._robot]
        mounts = motor_mounts(self._config.robot, self._config.motor)
        masses = np.empty((len(rows), len(mounts), 3))
        for motor, mount in enumerate(mounts):
            masses[:, motor, 0] = -mount.r * mount.sin_phi * np.sin(theta[:, motor])
            masses[:, motor, 1] = shaft_end_m(self._config.robot, mount.sin_phi)
            masses[:, motor, 2] = mount.z - mount.r * np.cos(theta[:, motor])
        points = rr.Points3D.columns(positions=masses.reshape(-1, 3))
        points = points.partition([len(mounts)] * len(rows))
        times = simulated(sampled.time_s[rows])
        self._file.columns(f"{self._path}/robot/motors/masses", times, points)

    def _write_track(self, sampled: Stretch) -> None:
        """Write pieces of the trail, and cells when they are first visited.

        Rows hold what is new, so that a recording grows with the time and not with its square.
        """
        ends = sampled.ends(round(_TRAIL_PERIOD_S / self._config.timing.control_period_s))
        time_s, points = sampled.time_s[ends], sampled.position[ends, self._robot]
        start = self._last if len(self._last) else sampled.position[:1, self._robot]
        track, self._last = np.vstack([start, points]), points[-1:]
        line, count = track * (1.0, 1.0, 0.0) + (0.0, 0.0, _TRAIL_HEIGHT_M), len(points)
        each = round(_TRAIL_PIECE_S / _TRAIL_PERIOD_S)
        pieces = [line[k : k + each + 1] for k in range(0, count, each)]
        times = simulated(time_s[[min(k + each, count) - 1 for k in range(0, count, each)]])
        self._file.columns(f"{self._path}/trail", times, rr.LineStrips3D.columns(strips=pieces))
        new = []
        for row, (x, y) in enumerate(np.floor(track[:, :2] / self._cell_m).astype(int).tolist()):
            if (x, y) not in self._visited:
                self._visited.add((x, y))
                new.append((max(row - 1, 0), x, y))
        if new:
            rows, *cells = np.array(new).T
            x, y = (np.stack(cells) + 0.5) * self._cell_m
            half_size = self._cell_m / 2.0, self._cell_m / 2.0, 0.0001
            boxes = rr.Boxes3D.columns(
                centers=np.column_stack([x, y, np.full(len(new), _VISITED_HEIGHT_M)]),
                half_sizes=[half_size] * len(new),  # in each row, as a view of many rows needs it
            )
            self._file.columns(f"{self._path}/visited", simulated(time_s[rows]), boxes)

    def _write_plan(self, steps: list[Step]) -> None:
        """The commanded direction over the robot; nothing once it has arrived."""
        robot = self._config.robot
        action = np.array([step.action[self._robot] for step in steps])
        origins = np.array([step.samples.position[0, self._robot] for step in steps])
        origins[:, 2] = robot.height_m + _PLAN_CLEARANCE_M
        angle = action * 2.0 * np.pi / DIRECTION_COUNT
        length = _PLAN_DIAMETERS * robot.diameter_m
        vectors = length * np.column_stack([np.cos(angle), np.sin(angle), np.zeros(len(angle))])
        moving = action >= 0
        arrows = rr.Arrows3D.columns(origins=origins[moving], vectors=vectors[moving])
        times = simulated(np.array([step.first_tick for step in steps]) * self._config.timing.dt_s)
        self._file.columns(f"{self._path}/plan", times, arrows.partition(moving.astype(int)))

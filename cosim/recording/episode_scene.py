"""Moving parts of the 3D view of an episode: robots, eccentric masses, forces, tracks and plans.

What stands still is `cosim.recording.scene`; signals over time are `cosim.recording.series`.
"""

import numpy as np
import rerun as rr

from cosim.coupling.rl_step import Step
from cosim.model.config import CoSimConfig
from cosim.model.scenario import Scenario
from cosim.onboard.features import DIRECTION_COUNT
from cosim.physics.forces import motor_mounts
from cosim.recording.file import Sink, simulated
from cosim.recording.levels import Detail, periods
from cosim.recording.scene import shaft_end_m
from cosim.recording.stretch import Stretch

TRAIL_PERIOD_S = 0.5
LONGEST_TRAIL_S = 600.0  # every RL step records all of it
_TRAIL_POINTS = round(LONGEST_TRAIL_S / TRAIL_PERIOD_S)
# The weight on a foot makes an arrow of 1 cm; a foot that lands would leave the picture.
_METRES_PER_NEWTON = 0.03
_LONGEST_ARROW_M = 0.09
_TRAIL_HEIGHT_M = 0.0005
_VISITED_HEIGHT_M = 0.0001
_PLAN_DIAMETERS = 0.8  # length of the planned direction's arrow
_PLAN_CLEARANCE_M = 0.003


class EpisodeScene:
    """Writes the moving parts of one robot; remembers its track.

    Args:
        file: recording being written.
        name: of the robot.
        robot: its index.
        scenario: the board.
        config: geometry and clock.
        detail: rates.
    """

    def __init__(
        self,
        file: Sink,
        name: str,
        robot: int,
        scenario: Scenario,
        config: CoSimConfig,
        detail: Detail,
    ) -> None:
        self._file, self._name, self._robot = file, name, robot
        self._scenario, self._config, self._detail = scenario, config, detail
        timing = config.timing
        self._pose_periods = periods(detail.pose_s, timing.control_period_s, timing.rl_step_s)
        self._trail = np.zeros((0, 3))
        self._visited: dict[tuple[int, int], None] = {}  # in the order of the first visit

    def write(self, steps: list[Step], sampled: Stretch) -> None:
        """Write consecutive RL steps.

        Args:
            steps: the steps.
            sampled: their samples.
        """
        if len(sampled.time_s):
            self._write_body(sampled)
            self._write_masses(sampled)
        self._write_track(steps)
        self._write_plan(steps)

    def _write_body(self, sampled: Stretch) -> None:
        every, base = self._pose_periods, f"/world/{self._name}/robot"
        times, last = sampled.times(every), sampled.last(every)
        # Rerun wants (x, y, z, w).
        quaternion = np.roll(last.quaternion[:, self._robot], -1, axis=1)
        pose = rr.Transform3D.columns(
            translation=last.position[:, self._robot], quaternion=quaternion
        )
        self._file.columns(base, times, pose)
        normal = sampled.reduced(lambda s: s.normal_mean[:, [self._robot]], every, "max")[:, 0]
        arrows = np.zeros((*normal.shape, 3))
        arrows[:, :, 2] = np.minimum(_METRES_PER_NEWTON * normal, _LONGEST_ARROW_M)
        forces = rr.Arrows3D.columns(vectors=arrows.reshape(-1, 3))
        forces = forces.partition([normal.shape[1]] * len(normal))
        self._file.columns(f"{base}/contact", times, forces)

    def _write_masses(self, sampled: Stretch) -> None:
        """Eccentric masses with the poses, and at every control period of the bursts."""
        burst = round(self._detail.burst_s / self._config.timing.control_period_s)
        rows = np.union1d(sampled.ends(self._pose_periods), sampled.bursts(burst))
        theta = sampled.at(rows).theta[:, self._robot]
        mounts = motor_mounts(self._config.robot, self._config.motor)
        masses = np.empty((len(rows), len(mounts), 3))
        for motor, mount in enumerate(mounts):
            masses[:, motor, 0] = -mount.r * mount.sin_phi * np.sin(theta[:, motor])
            masses[:, motor, 1] = shaft_end_m(self._config.robot, mount.sin_phi)
            masses[:, motor, 2] = mount.z - mount.r * np.cos(theta[:, motor])
        points = rr.Points3D.columns(positions=masses.reshape(-1, 3))
        points = points.partition([len(mounts)] * len(rows))
        self._file.columns(
            f"/world/{self._name}/robot/motors/masses", simulated(sampled.time_s[rows]), points
        )

    def _write_track(self, steps: list[Step]) -> None:
        """The trail of late and the cells visited so far, at the end of each RL step."""
        timing, cell = self._config.timing, self._scenario.cell_m
        every = round(TRAIL_PERIOD_S / timing.control_period_s)
        ends, trails, visited_ends, visited = [], [], [], []
        for step in steps:
            end_s = step.first_tick * timing.dt_s
            end_s += len(step.samples.omega) * timing.control_period_s
            if len(step.samples.omega):
                track = step.samples.position[::every, self._robot].copy()
                track[:, 2] = _TRAIL_HEIGHT_M
                self._trail = np.vstack([self._trail, track])[-_TRAIL_POINTS:]
                ends.append(end_s)
                trails.append(self._trail)
            known = len(self._visited)
            for position in step.samples.position[::every, self._robot]:
                x, y = np.floor(position[:2] / cell).astype(int).tolist()
                self._visited.setdefault((x, y))
            if len(self._visited) > known:
                centres = (np.array(list(self._visited)) + 0.5) * cell
                visited_ends.append(end_s)
                visited.append(np.insert(centres, 2, _VISITED_HEIGHT_M, axis=1))
        if ends:
            line = rr.LineStrips3D.columns(strips=trails)
            self._file.columns(f"/world/{self._name}/trail", simulated(np.array(ends)), line)
        if visited:
            boxes = rr.Boxes3D.columns(centers=np.concatenate(visited))
            boxes = boxes.partition([len(centres) for centres in visited])
            times = simulated(np.array(visited_ends))
            self._file.columns(f"/world/{self._name}/visited", times, boxes)

    def _write_plan(self, steps: list[Step]) -> None:
        """The commanded direction over the robot; nothing once it has arrived."""
        robot = self._config.robot
        steps = [step for step in steps if len(step.samples.omega)]
        if not steps:
            return
        action = np.array([step.action[self._robot] for step in steps])
        origins = np.array([step.samples.position[0, self._robot] for step in steps])
        origins[:, 2] = robot.height_m + _PLAN_CLEARANCE_M
        angle = action * 2.0 * np.pi / DIRECTION_COUNT
        length = _PLAN_DIAMETERS * robot.diameter_m
        vectors = length * np.column_stack([np.cos(angle), np.sin(angle), np.zeros(len(angle))])
        moving = action >= 0
        arrows = rr.Arrows3D.columns(origins=origins[moving], vectors=vectors[moving])
        times = np.array([step.first_tick for step in steps]) * self._config.timing.dt_s
        self._file.columns(
            f"/world/{self._name}/plan", simulated(times), arrows.partition(moving.astype(int))
        )

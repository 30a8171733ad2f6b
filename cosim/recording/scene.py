"""The 3D view of an episode and the styles of its signals: board, robots, policies, tracks, plans.

How the maps of a policy come out of a robot's table is the agent's; here they are tiles and arrows.
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import rerun as rr
from matplotlib import colormaps

from cosim.base.colours import robot_rgba
from cosim.coupling.rl_step import Step
from cosim.model.config import CoSimConfig
from cosim.model.params import RobotParams, motors_of
from cosim.model.scenario import Scenario
from cosim.model.world import Patch
from cosim.onboard.features import DIRECTION_COUNT, DIRECTIONS
from cosim.physics.contact.elastic import axis_of
from cosim.physics.feet import foot_positions
from cosim.physics.forces import directions
from cosim.recording.file import Kept, simulated
from cosim.recording.series import (
    EIGHT,
    GREY,
    INK,
    LIGHT,
    OUTCOME,
    OUTCOMES,
    REWARD_PARTS,
    STATES,
    WHITE,
    Detail,
    PolicyMap,
    SignalSpec,
    Stretch,
    in_eight,
    periods,
    robot_names,
    tints,
)

ICE, ROUGH = 0x7FAAC4FF, 0xA08060FF  # floor with less and more friction than the rest
SWARM = "/world/swarm"  # entity of all robots where not all are sampled
_WALL_HEIGHT_M = 0.015  # a third of a robot, which is seen behind it
_PATCH_HEIGHT_M = -0.0008  # under the policy's tiles
_TILE_HEIGHT_M = -0.0004  # under the lines between cells, above nothing
_ARROW_HEIGHT_M = 0.0008
_ARROW_CELLS = 0.8
_TRAIL_PERIOD_S = 0.5  # between the points of a trail
_TRAIL_PIECE_S = 2.0  # of a trail in a row; the view shows those of late, see the blueprint
ENLARGED = 10.0  # deflections of legs in the picture: they are fractions of a millimetre
# The weight on a foot makes an arrow of 1 cm; a foot that lands would leave the picture.
_METRES_PER_NEWTON = 0.03
_LONGEST_ARROW_M = 0.09
_TRAIL_HEIGHT_M = 0.0005
_VISITED_HEIGHT_M = 0.0001
_PLAN_DIAMETERS = 0.8  # length of the planned direction's arrow
_PLAN_CLEARANCE_M = 0.003
_LUMA = np.array([0.299, 0.587, 0.114])  # of red, green and blue, ITU-R BT.601


def _upright_to(axis: tuple[float, float, float]) -> rr.RotationAxisAngle:
    """Return the rotation of a cylinder along z to an axis."""
    x, y, z = axis
    about = (-y, x, 0.0) if x or y else (1.0, 0.0, 0.0)
    return rr.RotationAxisAngle(about, radians=math.acos(z))


def palette(colours: list[int]) -> np.ndarray:
    """Colours as Rerun takes them without doubt, 0xRRGGBBAA."""
    return np.array(colours, dtype=np.uint32)


def write_scene(
    file: Kept,
    scenario: Scenario,
    robot: RobotParams,
    patches: Sequence[Patch],
    sampled: Sequence[int],
) -> None:
    """Log everything that does not move: board, zone, targets, and robots in their own frames.

    `sampled` has the indices of the robots with recorded signals; the others are drawn as bodies.
    """
    width, height = scenario.size_m
    cell = scenario.cell_m
    lines = [[(x * cell, 0, 0), (x * cell, height, 0)] for x in range(scenario.columns + 1)]
    lines += [[(0, y * cell, 0), (width, y * cell, 0)] for y in range(scenario.rows + 1)]
    file.static("/world", rr.ViewCoordinates.RIGHT_HAND_Z_UP)
    file.static("/world/board", rr.LineStrips3D(lines, colors=LIGHT, radii=0.0001))
    left, bottom, right, top = scenario.zone
    zone = np.array([left, bottom, right + 1, top + 1]) * cell
    outline = [(zone[x], zone[y], 0.0) for x, y in ((0, 1), (2, 1), (2, 3), (0, 3), (0, 1))]
    file.static("/world/zone", rr.LineStrips3D([outline], colors=palette([GREY]), radii=0.0006))
    if scenario.obstacles:
        walls = scenario.walls.reshape(-1, 2, 2) * cell
        heights = np.full((len(walls), 1), _WALL_HEIGHT_M / 2.0)
        halves = np.hstack([(walls[:, 1] - walls[:, 0]) / 2.0, heights])
        _write_boxes(file, "obstacles", np.hstack([walls.mean(axis=1), heights]), halves, INK)
    if patches:
        corners = cell * (np.array([patch.cells for patch in patches]) + np.array([0, 0, 1, 1]))
        centres = np.insert((corners[:, :2] + corners[:, 2:]) / 2.0, 2, _PATCH_HEIGHT_M, axis=1)
        halves = np.insert((corners[:, 2:] - corners[:, :2]) / 2.0, 2, 0.0001, axis=1)
        colours = palette([ICE if patch.mu < robot.mu else ROUGH for patch in patches])
        labels = [f"µ {patch.mu:g}" for patch in patches]
        _write_boxes(file, "patches", centres, halves, colours, labels=labels, show_labels=True)
    all_sampled = len(sampled) == scenario.robots
    colours = [robot_rgba(robot) for robot in range(scenario.robots)]
    if not all_sampled:
        of_sampled = {index: robot_rgba(k) for k, index in enumerate(sampled)}
        colours = [of_sampled.get(index, GREY) for index in range(scenario.robots)]
        file.static(SWARM, _disc(robot))
    names, half = robot_names(sampled), cell / 2.0
    labels = [f"target {name}" for name in names] if all_sampled else None
    centres = [(*scenario.centre_m(target), 0.0) for target in scenario.targets]
    halves = [(half, half, 0.0002)] * scenario.robots
    _write_boxes(file, "targets", centres, halves, palette(colours), labels=labels)
    for name, index in zip(names, sampled, strict=True):
        colour = colours[index]
        centres = [(*scenario.centre_m(start), -0.0002) for start in scenario.starts[index]]
        halves = [(half, half, 0.0001)] * len(centres)
        _write_boxes(file, f"starts/{name}", centres, halves, faint(colour))
        _write_robot(file, name, colour, robot)


def _write_boxes(
    file: Kept, name: str, centres: Any, half_sizes: Any, colours: Any, **labels: Any
) -> None:
    boxes = rr.Boxes3D(
        centers=centres, half_sizes=half_sizes, colors=colours, fill_mode="solid", **labels
    )
    file.static(f"/world/{name}", boxes)


def _disc(robot: RobotParams) -> rr.Mesh3D:
    """The top of a robot, notched at its front; drawn once for each robot of a swarm."""
    angle, top = np.radians(np.arange(15, 376, 30)), robot.height_m - robot.com_height_m
    rim = robot.diameter_m / 2.0 * np.column_stack([np.cos(angle), np.sin(angle)])[:-1]
    k = np.arange(1, len(rim))
    return rr.Mesh3D(
        vertex_positions=np.insert(np.vstack([(0.0, 0.0), rim]), 2, top, axis=1),
        triangle_indices=np.column_stack([np.zeros_like(k), k, k + 1]),
        albedo_factor=GREY,
    )


def shades(colour: int, count: int) -> np.ndarray:
    """Return a robot's colour 0xRRGGBBAA and lighter ones, of several components."""
    rgb = np.array([colour >> shift & 0xFF for shift in (24, 16, 8)])
    mixed = [np.round(rgb + tint * (255 - rgb)).astype(int) for tint in tints(count)]
    return palette([(r << 24) + (g << 16) + (b << 8) + 0xFF for r, g, b in mixed])


def faint(colour: int) -> int:
    """A colour at a quarter of its opacity."""
    return (colour & 0xFFFFFF00) | 0x40


def _write_robot(file: Kept, name: str, colour: int, robot: RobotParams) -> None:
    base = f"/world/{name}/robot"
    middle = robot.height_m / 2.0 - robot.com_height_m
    file.static(
        f"{base}/body",
        rr.Cylinders3D(
            lengths=[robot.height_m],
            radii=[robot.diameter_m / 2.0],
            centers=[(0.0, 0.0, middle)],
            colors=[colour],
            fill_mode="transparentfillmajorwireframe",
            labels=[name],
        ),
    )
    feet = foot_positions(robot)
    file.static(f"{base}/feet", rr.Points3D(feet, radii=0.001, colors=INK))
    mounts = robot.motors
    down = np.array([0.0, 0.0, robot.com_height_m])
    file.static(
        f"{base}/motors",
        rr.Cylinders3D(
            lengths=[robot.motor_length_m] * len(mounts),
            radii=[robot.motor_diameter_m / 2.0] * len(mounts),
            centers=[np.array(mount.place_m) - down for mount in mounts],
            rotation_axis_angles=[_upright_to(mount.axis) for mount in mounts],
            colors=INK,
            fill_mode="solid",
        ),
    )
    masses = rr.Points3D.from_fields(
        colors=shades(colour, len(mounts)), radii=[0.001] * len(mounts)
    )
    file.static(f"{base}/motors/masses", masses)
    top, front = robot.height_m - robot.com_height_m, robot.diameter_m / 2.0
    heading = rr.Arrows3D(
        origins=[(0.0, 0.0, top)], vectors=[(front, 0.0, 0.0)], colors=colour, radii=0.001
    )
    file.static(f"{base}/heading", heading)
    forces = rr.Arrows3D.from_fields(
        origins=feet, colors=shades(colour, len(feet)), radii=[0.0005] * len(feet)
    )
    file.static(f"{base}/contact", forces)
    if robot.elastic:
        shape = rr.LineStrips3D.from_fields(
            colors=palette([INK] * len(feet)), radii=[0.0003] * len(feet)
        )
        file.static(f"{base}/legs", shape)
    trail = rr.LineStrips3D.from_fields(colors=[colour], radii=[0.0006])
    file.static(f"/world/{name}/trail", trail)
    visited = rr.Boxes3D.from_fields(colors=[faint(colour)], fill_mode="solid")
    file.static(f"/world/{name}/visited", visited)
    file.static(f"/world/{name}/plan", rr.Arrows3D.from_fields(colors=[WHITE], radii=[0.0012]))


def bent_legs(robot: RobotParams, deflections: np.ndarray) -> np.ndarray:
    """Lines along bent legs, (n, M, 5, 3) in the frame of the body, m; deflections are enlarged.

    A cantilever that is loaded at its tip: (3 s² − s³)/2 of the deflection at a share s of it.

    Args:
        deflections: (n, 3 M) of the tips, x, y and z of each, m.
    """
    share = np.linspace(0.0, 1.0, 5)[:, None]
    along = np.array([
        (1.0 - share) * foot.leg.length_m * np.array(axis_of(foot.leg))
        for foot in robot.feet if foot.leg
    ])  # fmt: skip
    straight = foot_positions(robot)[:, None] - along
    bend = ENLARGED * deflections.reshape(len(deflections), -1, 1, 3)
    return straight + 0.5 * share**2 * (3.0 - share) * bend


def map_colours(values: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Colours (columns, rows, 3) uint8 from the least to the greatest known value; black else."""
    low, high = (values[known].min(), values[known].max()) if known.any() else (0.0, 1.0)
    scaled = (values - low) / max(high - low, 1e-12)
    colours = colormaps["viridis"](scaled, bytes=True)[..., :3]
    colours[~known] = 0
    return colours


def ink_on(colours: np.ndarray) -> np.ndarray:
    """Return the colour (n,) of lines that are seen on colours (n, 3) uint8: dark or white."""
    return np.where(colours @ _LUMA > 110.0, INK, WHITE).astype(np.uint32)


def unit_arrows(action: np.ndarray) -> np.ndarray:
    """Directions as unit vectors (..., 2), x to the right and y up."""
    steps = DIRECTIONS[action].astype(np.float64)
    return steps / np.linalg.norm(steps, axis=-1, keepdims=True)


def write_floor(file: Kept, name: str, scenario: Scenario, policy: PolicyMap) -> None:
    """Log a robot's policy at `/world/<name>/policy`: a tile and an arrow per cell it visited."""
    known = policy.visits > 0
    cells = np.argwhere(known)
    corners = np.array([(0, 0), (1, 0), (1, 1), (0, 1)])
    tiles = (cells[:, None] + corners).reshape(-1, 2) * scenario.cell_m
    first = 4 * np.arange(len(cells))[:, None, None]
    colours = map_colours(policy.value, known)[known]
    file.static(
        f"/world/{name}/policy/value",
        rr.Mesh3D(
            vertex_positions=np.column_stack([tiles, np.full(len(tiles), _TILE_HEIGHT_M)]),
            triangle_indices=(first + np.array([(0, 1, 2), (0, 2, 3)])).reshape(-1, 3),
            vertex_colors=colours.repeat(len(corners), axis=0),
        ),
    )
    vectors = _ARROW_CELLS * scenario.cell_m * unit_arrows(policy.action[known])
    origins = (cells + 0.5) * scenario.cell_m - vectors / 2.0
    file.static(
        f"/world/{name}/policy/greedy",
        rr.Arrows3D(
            origins=np.column_stack([origins, np.full(len(cells), _ARROW_HEIGHT_M)]),
            vectors=np.column_stack([vectors, np.zeros(len(cells))]),
            colors=ink_on(colours),
            radii=0.0008,
        ),
    )


class RobotScene:
    """Writes the moving parts of one robot; remembers where it was."""

    def __init__(
        self, file: Kept, name: str, robot: int, cell_m: float, config: CoSimConfig, detail: Detail
    ) -> None:
        self._file, self._path, self._robot = file, f"/world/{name}", robot
        self._cell_m, self._config, self._detail = cell_m, config, detail
        timing = config.timing
        self._pose_periods = periods(detail.pose_s, timing.control_period_s, timing.rl_step_s)
        self._last = np.zeros((0, 3))  # point of the trail
        self._visited: set[tuple[int, int]] = set()

    def write(self, steps: list[Step], sampled: Stretch) -> None:
        """Write consecutive RL steps and their samples."""
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
        quaternion = np.roll(sampled.samples.quaternion[ends, self._robot], -1, axis=1)
        pose = rr.Transform3D.columns(
            translation=sampled.samples.position[ends, self._robot], quaternion=quaternion
        )
        self._file.columns(base, times, pose)
        normal = sampled.rows(lambda s: s.normal_mean[:, self._robot], every, "max")
        arrows = np.zeros((*normal.shape, 3))
        arrows[:, :, 2] = np.minimum(_METRES_PER_NEWTON * normal, _LONGEST_ARROW_M)
        forces = rr.Arrows3D.columns(vectors=arrows.reshape(-1, 3))
        forces = forces.partition([normal.shape[1]] * len(normal))
        self._file.columns(f"{base}/contact", times, forces)
        if self._config.robot.elastic:
            lines = bent_legs(self._config.robot, sampled.samples.deflection[ends, self._robot])
            strips = rr.LineStrips3D.columns(strips=lines.reshape(-1, *lines.shape[2:]))
            self._file.columns(
                f"{base}/legs", times, strips.partition([lines.shape[1]] * len(lines))
            )

    def _write_masses(self, sampled: Stretch) -> None:
        """Eccentric masses with the poses, and at every control period of the bursts."""
        burst = round(self._detail.burst_s / self._config.timing.control_period_s)
        rows = np.union1d(sampled.ends(self._pose_periods), sampled.bursts(burst))
        theta = sampled.samples.theta[rows, self._robot]
        robot, motor = self._config.robot, self._config.motor
        mounts, radii = robot.motors, [own.r for own in motors_of(robot, motor)]
        masses = np.empty((len(rows), len(mounts), 3))
        for k, (mount, r, angle) in enumerate(zip(mounts, radii, theta.T, strict=True)):
            hanging, ahead = directions(mount.axis)
            # At the motor's outer end, where it can be seen; the forces act at its middle.
            end = np.array(mount.place_m) + 0.5 * robot.motor_length_m * np.array(mount.axis)
            masses[:, k] = end - (0.0, 0.0, robot.com_height_m)
            masses[:, k] += r * (np.outer(np.cos(angle), hanging) + np.outer(np.sin(angle), ahead))
        points = rr.Points3D.columns(positions=masses.reshape(-1, 3))
        points = points.partition([len(mounts)] * len(rows))
        times = simulated(sampled.time_s[rows])
        self._file.columns(f"{self._path}/robot/motors/masses", times, points)

    def _write_track(self, sampled: Stretch) -> None:
        """Write pieces of the trail, and cells when they are first visited.

        Rows hold what is new, so that a recording grows with the time and not with its square.
        """
        ends = sampled.ends(round(_TRAIL_PERIOD_S / self._config.timing.control_period_s))
        time_s, points = sampled.time_s[ends], sampled.samples.position[ends, self._robot]
        start = self._last if len(self._last) else sampled.samples.position[:1, self._robot]
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


def write_styles(file: Kept, signals: Sequence[SignalSpec], robots: Sequence[int]) -> None:
    """Log names, units, colours and aggregation of every signal and state of some robots."""
    for robot, name in enumerate(robot_names(robots)):
        for signal in signals:
            names, count = signal.names, len(signal.names)
            eight = in_eight(names) and count <= len(EIGHT)
            colours = palette(EIGHT[:count]) if eight else shades(robot_rgba(robot), count)
            set_points = not signal.label and bool(signal.tabs)  # in one plot with the speeds
            file.static(
                signal.entity(name),
                # The default, averaging, would flatten a vibration to nothing.
                rr.SeriesLines(
                    names=names,
                    colors=palette([WHITE] * count) if set_points else colours,
                    widths=[0.5 if set_points else 1.5] * count,
                    aggregation_policy="MinMax",
                    visible_series=[part != REWARD_PARTS[0] for part in names],
                ),
                *([rr.AnyValues(unit=signal.unit)] if signal.unit else []),
            )
        for path, (values, colours) in STATES.items():
            _write_states(file, f"/rl/{name}/{path}", values, colours)
    _write_states(file, OUTCOME, *OUTCOMES)


def _write_states(file: Kept, entity: str, values: Sequence[str], colours: Sequence[int]) -> None:
    states = rr.StateConfiguration(
        values=list(values), labels=list(values), colors=palette(list(colours))
    )
    file.static(entity, states)

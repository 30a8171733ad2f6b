"""Robots far apart on an endless floor: what one robot does, without board, agent or episode.

For calibration and for trials of the steering. Commands are written straight into their
array (layout in `cosim.onboard.steering`); the dynamics, the FMUs and the noise are those of an
episode.
"""

from collections.abc import Callable, Sequence
from typing import TypeVar

import numpy as np

from cosim.coupling.assembly import SpeedNoise, check_motors, new_plant, robot_properties
from cosim.coupling.master import CompiledDriver, FallError, FaultError
from cosim.coupling.signals import (
    RawSamples,
    Samples,
    columns_of,
    new_raw_samples,
    new_samples,
    new_state,
    with_room,
    with_sight,
)
from cosim.fmi.motor import MotorFmu
from cosim.fmi.motors import Motors
from cosim.model.config import CoSimConfig
from cosim.model.params import MotorParams, motors_of
from cosim.onboard.camera import NOISE, camera_of, frames_in_flight
from cosim.onboard.steering import DIRECT, MODE, OMEGA_D
from cosim.physics.body_state import QUATERNION, standing_state
from cosim.physics.draws import draw_world
from cosim.physics.lanes import host_lanes
from cosim.physics.properties import gravity
from cosim.physics.rotation import Vector, headings
from cosim.physics.trig import sines_cosines

# Robots never meet: a trial takes minutes at some mm/s. Coordinates stay small enough for a
# rounding error of a femtometre, which is that of a board.
SPACING_M = 1.0
_CORNER_M = 0.03
FALLEN = 1.0  # in place of the share of time in the air, of a robot that does not stand any more
Result = TypeVar("Result")


class Trial:
    """N robots, each alone, with motors at rest.

    Attributes:
        bodies: (S, N), layout in `cosim.physics.body_state`.
        commands: (N, COMMAND_SIZE), layout in `cosim.onboard.steering`.
        estimates: (N, ESTIMATE_SIZE), layout in `cosim.onboard.estimation`.
        origins_m: (N, 2) where each robot was put.
    """

    def __init__(
        self,
        motor_fmu: MotorFmu,
        config: CoSimConfig,
        headings_rad: np.ndarray,
        seed: np.random.SeedSequence,
        motors: Sequence[tuple[MotorParams, ...]] | None = None,
        gravity: Vector | None = None,
        sight: np.ndarray | None = None,
    ) -> None:
        """Put the robots on the floor.

        Args:
            seed: of the speed noise; every motor gets a child of its own.
            gravity: in the frame of the floor, m/s²; default that of a level one.
            sight: (M, N, NOISE) frames of the world's camera, see `cosim.onboard.camera`; default
                no camera, so that poses are known exactly.
        """
        n, lanes = len(headings_rad), host_lanes()
        columns = columns_of(n, lanes)
        check_motors(motor_fmu, config, n)
        self._config = config
        self._plant = new_plant(config, 1, end_on_collision=False)
        self._tick = 0
        self._sizes = config.robot.sizes
        self._state = new_state(n, 1, columns, self._sizes)
        self._state.bodies.properties[:] = robot_properties(config)[:, None]
        self.origins_m = SPACING_M * np.column_stack([np.arange(1, n + 1), np.ones(n)])
        self._motors = Motors(motor_fmu, config, columns)
        for robot, (x, y) in enumerate(self.origins_m):
            standing = standing_state(config.robot, x, y, headings_rad[robot])
            self._state.bodies.motion[:, robot] = standing
            own = motors[robot] if motors else motors_of(config.robot, config.motor)
            self._state.bodies.properties[:, robot] = robot_properties(config, gravity, own)
            start = self._motors.restart([robot], (own,))
            self._state.motors.outputs[: len(start), [robot]] = start
        self._state.episodes.running[:] = 1
        if sight is not None:
            sensor, room = config.world.camera, np.zeros((len(sight), columns, NOISE))
            self._state = with_room(self._state, frames=frames_in_flight(sensor))
            self._state = with_sight(self._state, room)
            self._state.onboard.cameras[:n] = camera_of(sensor, config.timing.control_period_s)
            self._state.onboard.sight[:, :n] = sight
        self.estimates = self._state.onboard.estimates[:n]
        self.bodies, self.commands = (
            self._state.bodies.motion[:, :n],
            self._state.onboard.commands[:n],
        )
        self._noise = SpeedNoise(config, seed, n)
        self._driver = CompiledDriver(self._motors, lanes)

    def __enter__(self) -> "Trial":
        return self

    def __exit__(self, *_: object) -> None:
        self._motors.close()

    @property
    def poses(self) -> np.ndarray:
        """Positions and quaternions now, (N, 7)."""
        return self.bodies[: QUATERNION.stop].T.copy()

    @property
    def omega(self) -> np.ndarray:
        """Motor speeds now in rad/s, (N, M)."""
        motors = self._sizes[0]
        return self._state.motors.outputs[motors : 2 * motors, : len(self.origins_m)].T.copy()

    @property
    def time_s(self) -> float:
        """Simulated time in s."""
        return self._tick * self._config.timing.dt_s

    def lay(self, patches: np.ndarray) -> None:
        """Put a floor of its own under each robot: (N, P, 5), see `Floor.patches`."""
        self._state = with_room(self._state, patches=patches.shape[1])
        self._state.floor.patches[: len(patches)] = patches

    def ticks(self, count: int) -> RawSamples:
        """Return room for the signals of `count` ticks, see `advance`."""
        return new_raw_samples(count, self._state.bodies.motion.shape[1], self._sizes)

    def set_motors(self, set_points: np.ndarray) -> None:
        """Command set points of the motors in rad/s, (N, M), or (M,) for all robots."""
        self.commands[:, MODE] = DIRECT
        self.commands[:, OMEGA_D : OMEGA_D + self._sizes[0]] = set_points

    def advance(self, periods: int, ticks: RawSamples | None = None) -> Samples:
        """Simulate some control periods, and return the samples at their ends.

        A robot that stops before, because it does not stand any more, is a FaultError: the rest of
        its samples would be zeros.

        Args:
            ticks: room for the first ticks, of all columns.
        """
        n, columns = len(self.origins_m), self._state.bodies.motion.shape[1]
        samples = new_samples(periods, columns, self._sizes)
        noise = np.zeros((periods, columns, self._sizes[0]))
        noise[:, :n] = self._noise.draw(periods)
        raw = new_raw_samples(0, columns, self._sizes) if ticks is None else ticks
        try:
            self._driver.advance(self._plant, self._state, noise, samples, raw)
        except FaultError as error:
            name = f"robot {error.column + 1} of a trial"
            end_s = self.time_s + error.ticks * self._config.timing.dt_s
            raise error.locate(name, end_s, self._config.preset) from None
        self._tick += periods * self._config.ticks_per_period
        return Samples(*(signal[:, :n] for signal in samples))


def without_falls(
    drive: Callable[[np.ndarray], Result], set_points: np.ndarray
) -> tuple[Result, list[FallError]]:
    """Drive robots at their set points (N, M); those that fall stand, and the others drive again.

    Returns:
        What `drive` returns, and the falls.
    """
    falls: list[FallError] = []
    while True:
        driven = set_points.copy()
        driven[[error.column for error in falls]] = 0.0
        try:
            return drive(driven), falls
        except FallError as error:  # the others drive again, with the same noise
            if not driven[error.column].any():
                raise
            falls.append(error)


def trial_in_world(
    motor_fmu: MotorFmu,
    config: CoSimConfig,
    headings_rad: np.ndarray,
    seed: np.random.SeedSequence,
    sight: np.ndarray | None = None,
) -> Trial:
    """Return a trial with motors and slope drawn from the configuration's world."""
    motors = motors_of(config.robot, config.motor)
    drawn = draw_world(config.world, motors, len(headings_rad), seed)
    slope = gravity(config.world.floor_tilt_deg, drawn.tilt_direction_deg, config.motor.g)
    return Trial(motor_fmu, config, headings_rad, seed, drawn.motors, slope, sight)


def corners(config: CoSimConfig, origins_m: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return a floor (N, P, 5) of its own for each robot, see `Floor.patches`.

    Where the world has patches, four of their friction coefficients meet at a corner under the
    robot's feet, or close to them; the extremes are as frequent as all others together.
    """
    floors = [config.robot.mu, *(patch.mu for patch in config.world.mu_patches)]
    if len(floors) == 1:
        return np.empty((len(origins_m), 0, 5))
    pool = [*floors, *(len(floors) // 2 * [min(floors), max(floors)])]
    patches = np.empty((len(origins_m), 4, 5))
    x, y = (origins_m + rng.uniform(-_CORNER_M, _CORNER_M, origins_m.shape)).T
    far = np.full(len(x), np.inf)
    quadrants = (-far, -far, x, y), (x, -far, far, y), (-far, y, x, far), (x, y, far, far)
    patches[:, :, :4] = np.array(quadrants).transpose(2, 0, 1)
    patches[:, :, 4] = rng.choice(pool, (len(x), 4))
    return patches


def mean_motion(before: np.ndarray, samples: Sequence[Samples], period_s: float) -> np.ndarray:
    """Return mean speeds ahead and to the left in m/s and mean yaw rates in rad/s, (N, 3).

    Args:
        before: (N, 7) positions and quaternions at the start, as in `Trial.poses`.
        samples: of control periods, in order.
    """
    track = [np.concatenate([part.position, part.quaternion], axis=2) for part in samples]
    poses = np.concatenate([before[None], *track])
    angles = heading_angles(poses[:, :, QUATERNION])
    moved, middle = np.diff(poses[:, :, :2], axis=0), 0.5 * (angles[1:] + angles[:-1])
    s, c = sines_cosines(middle)
    ahead = (c * moved[..., 0] + s * moved[..., 1]).sum(axis=0)
    left = (c * moved[..., 1] - s * moved[..., 0]).sum(axis=0)
    return np.column_stack([ahead, left, angles[-1] - angles[0]]) / (len(moved) * period_s)


def heading_angles(quaternions: np.ndarray) -> np.ndarray:
    """Heading in rad, continuous along the first axis, of quaternions (n, …, 4) as (w, x, y, z)."""
    return np.unwrap(headings(quaternions), axis=0)

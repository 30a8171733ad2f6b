"""Identified parameters, and simulations of a drive with many sets of them at once.

The equations of motion are those of `cosim.physics`; every robot has a lane of a vector, and in it
a mass, feet and motors of its own.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from cosim.base.jit import inlined, kernel
from cosim.coupling.assembly import Motors, SpeedNoise
from cosim.fmi.motor import MotorFmu
from cosim.model.config import CoSimConfig
from cosim.model.params import TABLE_I, TABLE_II, MotorParams, RobotParams
from cosim.physics.body import stepped
from cosim.physics.body_state import (
    X,
    Y,
    orientation_of,
    read_body,
    standing_state,
    state_size,
    write_body,
)
from cosim.physics.forces import MotorMount, motor_mounts, motor_wrenches
from cosim.physics.lanes import Width, host_lanes, load, width_of
from cosim.physics.properties import (
    CENTRE,
    BodyParams,
    body_params,
    properties_of,
    properties_size,
    read_mounts,
    read_params,
)
from cosim.physics.rotation import heading, rotation_matrix

LOOKS_S = 0.005  # between simulated poses, which are interpolated
REPEATS, WINDOW_S = 8, 5.0  # of simulations with other noise, and over which they drift apart
# Rows of the shapes, in m: feet A (x, y, z) and B (x), motor D (y, z); the others are mirrored.
_A, _B, _D = 0, 3, 4
_SHAPE = 6


class RobotParameter(NamedTuple):
    """A parameter that is identified."""

    name: str
    description: str
    # unit, scale: for people, and how many of it are one of the SI unit
    unit: str
    scale: float
    # Standard deviation around the usual value before anything is measured (assumed), in SI units
    # as what follows
    spread: float
    step: float  # of its difference quotients
    # low, high: bounds; the circle of the feet is within the robot too
    low: float
    high: float


PARAMETERS = (
    RobotParameter("mu", "friction of the feet", "", 1.0, 0.15, 0.004, 0.02, 1.0),
    RobotParameter(
        "com_height_m", "height of the centre of mass", "mm", 1e3, 0.01, 4e-4, 0.004, 0.04
    ),
    RobotParameter(
        "com_x_m", "centre of mass before the axis", "mm", 1e3, 0.003, 2e-4, -0.006, 0.006
    ),
    RobotParameter("com_y_m", "centre of mass to the left", "mm", 1e3, 0.003, 2e-4, -0.006, 0.006),
    RobotParameter("foot_radius_m", "circle of the feet", "mm", 1e3, 0.003, 3e-4, 0.005, 0.1),
    RobotParameter(
        "motor_d", "unbalance of motor 1 (D) over its usual one", "", 1.0, 0.3, 0.01, 0.4, 2
    ),
    RobotParameter(
        "motor_e", "unbalance of motor 2 (E) over its usual one", "", 1.0, 0.3, 0.01, 0.4, 2
    ),
    RobotParameter("camera_delay_s", "delay of the camera", "ms", 1e3, 0.1, 0.03, 0.0, 1.0),
)
NAMES = tuple(parameter.name for parameter in PARAMETERS)
SPREADS, STEPS, _LOW, _HIGH = np.array([p[4:] for p in PARAMETERS], dtype=float).T
_FACTORS = slice(NAMES.index("motor_d"), NAMES.index("camera_delay_s"))
DELAY = NAMES.index("camera_delay_s")


class Machine(NamedTuple):
    """A robot and its motors D and E."""

    robot: RobotParams
    motor_d: MotorParams = TABLE_II
    motor_e: MotorParams = TABLE_II


def usual_values(robot: RobotParams = TABLE_I) -> np.ndarray:
    """Values before anything is measured, shape (8,), SI units; a camera's delay is 30 ms."""
    return np.array([*(getattr(robot, name) for name in NAMES[: _FACTORS.start]), 1.0, 1.0, 0.03])


def machine(
    values: Sequence[float] | np.ndarray,
    robot: RobotParams = TABLE_I,
    motor: MotorParams = TABLE_II,
) -> Machine:
    """The machine that has some values, SI units; all else is as of a robot and a motor."""
    numbers = [float(value) for value in values]
    fields = dict(zip(NAMES[: _FACTORS.start], numbers, strict=False))
    d, e = numbers[_FACTORS]
    return Machine(
        robot._replace(**fields), motor._replace(r=d * motor.r), motor._replace(r=e * motor.r)
    )


@dataclass(frozen=True)
class Simulated:
    """Simulations of one drive.

    Their motors have speed noise of their own: without any, robots near the speed at which they
    begin to move would seem to stand on a more slippery floor.
    """

    speeds: np.ndarray  # (P + 1, 2) of the motors in rad/s, with noise
    smooth: np.ndarray  # (P + 1, 2) the same without
    times: np.ndarray  # (n,) of the frames in s
    config: CoSimConfig  # clock, and what of robot and motors is not identified

    @cached_property
    def usual(self) -> np.ndarray:
        """Values before anything is measured, (8,) in SI units."""
        return usual_values(self.config.robot)

    @cached_property
    def limits(self) -> np.ndarray:
        """Least and largest values, (2, 8) in SI units."""
        limits = np.array([_LOW, _HIGH])
        limits[1, NAMES.index("foot_radius_m")] = 0.499 * self.config.robot.diameter_m
        return limits

    def frames(self, values: np.ndarray) -> np.ndarray:
        """(n, C, 3) m, m and rad seen from the origin, heading along +x, by parameters (C, 8)."""
        machines = [self._machine(row) for row in values]
        distinct = list(dict.fromkeys(machines))  # another delay asks for no simulation of its own
        seen = self._tracks(distinct, self.speeds)
        looks = LOOKS_S * np.arange(len(seen))
        found = np.empty((len(self.times), len(values), 3))
        for column, (own, row) in enumerate(zip(machines, values, strict=True)):
            for k, signal in enumerate(seen[:, distinct.index(own)].T):
                found[:, column, k] = np.interp(self.times - row[DELAY], looks, signal)
        return found

    def drifts(self, values: np.ndarray) -> np.ndarray:
        """Estimate how a robot's noise makes its tracks differ, by simulations with other noise.

        Returns:
            Growth of the variance of the robot's distance from a simulation: of its place, x and y
            each, in m²/s, and of its heading, in rad²/s. Both stray: twice that of one of them.
        """
        noise = self.speeds - self.smooth
        shifts = len(noise) * np.arange(REPEATS) // REPEATS
        others = np.stack([np.roll(noise, shift, axis=0) for shift in shifts], axis=2)
        seen = self._tracks([self._machine(values)] * REPEATS, self.smooth[..., None] + others)
        steps = np.diff(seen[..., 0] + 1j * seen[..., 1], axis=0)
        driven = np.cumsum(steps * np.exp(-1j * seen[:-1, :, 2]), axis=0)  # as the robot sees it
        window = min(round(WINDOW_S / LOOKS_S), len(driven) // 2)
        moved = np.diff(driven[::window], axis=0)
        turned = np.diff(seen[::window, :, 2], axis=0)
        of_place = 0.5 * (moved.real.var(axis=1, ddof=1) + moved.imag.var(axis=1, ddof=1))
        of_heading = turned.var(axis=1, ddof=1)
        return 2.0 * np.array([of_place.mean(), of_heading.mean()]) / (window * LOOKS_S)

    def _machine(self, values: np.ndarray) -> Machine:
        return machine(values, self.config.robot, self.config.motor)

    def _tracks(self, machines: list[Machine], speeds: np.ndarray) -> np.ndarray:
        config = self.config
        every = round(LOOKS_S / config.timing.control_period_s)
        return tracks(machines, speeds, config.ticks_per_period, config.timing.dt_s, every)


def motor_speeds(
    set_points: np.ndarray, fmu: MotorFmu, config: CoSimConfig, seed: np.random.SeedSequence | None
) -> np.ndarray:
    """Speeds (P + 1, 2) of motors D and E in rad/s from their start to the ends of control periods.

    Args:
        set_points: (P, 2) in rad/s, of every control period.
    """
    ticks, dt_s = config.ticks_per_period, config.timing.dt_s
    noise = np.zeros((len(set_points), 1, 2))
    if seed is not None:
        noise = SpeedNoise(config, seed, 1).draw(len(set_points))
    speeds = np.zeros((len(set_points) + 1, 2))
    inputs, outputs = np.zeros((6, 1)), np.zeros((6, 1))
    motors = Motors(fmu, config, 1)
    speeds[0] = motors.restart([0], ((config.motor, config.motor),))[2:, 0]
    try:
        for period, wanted in enumerate(set_points):
            inputs[:4, 0] = *wanted, *(noise[period, 0] * abs(wanted))
            motors.set_inputs(inputs, dt_s)
            motors.step(ticks, dt_s)
            motors.get_outputs(outputs, dt_s)
            speeds[period + 1] = outputs[2:4, 0]
    finally:
        motors.close()
    return speeds


def tracks(
    machines: Sequence[Machine], omega: np.ndarray, ticks: int, dt_s: float, every: int
) -> np.ndarray:
    """Simulate what an overhead camera sees of robots that start at rest, heading along +x.

    Motors turn as prescribed, so that no FMU is stepped: they do not feel the bodies.

    Args:
        machines: B of them, each in a lane of a vector.
        omega: (P + 1, 2) or (P + 1, 2, B) speeds of motors D and E at the ends of control periods
            in rad/s, linear in between; motors start hanging down.
        every: control periods from one look to the next.

    Returns:
        (P // every + 1, B, 3) x and y of the robot's axis in m, and the heading in rad, continuous.
    """
    lanes = host_lanes()
    columns = -(-len(machines) // lanes) * lanes
    padded = [*machines, *[machines[0]] * (columns - len(machines))]
    own = np.zeros((len(omega), 2, columns))
    own[:, :, : len(machines)] = omega.reshape(*omega.shape[:2], -1)
    own[:, :, len(machines) :] = own[:, :, :1]
    bodies, properties = (
        np.zeros((state_size(3), columns)),
        np.zeros((properties_size(3, 2), columns)),
    )
    shapes = np.zeros((_SHAPE, columns))
    for column, (robot, motor_d, motor_e) in enumerate(padded):
        mounts = motor_mounts(robot, (motor_d, motor_e))
        params = body_params(robot, motor_d, dt_s)
        properties[:, column] = properties_of(params, mounts)
        a, _, b = params.contact.feet
        shapes[:, column] = *a, params.contact.z, b[0], mounts[0].y, mounts[0].z
        bodies[:, column] = standing_state(robot, *params.centre, 0.0)
    seen = np.zeros((1 + (len(omega) - 1) // every, columns, 3))
    common = body_params(machines[0].robot, machines[0].motor_d, dt_s)
    mount = motor_mounts(machines[0].robot, machines[0][1:])[0]
    _drive(bodies, properties, shapes, common, mount, own, ticks, seen, every, width_of(lanes))
    seen = seen[:, : len(machines)]
    seen[..., 2] = np.unwrap(seen[..., 2], axis=0)
    return seen


@kernel
def _drive(
    bodies: np.ndarray,
    properties: np.ndarray,
    shapes: np.ndarray,
    body: BodyParams,
    mount: MotorMount,
    omega: np.ndarray,
    ticks: int,
    seen: np.ndarray,
    every: int,
    width: Width,
) -> None:
    """Advance all robots; the arguments of `tracks`, as arrays.

    Args:
        shapes: (_SHAPE, B), layout above.
        omega: (P + 1, 2, B).
        seen: (P // every + 1, B, 3), overwritten from the second row on.
    """
    dt = body.dt
    share, order = 1.0 / ticks, body.contact.pairing.order
    for first in range(0, bodies.shape[1], len(width)):
        x, y = load(shapes, _A, first, width), load(shapes, _A + 1, first, width)
        z, behind = load(shapes, _A + 2, first, width), load(shapes, _B, first, width)
        feet = ((x, y), (x, -y), (behind, 0.0 * y))
        params = read_params(properties, first, width, body, feet, z)
        y, z = load(shapes, _D, first, width), load(shapes, _D + 1, first, width)
        at_d = MotorMount(mount.m, mount.r, mount.J, mount.g, y, z, 1.0, ())
        at_e = MotorMount(mount.m, mount.r, mount.J, mount.g, -y, z, -1.0, ())
        mounts = read_mounts(properties, (0, 1), first, width, (at_d, at_e))
        omega_d, omega_e = load(omega[0], 0, first, width), load(omega[0], 1, first, width)
        theta_d, theta_e = 0.0 * omega_d, 0.0 * omega_e
        for period in range(omega.shape[0] - 1):
            end_d = load(omega[period + 1], 0, first, width)
            end_e = load(omega[period + 1], 1, first, width)
            change_d, change_e = share * (end_d - omega_d), share * (end_e - omega_e)
            dot_d, dot_e = body.inverse_dt * change_d, body.inverse_dt * change_e
            for _ in range(ticks):
                omega_d, omega_e = omega_d + change_d, omega_e + change_e
                theta_d += dt * (omega_d - 0.5 * change_d)
                theta_e += dt * (omega_e - 0.5 * change_e)
                outputs = (theta_d, omega_d, dot_d), (theta_e, omega_e, dot_e)
                force, moment = motor_wrenches((0,), mounts, outputs)
                after = stepped(read_body(bodies, first, width, order), params, force, moment)
                write_body(bodies, first, width, order, after)
            omega_d, omega_e = end_d, end_e
            if (period + 1) % every == 0:
                for column in range(first, first + len(width)):
                    _look(bodies, properties, column, seen[(period + 1) // every])


@inlined
def _look(bodies: np.ndarray, properties: np.ndarray, column: int, seen: np.ndarray) -> None:
    body = bodies[:, column]
    q = orientation_of(body)
    axes = rotation_matrix(q)
    x, y = properties[CENTRE, column], properties[CENTRE + 1, column]
    seen[column, 0] = body[X] - (axes[0][0] * x + axes[0][1] * y)
    seen[column, 1] = body[Y] - (axes[1][0] * x + axes[1][1] * y)
    seen[column, 2] = heading(q)

"""Identified parameters, and simulations of a drive with many sets of them at once.

Robots move by the plant's own ticks, with motors that turn as prescribed; every robot has a lane
of a vector, and in it a mass, friction and unbalances of its own. Feet and motors are at the same
places.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import numpy as np

from cosim.base.errors import UserError
from cosim.base.jit import inlined, kernel
from cosim.calibration.trial import Trial
from cosim.coupling.assembly import new_plant
from cosim.coupling.plant import Plant, step_robots
from cosim.coupling.signals import MotorSignals, State, columns_of, new_state
from cosim.fmi.motor import MotorFmu
from cosim.machine.identification.track import SeenTrack
from cosim.model.config import CoSimConfig, not_calibrated, tree_of
from cosim.model.params import (
    TABLE_I,
    TABLE_II,
    TIMING,
    MotorParams,
    RobotParams,
    motor_names,
    motors_of,
)
from cosim.model.world import IDEAL, World
from cosim.physics.body_state import X, Y, is_upright, orientation_of, standing_state
from cosim.physics.forces import motor_mounts
from cosim.physics.lanes import Width, host_lanes, width_of
from cosim.physics.properties import body_params, properties_of
from cosim.physics.rotation import heading

FAR_M = 1e4  # place of a simulated robot that has fallen: no fit is there
LOOKS_S = 0.005  # between simulated poses, which are interpolated
MOST_PERIODS = 5000  # of a trial at once, whose samples take memory
REPEATS, WINDOW_S = 8, 5.0  # of simulations with other noise, and over which they drift apart


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
    # low, high: bounds
    low: float
    high: float


# Of the body and of the camera, which follows those of the motors; lengths are for TABLE_I.
_PARAMETERS = (
    RobotParameter("mu", "friction of the feet", "", 1.0, 0.15, 0.004, 0.02, 1.0),
    RobotParameter(
        "com_height_m", "height of the centre of mass", "mm", 1e3, 0.01, 4e-4, 0.004, 0.04
    ),
    RobotParameter(
        "com_x_m", "centre of mass before the axis", "mm", 1e3, 0.003, 2e-4, -0.006, 0.006
    ),
    RobotParameter("com_y_m", "centre of mass to the left", "mm", 1e3, 0.003, 2e-4, -0.006, 0.006),
    RobotParameter("camera_delay_s", "delay of the camera", "ms", 1e3, 0.1, 0.01, 0.0, 1.0),
)
USUAL_DELAY_S = 0.03
UNITS = {p.name: (p.scale, p.unit) for p in _PARAMETERS}  # for people


def parameters_of(robot: RobotParams) -> tuple[RobotParameter, ...]:
    """Return what is identified of a machine; its motors and feet stay where its file has them."""
    *body, camera = _PARAMETERS
    size = robot.diameter_m / TABLE_I.diameter_m
    body = [RobotParameter(*p[:4], *(size * v for v in p[4:])) if p.unit else p for p in body]
    for k, name in enumerate(motor_names(len(robot.motors)), start=1):
        what = f"unbalance of motor {k} ({name}) over its usual one"
        body.append(RobotParameter(f"motor_{name.lower()}", what, "", 1.0, 0.3, 0.01, 0.4, 2))
    return (*body, camera)


class Machine(NamedTuple):
    """A robot and its motors."""

    robot: RobotParams
    motors: tuple[MotorParams, ...] = (TABLE_II, TABLE_II)


def usual_values(robot: RobotParams = TABLE_I) -> np.ndarray:
    """Values of all parameters before anything is measured, SI units; a camera's delay is 30 ms."""
    names = [p.name for p in parameters_of(robot)]
    body = [getattr(robot, name) for name in names if name in robot._fields]
    return np.array([*body, *[1.0] * len(robot.motors), USUAL_DELAY_S])


def machine(
    values: Sequence[float] | np.ndarray,
    robot: RobotParams = TABLE_I,
    motor: MotorParams = TABLE_II,
) -> Machine:
    """The machine that has some values, SI units; all else is as of a robot and a motor.

    A foot with a friction of its own keeps the ratio to the friction of the others.
    """
    found = dict(zip((p.name for p in parameters_of(robot)), map(float, values), strict=True))
    factors = [value for name, value in found.items() if name.startswith("motor_")]
    fields = {name: value for name, value in found.items() if name in robot._fields}
    feet = tuple(
        foot if foot.mu is None else foot._replace(mu=foot.mu * found["mu"] / (robot.mu or 1.0))
        for foot in robot.feet
    )
    motors = zip(factors, motors_of(robot, motor), strict=True)
    return Machine(
        robot._replace(**fields, feet=feet),
        tuple(own._replace(r=factor * own.r) for factor, own in motors),
    )


@dataclass(frozen=True)
class Simulated:
    """Simulations of one drive.

    Their motors have speed noise of their own: without any, robots near the speed at which they
    begin to move would seem to stand on a more slippery floor.
    """

    speeds: np.ndarray  # (P + 1, M) of the motors in rad/s, with noise
    smooth: np.ndarray  # (P + 1, M) the same without
    times: np.ndarray  # (n,) of the frames in s
    config: CoSimConfig  # clock, and what of robot and motors is not identified

    @cached_property
    def parameters(self) -> tuple[RobotParameter, ...]:
        """What is identified, K parameters."""
        return parameters_of(self.config.robot)

    @cached_property
    def usual(self) -> np.ndarray:
        """Values before anything is measured, (K,) in SI units."""
        return usual_values(self.config.robot)

    @cached_property
    def spreads(self) -> np.ndarray:
        """Standard deviations around them before anything is measured, (K,) in SI units."""
        return np.array([p.spread for p in self.parameters])

    @cached_property
    def limits(self) -> np.ndarray:
        """Least and largest values, (2, K) in SI units; a machine's own value is within them."""
        robot = self.config.robot
        most = {"com_height_m": robot.height_m}
        high = [min(p.high, most.get(p.name, p.high)) for p in self.parameters]
        low = [p.low for p in self.parameters]
        return np.array([np.minimum(low, self.usual), np.maximum(high, self.usual)], dtype=float)

    def usual_frames(self, factors: Sequence[float]) -> np.ndarray:
        """Return (F, n, 3) as `frames`, of the usual robot with motor speeds times factors.

        The robot falls by none of them, or by others than the first.
        """
        speeds = self.smooth[..., None] * np.array(factors)
        seen = self._tracks([self._machine(self.usual)] * len(factors), speeds)
        looks = LOOKS_S * np.arange(len(seen))
        signals = seen.reshape(len(seen), -1).T
        found = np.array([np.interp(self.times, looks, signal) for signal in signals])
        frames = found.reshape(len(factors), 3, -1).swapaxes(1, 2)
        self.require_standing(frames[0])
        return frames

    def frames(self, values: np.ndarray) -> np.ndarray:
        """(n, C, 3) m, m and rad seen from the origin, heading along +x, by parameters (C, K)."""
        machines = [self._machine(row) for row in values]
        distinct = list(dict.fromkeys(machines))  # another delay asks for no simulation of its own
        seen = self._tracks(distinct, self.speeds)
        looks = LOOKS_S * np.arange(len(seen))
        found = np.empty((len(self.times), len(values), 3))
        for column, (own, row) in enumerate(zip(machines, values, strict=True)):
            for k, signal in enumerate(seen[:, distinct.index(own)].T):
                found[:, column, k] = np.interp(self.times - row[-1], looks, signal)
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
        clock = config.ticks_per_period, config.timing.dt_s
        seen = tracks(machines, speeds, *clock, every, config.world)
        return np.nan_to_num(seen, nan=FAR_M)

    def require_standing(self, frames: np.ndarray) -> None:
        """Refuse a simulated track (n, 3) on which the robot falls."""
        if np.abs(frames).max() >= FAR_M:
            raise UserError(
                f"machine {self.config.preset} tips over when it is simulated with the motor "
                "speeds of this track; lower its com_height_m, or move its feet outwards"
            )


def simulated_drive(track: SeenTrack, config: CoSimConfig, fmu: Path) -> Simulated:
    """Return simulations of what a track was driven with."""
    set_points = track.set_points(config.timing.control_period_s)
    quiet = replace(config, noise=config.noise._replace(relative_amplitude=0.0))
    speeds, smooth = (
        motor_speeds(set_points, MotorFmu(fmu), each, np.random.SeedSequence(0))
        for each in (config, quiet)
    )
    return Simulated(speeds, smooth, track.times, config)


def motor_speeds(
    set_points: np.ndarray, fmu: MotorFmu, config: CoSimConfig, seed: np.random.SeedSequence
) -> np.ndarray:
    """Speeds (P + 1, M) of motors in rad/s from their start to the ends of control periods.

    Args:
        set_points: (P, M) in rad/s, of every control period.
    """
    if config.steering.pulse_s:  # a robot is identified without pulses (docs/own.md)
        steering = config.steering._replace(pulse_s=0.0, pause_s=0.0)
        config = replace(config, steering=steering, open_loop=("motors",))
    changes = np.flatnonzero(np.diff(set_points, axis=0).any(axis=1)) + 1
    cuts = np.union1d(changes, np.arange(MOST_PERIODS, len(set_points), MOST_PERIODS))
    with Trial(fmu, config, np.zeros(1), seed) as trial:
        speeds = [trial.omega]
        for part in np.split(set_points, cuts):
            trial.set_motors(part[0])
            speeds.append(trial.advance(len(part)).omega[:, 0])
    return np.concatenate(speeds)


def tracks(
    machines: Sequence[Machine],
    omega: np.ndarray,
    ticks: int,
    dt_s: float,
    every: int,
    world: World = IDEAL,
) -> np.ndarray:
    """Simulate what an overhead camera sees of robots that start at rest, heading along +x.

    Motors turn as prescribed, so that no FMU is stepped: they do not feel the bodies.

    Args:
        machines: B of them, each in a lane of a vector, with motors and feet at the same places.
        omega: (P + 1, M) or (P + 1, M, B) speeds of motors at the ends of control periods in rad/s,
            linear in between; motors start hanging down.
        every: control periods from one look to the next.
        world: what belongs to the machines: restitution and payload.

    Returns:
        (P // every + 1, B, 3) x and y of the robot's axis in m, and the heading in rad, continuous;
        NaN from when on a robot does not stand any more.
    """
    lanes, (robot, motors), period_s = host_lanes(), machines[0], ticks * dt_s
    clock = TIMING._replace(dt_s=dt_s, communication_step_s=period_s, control_period_s=period_s)
    given = tree_of("", robot=robot, motor=motors[0], timing=clock, world=world)
    config = CoSimConfig().merged(not_calibrated(len(motors)), given)
    plant = new_plant(config, 1, end_on_collision=False, motors=motors)
    columns = columns_of(len(machines), lanes)
    state = new_state(len(machines), 1, columns, robot.sizes)
    turning = np.empty((len(omega), len(motors), columns))
    turning[:] = (own := omega.reshape(*omega.shape[:2], -1))[:, :, :1]
    turning[:, :, : len(machines)] = own
    state.motors.outputs[len(motors) : 2 * len(motors)] = turning[0]
    for column in range(columns):
        one = machines[column if column < len(machines) else 0]
        params = body_params(one.robot, one.motors[0], dt_s, world=world)
        state.bodies.properties[:, column] = properties_of(params, motor_mounts(*one))
        state.bodies.motion[:, column] = standing_state(one.robot, 0.0, 0.0, 0.0)
    seen = np.zeros((1 + (len(omega) - 1) // every, columns, 3))
    _drive(plant, state, turning, seen, every, width_of(lanes))
    seen = seen[:, : len(machines)]
    seen[..., 2] = np.unwrap(seen[..., 2], axis=0)
    return seen


@kernel
def _drive(
    plant: Plant, state: State, omega: np.ndarray, seen: np.ndarray, every: int, width: Width
) -> None:
    """Advance all robots, motors as prescribed.

    Args:
        omega: (P + 1, M, B), see `tracks`.
        seen: (P // every + 1, B, 3), overwritten from the second row on.
    """
    for first in range(0, state.bodies.motion.shape[1], len(width)):
        for period in range(omega.shape[0] - 1):
            for column in range(first, first + len(width)):
                for motor in range(omega.shape[1]):
                    start, end = omega[period, motor, column], omega[period + 1, motor, column]
                    _turn(plant, state.motors, motor, column, start, end)
            for tick in range(plant.ticks_per_step):
                step_robots(plant, state, first, tick, width)
            for column in range(first, first + len(width)):
                if (period + 1) % every == 0:
                    row = (period + 1) // every
                    body = state.bodies.motion[:, column]
                    _observe(body, seen[row, column], seen[row - 1, column])


@inlined
def _turn(
    plant: Plant, signals: MotorSignals, motor: int, column: int, start: float, end: float
) -> None:
    """Turn a motor by a communication step in which its speed changes evenly, as an FMU would."""
    step_s, motors = plant.ticks_per_step * plant.body.dt, len(plant.mounts)
    held, outputs = signals.held, signals.outputs
    theta, speed, rate = motor, motors + motor, 2 * motors + motor
    held[theta, column], held[speed, column] = outputs[theta, column], start
    outputs[theta, column] += 0.5 * step_s * (start + end)
    outputs[speed, column] = end
    held[rate, column] = outputs[rate, column] = (end - start) / step_s


@inlined
def _observe(body: np.ndarray, seen: np.ndarray, before: np.ndarray) -> None:
    if is_upright(body) and not math.isnan(before[0]):
        seen[0], seen[1], seen[2] = body[X], body[Y], heading(orientation_of(body))
    else:
        seen[0] = seen[1] = seen[2] = math.nan

"""Motion of the 1-DOF platform of Eq. (1), in closed form between slip, stop and reversal.

Positions and net speeds are exact up to the root that ends a stroke. Not the robot: that is
`cosim.physics.body`, which this module predicts wherever all feet slide alike. Every function of
a motor speed raises UserError at one at which the platform would leave the floor, or stands still.
"""

import itertools
import math
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.optimize import root_scalar

from cosim.base.errors import UserError
from cosim.base.reading import Kind, read_arrays
from cosim.base.storage import write_arrays
from cosim.model.params import FIG_3, TABLE_I, TABLE_II, MotorParams, RobotParams, motors_of
from cosim.physics.forces import platform_force
from cosim.physics.stroke import Stroke, distance, next_stroke

# Two angles a turn apart by this much in rad are the same: each cycle shrinks the difference.
REPEAT_TOLERANCE = 1e-12
# More strokes than a turn can hold: one in each direction.
CYCLE_STROKES = 4
MOST_STROKES = 6_000  # until the motion repeats itself, which takes some 5/μ
_DIFFERENCE = 2e-5  # of α and s on either side
TABLE_MU = (0.1, 0.15, 0.2, 0.3, 0.4)
TABLE_OMEGA = (700.0, 800.0, 900.0, 1000.0, 1100.0)
POINTS_PER_CYCLE = 720
_FILE = Kind("result of `minirobots platform`", "write one with --out")


class Platform(NamedTuple):
    """1-DOF platform."""

    mass: float  # what moves, M in kg
    m: float  # eccentric mass of all motors (turning in phase) in kg
    r: float  # eccentricity in m
    mu: float
    g: float
    included: bool = False  # whether the weight is M g instead of (M + m) g

    @property
    def weight(self) -> float:
        """Weight in N."""
        return (self.mass if self.included else self.mass + self.m) * self.g


# Its motion is like the printed Fig. 3.
FIG_3_PLATFORM = Platform(FIG_3.M, FIG_3.m, FIG_3.r, FIG_3.mu, TABLE_II.g)


def robot_platform(robot: RobotParams = TABLE_I, motor: MotorParams = TABLE_II) -> Platform:
    """The platform equivalent to a robot whose two mirrored motors are in phase."""
    motors = motors_of(robot, motor)
    places = sorted(mount.place_m for mount in robot.motors)
    if not (
        [(0.0, -y, z) for _, y, z in places] == places[::-1]
        and len(motors) == 2
        and all(abs(mount.axis[1]) == 1.0 for mount in robot.motors)
        and (motors[0].m, motors[0].r) == (motors[1].m, motors[1].r)
        and all(foot.mu is None for foot in robot.feet)
        and not robot.elastic
    ):
        raise UserError(
            "the 1-DOF platform needs two equal motors that are mirror images at the robot's "
            "sides, with shafts across it, and rigid feet of one friction; choose such a machine"
        )
    included = robot.masses_included
    return Platform(robot.mass_kg, 2.0 * motors[0].m, motors[0].r, robot.mu, motor.g, included)


def slip_speed(platform: Platform) -> float:
    """Motor speed ω_c in rad/s above which the platform slips: ω_c² = μW/(u √(1+μ²))."""
    unbalance = platform.m * platform.r
    return math.sqrt(platform.mu * platform.weight / (unbalance * math.hypot(1.0, platform.mu)))


def lift_off_speed(platform: Platform) -> float:
    """Motor speed in rad/s at which the platform leaves the floor: u ω² = W."""
    return math.sqrt(platform.weight / (platform.m * platform.r))


def drift_speed(platform: Platform) -> float:
    """Motor speed ω_net in rad/s above which there is a net displacement.

    Below, the forward stroke ends before the backward one begins and both are mirror images. The
    limit s solves cos(asin s) − cos(asin s + Δ) − s Δ = 0 with Δ = π − 2 atan μ.
    """
    delta = math.pi - 2.0 * math.atan(platform.mu)

    def left_over(s: float) -> float:
        return math.cos(math.asin(s)) - math.cos(math.asin(s) + delta) - s * delta

    return slip_speed(platform) / math.sqrt(
        root_scalar(left_over, bracket=(0.0, 1.0), method="brentq").root
    )


def slip_ratio(platform: Platform, omega_rad_s: float) -> float:
    """The ratio s = (ω_c/ω)²."""
    if not 0.0 < omega_rad_s < lift_off_speed(platform):
        raise UserError(
            f"motor speed {omega_rad_s:g} rad/s: choose one between 0 and "
            f"{lift_off_speed(platform):.0f} rad/s, where the platform leaves the floor"
        )
    return (slip_speed(platform) / omega_rad_s) ** 2


def dimensionless_strokes(alpha: float, s: float) -> Iterator[Stroke]:
    """Strokes from rest at θ = 0, without end unless nothing slips."""
    theta = 0.0
    while s < 1.0:
        stroke = next_stroke(alpha, s, theta)
        yield stroke
        theta = stroke.stop


def strokes(platform: Platform, omega_rad_s: float, cycles: int) -> list[Stroke]:
    """Strokes that begin in the first turns of the motor, from rest at θ = 0."""
    s, alpha = slip_ratio(platform, omega_rad_s), math.atan(platform.mu)
    end = 2.0 * math.pi * cycles
    return list(
        itertools.takewhile(lambda stroke: stroke.start < end, dimensionless_strokes(alpha, s))
    )


def length_unit(platform: Platform) -> float:
    """Unit of distance u √(1+μ²)/M in m."""
    return platform.m * platform.r * math.hypot(1.0, platform.mu) / platform.mass


def trajectory(platform: Platform, omega_rad_s: float, theta: np.ndarray) -> np.ndarray:
    """Position in m at increasing angles θ ≥ 0 in rad, from rest at θ = 0; same shape."""
    s, alpha = slip_ratio(platform, omega_rad_s), math.atan(platform.mu)
    position = np.zeros_like(theta)
    for stroke in strokes(platform, omega_rad_s, math.ceil(theta[-1] / (2.0 * math.pi))):
        for i in np.flatnonzero(theta > stroke.start):
            end = min(theta[i], stroke.stop)
            position[i] += distance(stroke.direction, alpha, s, stroke.start, end)
    return position * length_unit(platform)


def net_displacement(platform: Platform, omega_rad_s: float) -> float:
    """Displacement in m along +Y per turn of the motor, once the motion repeats itself."""
    s = slip_ratio(platform, omega_rad_s)
    return length_unit(platform) * _net_distance(math.atan(platform.mu), s)


def _net_distance(alpha: float, s: float) -> float:
    """Dimensionless distance per turn, once the motion repeats itself."""
    found: list[Stroke] = []
    for stroke in itertools.islice(dimensionless_strokes(alpha, s), MOST_STROKES):
        # A stroke that begins a turn after another closes the cycle of those between.
        for i, before in enumerate(found):
            if abs(stroke.start - 2.0 * math.pi - before.start) < REPEAT_TOLERANCE:
                return sum(
                    distance(one.direction, alpha, s, one.start, one.stop) for one in found[i:]
                )
        found = [*found[-CYCLE_STROKES:], stroke]
    if found:
        raise UserError(
            f"with mu = {math.tan(alpha):.3g} the platform's motion does not come to repeat "
            "itself; choose a larger mu"
        )
    return 0.0


def net_speed(platform: Platform, omega_rad_s: float) -> float:
    """Mean speed in m/s along +Y at a positive motor speed."""
    return net_displacement(platform, omega_rad_s) * omega_rad_s / (2.0 * math.pi)


def sensitivities(platform: Platform, omega_rad_s: float) -> dict[str, float]:
    """Relative derivatives d ln v / d ln p of `net_speed`, where it is not zero.

    By `unbalance` (m r of all motors, at constant weight), `mu`, `mass` (of the platform) and
    `omega`. The dimensionless distance depends on α and s alone: its derivatives are differences.
    """
    s, alpha, h = slip_ratio(platform, omega_rad_s), math.atan(platform.mu), _DIFFERENCE
    total = 2.0 * h * _net_distance(alpha, s)
    if not total:
        raise UserError(
            f"with mu = {platform.mu:g} the platform stands still at {omega_rad_s:.0f} rad/s; "
            "choose a smaller mu or a higher motor speed"
        )
    by_alpha = (_net_distance(alpha + h, s) - _net_distance(alpha - h, s)) / total
    by_s = s * (_net_distance(alpha, s + h) - _net_distance(alpha, s - h)) / total
    mu, mass = platform.mu, platform.mass
    return {
        "unbalance": 1.0 - by_s,
        "mu": (mu * mu + by_s + mu * by_alpha) / (1.0 + mu * mu),
        "mass": by_s * mass * platform.g / platform.weight - 1.0,
        "omega": 1.0 - 2.0 * by_s,
    }


def forces(
    platform: Platform, omega_rad_s: float, theta: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Driving force and greatest friction force in N at angles θ in rad; shapes of θ."""
    pairs = [platform_force(platform.m, platform.r, platform.g, t, omega_rad_s) for t in theta]
    driving, vertical = np.array(pairs).T
    own = platform.mass * platform.g - platform.included * platform.m * platform.g
    return driving, platform.mu * (own - vertical)


class Motion(NamedTuple):
    """Motion of a platform from rest over some turns of its motor; (n,) angles."""

    theta_rad: np.ndarray
    time_s: np.ndarray
    position_m: np.ndarray
    # driving_force_n, friction_limit_n: (n,) driving force, and friction that holds
    driving_force_n: np.ndarray
    friction_limit_n: np.ndarray
    omega_rad_s: np.ndarray
    mu: np.ndarray
    net_displacement_m: np.ndarray  # of one turn once the motion repeats itself, ()


class SpeedTable(NamedTuple):
    """Robots as platforms, (m,) friction coefficients at (n,) motor speeds."""

    mu: np.ndarray
    omega_rad_s: np.ndarray
    net_speed_m_s: np.ndarray  # (m, n)
    # (m, 2) motor speeds above which it slides and gets ahead
    slip_and_drift_speed_rad_s: np.ndarray


class PlatformResult(NamedTuple):
    """The data of Fig. 3, an .npz file in which `fig_3_mu` is the `mu` of `fig_3`."""

    fig_3: Motion  # of the assumed platform with a motion like the printed figure
    table_ii: Motion
    table: SpeedTable

    def save(self, path: Path) -> None:
        """Write the file."""
        arrays = {
            f"{motion}_{name}": array
            for motion, values in self._asdict().items()
            for name, array in values._asdict().items()
        }
        write_arrays(path, arrays)

    @classmethod
    def load(cls, path: Path) -> "PlatformResult":
        """Read what `save` wrote; raises FileError."""
        forms = cls.__annotations__
        names = [f"{motion}_{name}" for motion, form in forms.items() for name in form._fields]
        arrays = iter(read_arrays(path, _FILE, names).values())
        return cls(*(form(*(next(arrays) for _ in form._fields)) for form in forms.values()))


def _motion(platform: Platform, omega: float, cycles: int) -> Motion:
    theta = np.linspace(0.0, 2.0 * math.pi * cycles, POINTS_PER_CYCLE * cycles + 1)
    return Motion(
        theta,
        theta / omega,
        trajectory(platform, omega, theta),
        *forces(platform, omega, theta),
        np.array(omega),
        np.array(platform.mu),
        np.array(net_displacement(platform, omega)),
    )


def move_platforms(
    cycles: int, omega_rad_s: float, robot: RobotParams = TABLE_I, motor: MotorParams = TABLE_II
) -> PlatformResult:
    """Motion of both platforms, and the table of net speeds of the robot's at any friction.

    Its motor speeds are slower in proportion for a robot that leaves the floor at slower ones than
    that of Tables I and II.
    """
    platforms = [robot_platform(robot._replace(mu=each), motor) for each in TABLE_MU]
    slower = min(1.0, lift_off_speed(platforms[0]) / lift_off_speed(robot_platform()))
    speeds = [float(round(slower * omega)) for omega in TABLE_OMEGA]
    return PlatformResult(
        _motion(FIG_3_PLATFORM, FIG_3.omega, cycles),
        _motion(robot_platform(robot, motor), omega_rad_s, cycles),
        SpeedTable(
            np.array(TABLE_MU),
            np.array(speeds),
            np.array([[net_speed(p, omega) for omega in speeds] for p in platforms]),
            np.array([[slip_speed(p), drift_speed(p)] for p in platforms]),
        ),
    )

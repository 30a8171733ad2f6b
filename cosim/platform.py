"""1-DOF platform of Eq. (1), Fig. 2 and 3: sliding friction under a turning eccentric mass.

Between two events (slip, stop, reversal) the motion is a closed form, so positions and net speeds
are exact up to the root that ends a stroke. Not the robot: that is `cosim.physics.body`, which this
module predicts wherever all feet slide alike. `python -m cosim.platform` writes results for Fig. 3.
"""

import itertools
import json
import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
import tyro
from scipy.optimize import root_scalar

from cosim.base.errors import UserError, run_command
from cosim.base.params import FIG_3, TABLE_I, TABLE_II, Fig3Params, MotorParams, RobotParams
from cosim.base.storage import replacing
from cosim.physics.forces import platform_force
from cosim.physics.stroke import Stroke, distance, next_stroke

# Two angles a turn apart by this much in rad are the same: each cycle shrinks the difference.
REPEAT_TOLERANCE = 1e-12
# More strokes than a turn can hold: one in each direction.
CYCLE_STROKES = 4


class PlatformError(UserError):
    """A platform or motor speed for which Eq. (1) with a steady floor contact does not hold."""


class Platform(NamedTuple):
    """1-DOF platform.

    Attributes:
        mass: what moves, M in kg.
        m: eccentric mass of all motors (turning in phase) in kg; the weight is (M + m) g.
        r: eccentricity in m.
        mu: Coulomb friction coefficient.
        g: gravitational acceleration in m/s².
    """

    mass: float
    m: float
    r: float
    mu: float
    g: float


def fig_3_platform(preset: Fig3Params = FIG_3, g: float = TABLE_II.g) -> Platform:
    """The platform whose motion looks like the printed Fig. 3."""
    return Platform(preset.M, preset.m, preset.r, preset.mu, g)


def robot_platform(robot: RobotParams = TABLE_I, motor: MotorParams = TABLE_II) -> Platform:
    """The platform equivalent to the robot with both motors in phase."""
    return Platform(robot.mass_kg, 2.0 * motor.m, motor.r, robot.mu, motor.g)


def slip_speed(platform: Platform) -> float:
    """Motor speed ω_c in rad/s above which the platform slips: ω_c² = μW/(u √(1+μ²))."""
    weight = (platform.mass + platform.m) * platform.g
    unbalance = platform.m * platform.r
    return math.sqrt(platform.mu * weight / (unbalance * math.hypot(1.0, platform.mu)))


def lift_off_speed(platform: Platform) -> float:
    """Motor speed in rad/s at which the platform leaves the floor: u ω² = W."""
    return math.sqrt((platform.mass + platform.m) * platform.g / (platform.m * platform.r))


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


def _slip_ratio(platform: Platform, omega_rad_s: float) -> float:
    """The ratio s = (ω_c/ω)².

    Raises:
        PlatformError: the platform would leave the floor, or the motor stands still.
    """
    if not 0.0 < omega_rad_s < lift_off_speed(platform):
        raise PlatformError(
            f"motor speed {omega_rad_s:g} rad/s: choose one between 0 and "
            f"{lift_off_speed(platform):.0f} rad/s, where the platform leaves the floor"
        )
    return (slip_speed(platform) / omega_rad_s) ** 2


def _strokes(alpha: float, s: float) -> Iterator[Stroke]:
    """Strokes from rest at θ = 0, without end unless nothing slips."""
    theta = 0.0
    while s < 1.0:
        stroke = next_stroke(alpha, s, theta)
        yield stroke
        theta = stroke.stop


def strokes(platform: Platform, omega_rad_s: float, cycles: int) -> list[Stroke]:
    """Strokes that begin in the first turns of the motor, from rest at θ = 0.

    Raises:
        PlatformError: see `net_speed`.
    """
    s, alpha = _slip_ratio(platform, omega_rad_s), math.atan(platform.mu)
    end = 2.0 * math.pi * cycles
    return list(itertools.takewhile(lambda stroke: stroke.start < end, _strokes(alpha, s)))


def _length(platform: Platform) -> float:
    """Unit of distance u √(1+μ²)/M in m."""
    return platform.m * platform.r * math.hypot(1.0, platform.mu) / platform.mass


def trajectory(platform: Platform, omega_rad_s: float, theta: np.ndarray) -> np.ndarray:
    """Position in m at increasing angles θ ≥ 0 in rad, from rest at θ = 0; same shape.

    Raises:
        PlatformError: see `net_speed`.
    """
    s, alpha = _slip_ratio(platform, omega_rad_s), math.atan(platform.mu)
    position = np.zeros_like(theta)
    for stroke in strokes(platform, omega_rad_s, math.ceil(theta[-1] / (2.0 * math.pi))):
        for i in np.flatnonzero(theta > stroke.start):
            end = min(theta[i], stroke.stop)
            position[i] += distance(stroke.direction, alpha, s, stroke.start, end)
    return position * _length(platform)


def net_displacement(platform: Platform, omega_rad_s: float) -> float:
    """Displacement in m along +Y per turn of the motor, once the motion repeats itself.

    Raises:
        PlatformError: see `net_speed`.
    """
    s, alpha = _slip_ratio(platform, omega_rad_s), math.atan(platform.mu)
    turn = 2.0 * math.pi
    found: list[Stroke] = []
    for stroke in _strokes(alpha, s):
        # A stroke that begins a turn after another closes the cycle of those between.
        for i, before in enumerate(found):
            if abs(stroke.start - turn - before.start) < REPEAT_TOLERANCE:
                return _length(platform) * sum(
                    distance(one.direction, alpha, s, one.start, one.stop) for one in found[i:]
                )
        found = [*found[-CYCLE_STROKES:], stroke]
    return 0.0


def net_speed(platform: Platform, omega_rad_s: float) -> float:
    """Mean speed in m/s along +Y.

    Args:
        platform: masses and friction.
        omega_rad_s: motor speed, positive (a negative one moves the platform along −Y).

    Raises:
        PlatformError: the platform would leave the floor, or the motor stands still.
    """
    return net_displacement(platform, omega_rad_s) * omega_rad_s / (2.0 * math.pi)


def forces(
    platform: Platform, omega_rad_s: float, theta: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Driving force and greatest friction force in N at angles θ in rad; shapes of θ."""
    pairs = [platform_force(platform.m, platform.r, platform.g, t, omega_rad_s) for t in theta]
    driving, vertical = np.array(pairs).T
    return driving, platform.mu * (platform.mass * platform.g - vertical)


@dataclass(frozen=True)
class PlatformRun:
    """Move the 1-DOF platform of Eq. (1) and write its motion: the data of Fig. 3.

    Two platforms: one that looks like the printed figure, and the robot of Tables I and II. The
    result file also holds a table of net speeds over friction and motor speed.
    """

    out: Path = Path("runs/platform.npz")
    """Result file (.npz)."""
    cycles: int = 6
    """Turns of the motor to show."""
    omega: float = 900.0
    """Motor speed of the platform of Tables I and II, in rad/s."""
    mu: float = TABLE_I.mu
    """Friction coefficient of that platform."""
    json: bool = False
    """Print the results as one JSON object on the last line."""

    def __post_init__(self) -> None:
        if not 1 <= self.cycles <= MAX_CYCLES:
            raise PlatformError(f"--cycles {self.cycles}: choose 1 to {MAX_CYCLES}")
        if self.mu <= 0.0:
            raise PlatformError(f"--mu {self.mu:g}: choose a friction coefficient above 0")


TABLE_MU = (0.1, 0.15, 0.2, 0.3, 0.4)
TABLE_OMEGA = (700.0, 800.0, 900.0, 1000.0, 1100.0)
POINTS_PER_CYCLE = 720
MAX_CYCLES = 100


def _motion(name: str, platform: Platform, omega: float, cycles: int) -> dict[str, np.ndarray]:
    theta = np.linspace(0.0, 2.0 * math.pi * cycles, POINTS_PER_CYCLE * cycles + 1)
    driving, friction_limit = forces(platform, omega, theta)
    values = {
        "theta_rad": theta,
        "time_s": theta / omega,
        "position_m": trajectory(platform, omega, theta),
        "driving_force_n": driving,
        "friction_limit_n": friction_limit,
        "omega_rad_s": np.array(omega),
        "mu": np.array(platform.mu),
        "net_displacement_m": np.array(net_displacement(platform, omega)),
    }
    return {f"{name}_{key}": value for key, value in values.items()}


def write_platform(run: PlatformRun) -> dict[str, np.ndarray]:
    """Compute the motion of both platforms and the table of net speeds, and write `run.out`.

    Raises:
        PlatformError: see `net_speed`.
        OSError: the file cannot be written.
    """
    table_ii = robot_platform(TABLE_I._replace(mu=run.mu))
    arrays = _motion("paper", fig_3_platform(), FIG_3.omega, run.cycles)
    arrays |= _motion("table_ii", table_ii, run.omega, run.cycles)
    platforms = [robot_platform(TABLE_I._replace(mu=mu)) for mu in TABLE_MU]
    speeds = np.array([[net_speed(p, omega) for omega in TABLE_OMEGA] for p in platforms])
    thresholds = np.array([[slip_speed(p), drift_speed(p)] for p in platforms])
    arrays |= {
        "table_mu": np.array(TABLE_MU),
        "table_omega_rad_s": np.array(TABLE_OMEGA),
        "table_net_speed_m_s": speeds,
        "table_slip_and_drift_speed_rad_s": thresholds,
    }
    with replacing(run.out) as path:
        np.savez(path, allow_pickle=False, **arrays)
    return arrays


def main() -> None:
    """Command line."""
    run = tyro.cli(PlatformRun)
    arrays = write_platform(run)
    speeds, thresholds = arrays["table_net_speed_m_s"], arrays["table_slip_and_drift_speed_rad_s"]
    print("net speed in mm/s (motor speed in rad/s)")
    print("    mu  omega_c omega_net" + "".join(f"{omega:8.0f}" for omega in TABLE_OMEGA))
    for mu, (slip, drift), row in zip(TABLE_MU, thresholds, speeds, strict=True):
        print(
            f"{mu:6.2f} {slip:8.1f} {drift:9.1f}"
            + "".join(f"{round(1e3 * v, 3) + 0.0:8.3f}" for v in row)
        )
    for name in ("paper", "table_ii"):
        step = 1e6 * float(arrays[f"{name}_net_displacement_m"])
        print(f"{name}: {step:.2f} um per turn at {float(arrays[f'{name}_omega_rad_s']):g} rad/s")
    print(f"results: {run.out}")
    if run.json:
        keys = ("table_mu", "table_omega_rad_s", "table_net_speed_m_s")
        results = {key: arrays[key].tolist() for key in keys}
        for name in ("paper", "table_ii"):
            key = f"{name}_net_displacement_m"
            results[key] = float(arrays[key])
        print(json.dumps(results))


if __name__ == "__main__":
    run_command(main)

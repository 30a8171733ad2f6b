"""Result file of `minirobots platform`: the data of Fig. 3, and a table of speeds."""

import math
from pathlib import Path
from typing import NamedTuple

import numpy as np

from cosim.base.reading import Kind, read_arrays
from cosim.base.storage import replacing
from cosim.machine.platform.motion import (
    Platform,
    drift_speed,
    fig_3_platform,
    forces,
    net_displacement,
    net_speed,
    robot_platform,
    slip_speed,
    trajectory,
)
from cosim.model.params import FIG_3, TABLE_I, TABLE_II, MotorParams, RobotParams

TABLE_MU = (0.1, 0.15, 0.2, 0.3, 0.4)
TABLE_OMEGA = (700.0, 800.0, 900.0, 1000.0, 1100.0)
POINTS_PER_CYCLE = 720
_FILE = Kind("result of `minirobots platform`", "write one with --out")


class Motion(NamedTuple):
    """Motion of a platform from rest over some turns of its motor; n angles.

    Attributes:
        theta_rad, time_s: (n,) angle of the motor, and when it is reached.
        position_m: (n,).
        driving_force_n, friction_limit_n: (n,) driving force, and friction that holds.
        omega_rad_s: speed of the motor, ().
        mu: friction coefficient, ().
        net_displacement_m: of one turn once the motion repeats itself, ().
    """

    theta_rad: np.ndarray
    time_s: np.ndarray
    position_m: np.ndarray
    driving_force_n: np.ndarray
    friction_limit_n: np.ndarray
    omega_rad_s: np.ndarray
    mu: np.ndarray
    net_displacement_m: np.ndarray


class SpeedTable(NamedTuple):
    """Robots as platforms, m friction coefficients at n motor speeds.

    Attributes:
        mu: (m,).
        omega_rad_s: (n,).
        net_speed_m_s: (m, n).
        slip_and_drift_speed_rad_s: (m, 2) motor speeds above which it slides and gets ahead.
    """

    mu: np.ndarray
    omega_rad_s: np.ndarray
    net_speed_m_s: np.ndarray
    slip_and_drift_speed_rad_s: np.ndarray


class PlatformResult(NamedTuple):
    """Everything that the command finds; the fields of its parts have these names before them.

    Attributes:
        paper: the platform with a motion like the printed Fig. 3.
        table_ii: the robot of Tables I and II, or of another machine.
        table: net speeds over friction and motor speed.
    """

    paper: Motion
    table_ii: Motion
    table: SpeedTable

    def save(self, path: Path) -> None:
        """Write an .npz file.

        Raises:
            FileError, OSError: the file cannot be written.
        """
        arrays = {
            f"{part}_{name}": array
            for part, values in self._asdict().items()
            for name, array in values._asdict().items()
        }
        with replacing(path) as temporary:
            np.savez(temporary, allow_pickle=False, **arrays)

    @classmethod
    def load(cls, path: Path) -> "PlatformResult":
        """Read what `save` wrote.

        Raises:
            UserError: there is no such file, or it is of another kind.
        """
        forms = cls.__annotations__
        names = [f"{part}_{name}" for part, form in forms.items() for name in form._fields]
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
    """Motion of both platforms, and the table of net speeds.

    Args:
        cycles: turns of the motor.
        omega_rad_s: motor speed of the robot's platform.
        robot, motor: of that platform; the table is of it too, but for the friction.

    Raises:
        UserError: the platform would leave the floor, or the motor stands still.
    """
    platforms = [robot_platform(robot._replace(mu=each), motor) for each in TABLE_MU]
    return PlatformResult(
        _motion(fig_3_platform(), FIG_3.omega, cycles),
        _motion(robot_platform(robot, motor), omega_rad_s, cycles),
        SpeedTable(
            np.array(TABLE_MU),
            np.array(TABLE_OMEGA),
            np.array([[net_speed(p, omega) for omega in TABLE_OMEGA] for p in platforms]),
            np.array([[slip_speed(p), drift_speed(p)] for p in platforms]),
        ),
    )

"""`python benchmarks/drive_map.py`: mean motion over motor speed and phase difference.

What the motor phases, which nobody controls, do to speed and yaw. Prescribed motor speeds, no FMU.
"""

import json
import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np
import tyro

from benchmarks.prescribed import Drive, mean_motion
from cosim.base.errors import UserError, run_command
from cosim.base.params import TABLE_I, TABLE_II, TIMING


class BenchmarkError(UserError):
    """Settings that no table can be made of."""


@dataclass(frozen=True)
class DriveMap:
    """Mean forward speed and yaw rate of one robot, driving and turning.

    For every motor speed: with both motors in phase, and the mean, least and greatest value over
    all phase differences.
    """

    omega: Annotated[tuple[float, ...], tyro.conf.arg(metavar="RAD_S")] = (
        700.0,
        800.0,
        900.0,
        1000.0,
        1100.0,
    )
    """Motor speeds in rad/s."""
    mu: float = TABLE_I.mu
    """Coulomb friction coefficient of the feet."""
    phases: int = 16
    """Phase differences, evenly spread over a turn."""
    duration: Annotated[float, tyro.conf.arg(metavar="S")] = 1.0
    """Simulated time of the averages in s, after half a second to settle."""
    json: bool = False
    """Print the table as one JSON object on the last line."""

    def __post_init__(self) -> None:
        if self.phases < 1 or not self.omega or min(self.omega) <= 0.0:
            raise BenchmarkError("name motor speeds above 0 and one phase difference at least")


def main() -> None:
    """Command line."""
    options = tyro.cli(DriveMap)
    robot = TABLE_I._replace(mu=options.mu)
    phases = 2.0 * math.pi * np.arange(options.phases) / options.phases
    rows = []
    print(f"mu = {options.mu:g}; in phase, and mean [least, greatest] over {len(phases)} phases")
    print("rad/s  driving: mm/s                  yaw in deg/s     turning: deg/s")
    for omega in options.omega:
        motions = np.array(
            [
                mean_motion(robot, TABLE_II, drive, dt_s=TIMING.dt_s, duration_s=options.duration)
                for phase in phases.tolist()
                for drive in (
                    Drive(-omega, omega, 0.0, phase),
                    Drive(omega, omega, 0.0, phase),
                )
            ]
        ).reshape(len(phases), 2, -1)
        forward = 1e3 * motions[:, 0, 0]
        yaw, turn = np.rad2deg(motions[:, 0, 2]), np.rad2deg(motions[:, 1, 2])
        cells = [
            f"{v[0]:7.2f} {v.mean():6.2f} [{v.min():5.2f}, {v.max():5.2f}]" for v in (forward, turn)
        ]
        print(f"{omega:5.0f}  {cells[0]}   [{yaw.min():5.2f}, {yaw.max():5.2f}]   {cells[1]}")
        rows.append(
            {
                "omega_rad_s": omega,
                "forward_mm_s": forward.tolist(),
                "drive_yaw_deg_s": yaw.tolist(),
                "turn_deg_s": turn.tolist(),
            }
        )
    if options.json:
        print(json.dumps({"mu": options.mu, "phase_rad": phases.tolist(), "rows": rows}))


if __name__ == "__main__":
    run_command(main)

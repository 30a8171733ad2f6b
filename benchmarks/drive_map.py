"""Mean motion over motor speed and phase difference.

What the uncontrolled motor phases do to speed and yaw. Prescribed motor speeds, no FMU.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
import tyro

from cosim.base.errors import UserError
from cosim.model.params import TABLE_I, TABLE_II, TIMING
from minirobots.options import CommandOptions, Count, Seconds
from tests.references.prescribed import Drive, mean_motion


@dataclass(frozen=True, kw_only=True)
class Options(CommandOptions):
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
    phases: Count = 16
    """Phase differences, evenly spread over a turn."""
    duration: Seconds = 1.0
    """Simulated time of the averages in s, after half a second to settle."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.omega or min(self.omega) <= 0.0:
            raise UserError("--omega: name motor speeds above 0")


def measure(omega: Sequence[float], mu: float, phases: int, duration: float) -> dict[str, Any]:
    """Speeds and yaw rates at motor speeds omega in rad/s over phase differences."""
    robot = TABLE_I._replace(mu=mu)
    differences = 2.0 * math.pi * np.arange(phases) / phases
    rows = []
    for speed in omega:
        motions = np.array(
            [
                mean_motion(robot, TABLE_II, drive, dt_s=TIMING.dt_s, duration_s=duration)
                for phase in differences.tolist()
                for drive in (Drive(-speed, speed, 0.0, phase), Drive(speed, speed, 0.0, phase))
            ]
        ).reshape(phases, 2, -1)
        rows.append(
            {
                "omega_rad_s": speed,
                "forward_mm_s": (1e3 * motions[:, 0, 0]).tolist(),
                "drive_yaw_deg_s": np.rad2deg(motions[:, 0, 2]).tolist(),
                "turn_deg_s": np.rad2deg(motions[:, 1, 2]).tolist(),
            }
        )
    return {"mu": mu, "phase_rad": differences.tolist(), "rows": rows}


def show(found: dict[str, Any]) -> None:
    """Print the table."""
    phases = len(found["phase_rad"])
    print(f"mu = {found['mu']:g}; in phase, and mean [least, greatest] over {phases} phases")
    print("rad/s  driving: mm/s                  yaw in deg/s     turning: deg/s")
    for row in found["rows"]:
        driving, turning = (
            f"{v[0]:7.2f} {np.mean(v):6.2f} [{min(v):5.2f}, {max(v):5.2f}]"
            for v in (row["forward_mm_s"], row["turn_deg_s"])
        )
        yaw = row["drive_yaw_deg_s"]
        print(
            f"{row['omega_rad_s']:5.0f}  {driving}   [{min(yaw):5.2f}, {max(yaw):5.2f}]   {turning}"
        )

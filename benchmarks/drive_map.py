"""Mean motion over motor speed and phase difference.

What the uncontrolled motor phases do to speed and yaw. Prescribed motor speeds, no FMU.
"""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import tyro

from cosim.base.errors import UserError
from cosim.model.params import TABLE_I, TABLE_II, TIMING
from minirobots.options import CommandOptions, Count, Seconds
from tests.references.prescribed import Drive, MeanMotion, mean_motion


@dataclass(frozen=True, kw_only=True)
class Options(CommandOptions):
    """Mean forward speed and yaw rate of one robot, driving and turning.

    For every motor speed: with both motors in phase, and with every phase difference.
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

    def motion(drive: Drive) -> MeanMotion:
        return mean_motion(robot, TABLE_II, drive, dt_s=TIMING.dt_s, duration_s=duration)

    robot, rows = TABLE_I._replace(mu=mu), []
    for speed, number in itertools.product(omega, range(phases)):
        phase = 2.0 * math.pi * number / phases
        driving = motion(Drive(-speed, speed, 0.0, phase))
        turning = motion(Drive(speed, speed, 0.0, phase))
        rows.append(
            {
                "omega_rad_s": speed,
                "phase_rad": phase,
                "forward_mm_s": 1e3 * driving.forward_m_s,
                "drive_yaw_deg_s": math.degrees(driving.yaw_rate_rad_s),
                "turn_deg_s": math.degrees(turning.yaw_rate_rad_s),
            }
        )
    return {"mu": mu, "rows": rows}

"""Mean motion over motor speed and phase difference.

Mean forward speed and yaw rate of one robot, driving and turning, at prescribed motor speeds with
every phase difference between its motors: what the uncontrolled phases do.
"""

import itertools
import math
from functools import partial
from typing import Annotated, Any

import tyro

from cosim.model.params import TABLE_I, TABLE_II, TIMING
from minirobots.options import CommandOptions, Count, Positive, Seconds
from tests.references.prescribed import Drive, mean_motion

SPEEDS_RAD_S = (700.0, 800.0, 900.0, 1000.0, 1100.0)


class Options(CommandOptions):
    omega: Annotated[tuple[Positive, ...], tyro.conf.arg(metavar="RAD_S")] = SPEEDS_RAD_S
    """Motor speeds in rad/s."""
    mu: float = TABLE_I.mu
    """Coulomb friction coefficient of the feet."""
    phases: Count = 16
    """Phase differences, evenly spread over a turn."""
    duration: Seconds = 1.0
    """Simulated time of the averages in s, after half a second to settle."""


def measure(options: Options) -> dict[str, Any]:
    robot, rows = TABLE_I._replace(mu=options.mu), []
    times = {"dt_s": TIMING.dt_s, "duration_s": options.duration}
    motion = partial(mean_motion, robot, TABLE_II, **times)
    for speed, number in itertools.product(options.omega, range(options.phases)):
        phase = 2.0 * math.pi * number / options.phases
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
    return {"mu": options.mu, "rows": rows}

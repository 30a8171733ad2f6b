"""`python benchmarks/convergence.py`: how mean speeds depend on the step and on the contact sweeps.

Motors turn at prescribed speeds; nothing here measures wall time.
"""

import json
import math
from dataclasses import dataclass
from itertools import pairwise
from typing import Annotated

import tyro

from benchmarks.prescribed import Drive, MeanMotion, mean_motion
from cosim.base.errors import UserError, run_command
from cosim.base.params import TABLE_I, TABLE_II
from cosim.physics.contact import CONTACT_TOLERANCE

QUARTER, HALF = math.pi / 2.0, math.pi
DRIVES = {
    "forwards, in phase, 700": Drive(-700.0, 700.0),
    "forwards, in phase, 900": Drive(-900.0, 900.0),
    "forwards, quarter turn apart, 900": Drive(-900.0, 900.0, 0.0, QUARTER),
    "forwards, half a turn apart, 900": Drive(-900.0, 900.0, 0.0, HALF),
    "forwards, in phase, 1050": Drive(-1050.0, 1050.0),
    "backwards, in phase, 900": Drive(900.0, -900.0),
    "turning, in phase, 900": Drive(900.0, 900.0),
    "turning, quarter turn apart, 900": Drive(900.0, 900.0, 0.0, QUARTER),
    "turning, half a turn apart, 900": Drive(900.0, 900.0, 0.0, HALF),
}
SOLVED_OUT = 1e-6  # tolerance of contacts iterated until they no longer change


class BenchmarkError(UserError):
    """Settings that no table can be made of."""


@dataclass(frozen=True)
class Convergence:
    """Halve the time step, solve the contacts out, and see what changes.

    Mean forward speed and yaw rate at nine manoeuvres, for every time step with the usual
    contact sweeps, and for the middle one with contacts solved out.
    """

    dt: Annotated[tuple[float, ...], tyro.conf.arg(metavar="S")] = (2e-5, 1e-5, 5e-6)
    """Time steps in s, coarse to fine."""
    settle: Annotated[float, tyro.conf.arg(metavar="S")] = 0.5
    """Simulated time before the averages begin, in s."""
    duration: Annotated[float, tyro.conf.arg(metavar="S")] = 2.0
    """Simulated time of the averages, in s (whole turns of the motors)."""
    json: bool = False
    """Print the table as one JSON object on the last line."""

    def __post_init__(self) -> None:
        if len(self.dt) < 2 or min(self.dt) <= 0.0:
            raise BenchmarkError("--dt: name two or more time steps above 0")


def _relative_change(coarse: MeanMotion, fine: MeanMotion) -> float:
    """Change of the quantity that the drive is for: speed when it drives, yaw rate when it turns.

    A turning robot moves its feet at yaw rate times foot radius.
    """
    radius = TABLE_I.foot_radius_m
    apart = math.hypot(
        coarse.forward_m_s - fine.forward_m_s,
        coarse.lateral_m_s - fine.lateral_m_s,
        radius * (coarse.yaw_rate_rad_s - fine.yaw_rate_rad_s),
    )
    size = math.hypot(fine.forward_m_s, fine.lateral_m_s, radius * fine.yaw_rate_rad_s)
    return apart / size


def main() -> None:
    """Command line."""
    options = tyro.cli(Convergence)
    middle = options.dt[len(options.dt) // 2]
    rows = {}
    print("forward speed in mm/s and yaw rate in deg/s; largest change when the step is refined,")
    print(f"and change when contacts are solved out at dt = {middle:g} s")
    columns = "".join(f"{f'dt {dt:g}':>17}" for dt in options.dt)
    print(f"{'drive (rad/s)':34}{columns}{'solved out':>17}{'step':>9}{'sweeps':>9}")
    for name, drive in DRIVES.items():

        def motion(dt_s: float, tolerance: float, drive: Drive = drive) -> MeanMotion:
            return mean_motion(
                TABLE_I,
                TABLE_II,
                drive,
                dt_s=dt_s,
                settle_s=options.settle,
                duration_s=options.duration,
                tolerance=tolerance,
            )

        found = [motion(dt, CONTACT_TOLERANCE) for dt in options.dt]
        solved = motion(middle, SOLVED_OUT)
        step = max(_relative_change(coarse, fine) for coarse, fine in pairwise(found))
        sweeps = _relative_change(found[len(options.dt) // 2], solved)
        cells = [
            f"{1e3 * m.forward_m_s + 0.0:9.3f}{math.degrees(m.yaw_rate_rad_s):8.3f}"
            for m in (*found, solved)
        ]
        print(f"{name:34}{''.join(cells)}{step:9.2%}{sweeps:9.2%}", flush=True)
        rows[name] = {
            "forward_m_s": [m.forward_m_s for m in found],
            "lateral_m_s": [m.lateral_m_s for m in found],
            "yaw_rate_rad_s": [m.yaw_rate_rad_s for m in found],
            "change_with_step": step,
            "change_with_sweeps": sweeps,
        }
    if options.json:
        worst = {
            key: max(row[key] for row in rows.values())
            for key in ("change_with_step", "change_with_sweeps")
        }
        print(json.dumps({"dt_s": options.dt, **worst, "drives": rows}))


if __name__ == "__main__":
    run_command(main)

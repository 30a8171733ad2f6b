"""Measure how mean speeds depend on the step and on the contact sweeps.

Mean forward speed and yaw rate at nine manoeuvres with motors at prescribed speeds: for every time
step with the usual contact sweeps, and for the middle one with contacts solved out.
"""

import math
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from typing import Annotated, Any

import tyro

from cosim.base.command import Checked, Seconds
from cosim.base.errors import UserError
from cosim.model.params import TABLE_I, TABLE_II
from tests.references.prescribed import Drive, MeanMotion, mean_motion

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
_AVERAGES = ("forward_m_s", "lateral_m_s", "yaw_rate_rad_s")
SOLVED_OUT = 1e-6  # tolerance of contacts iterated until they no longer change


@dataclass(frozen=True, kw_only=True)
class Options(Checked):
    dt: Annotated[tuple[float, ...], tyro.conf.arg(metavar="S")] = (2e-5, 1e-5, 5e-6)
    """Time steps in s, coarse to fine."""
    settle: Seconds = 0.5
    """Simulated time before the averages begin, in s."""
    duration: Seconds = 2.0
    """Simulated time of the averages, in s (whole turns of the motors)."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.dt) < 2 or min(self.dt) <= 0.0:
            raise UserError("--dt: name two or more time steps above 0")


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


def measure(options: Options) -> dict[str, Any]:
    times = {"settle_s": options.settle, "duration_s": options.duration}
    motion, rows = partial(mean_motion, TABLE_I, TABLE_II, **times), {}
    middle = len(options.dt) // 2
    for name, drive in DRIVES.items():
        found = [motion(drive, dt_s=dt_s) for dt_s in options.dt]
        solved = motion(drive, dt_s=options.dt[middle], tolerance=SOLVED_OUT)
        rows[name] = {
            **{field: [getattr(m, field) for m in found] for field in _AVERAGES},
            "solved_out": {field: getattr(solved, field) for field in _AVERAGES},
            "change_with_step": max(_relative_change(*pair) for pair in pairwise(found)),
            "change_with_sweeps": _relative_change(found[middle], solved),
        }
    worst = {
        key: max(row[key] for row in rows.values())
        for key in ("change_with_step", "change_with_sweeps")
    }
    return {"dt_s": list(options.dt), **worst, "drives": rows}

"""Fig. 3: motion of the 1-DOF platform, from a result file of `minirobots platform`."""

from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from analysis.figures.style import UNTESTED, WIDTH_IN, Drawing, figure, verdict
from analysis.reading.results import RESULTS
from cosim.base.colours import BLACK, BLUE, GREY, VERMILION
from cosim.calibration.speed_map import load_calibration
from cosim.machine.platform.motion import Motion, PlatformResult
from cosim.model.params import STEERING

PRINTED_STEP_UM = 290.0
_QUARTERS = (0, 90, 180, 270, 360)
TITLES = {"fig_3": "resembling the printed Fig. 3", "table_ii": "Tables I and II"}


def _draw_cycle(axes: Axes, motion: Motion, scale: float, unit: str) -> None:
    """The last cycle of the file: there the motion repeats itself."""
    turns = motion.theta_rad / (2.0 * np.pi)
    first = int(np.searchsorted(turns, round(turns[-1]) - 1.0))
    y = scale * (motion.position_m[first:] - motion.position_m[first])
    angle = 360.0 * (turns[first:] - turns[first])
    axes.plot(angle, y, color=BLUE)
    axes.axhline(0.0, color=GREY, linewidth=0.6)
    axes.axhline(y[-1], color=GREY, linewidth=0.6)
    arrow: dict[str, Any] = {"arrowstyle": "<->", "color": VERMILION, "shrinkA": 0, "shrinkB": 0}
    axes.annotate("", (340.0, y[-1]), (340.0, 0.0), arrowprops=arrow)
    step = scale * float(motion.net_displacement_m)
    axes.annotate(
        f"{step:.3g} {unit}", (330.0, y[-1] / 2.0), color=VERMILION, ha="right", va="center"
    )
    axes.set(xlabel="θ in degrees", xticks=_QUARTERS, ylabel=f"position y in {unit}")


def _draw_forces(axes: Axes, motion: Motion) -> None:
    turn = motion.theta_rad <= 2.0 * np.pi
    angle = np.rad2deg(motion.theta_rad[turn])
    limit = motion.friction_limit_n[turn]
    axes.plot(angle, motion.driving_force_n[turn], color=BLACK, label="driving force")
    axes.fill_between(angle, -limit, limit, color=GREY, alpha=0.3, lw=0, label="friction holds")
    axes.set(xlabel="θ in degrees", xticks=_QUARTERS, ylabel="force in N")
    axes.set_ylim(top=1.9 * float(motion.driving_force_n.max()))  # room for the legend
    axes.legend(loc="upper right")


def draw(result: PlatformResult) -> Figure:
    """The figure of a result."""
    figure, grid = plt.subplots(2, 3, figsize=(WIDTH_IN, 4.4))
    for row, (name, title) in zip(grid, TITLES.items(), strict=True):
        motion: Motion = getattr(result, name)
        scale, unit = (1e3, "mm") if motion.net_displacement_m >= 1e-4 else (1e6, "µm")
        row[0].plot(1e3 * motion.time_s, scale * motion.position_m, color=BLUE)
        row[0].set(xlabel="time in ms", ylabel=f"position y in {unit}")
        _draw_cycle(row[1], motion, scale, unit)
        _draw_forces(row[2], motion)
        omega, mu = float(motion.omega_rad_s), float(motion.mu)
        row[0].set_title(f"{title}: ω = {omega:.0f} rad/s, µ = {mu:g}", loc="left")
    return figure


def drawing_of(result: PlatformResult, drive: str = "") -> Drawing:
    """Return the figure of a result; `drive` says what a turn of a calibrated robot gives."""
    numbers: dict[str, float] = {}
    for name in TITLES:
        motion: Motion = getattr(result, name)
        numbers[f"{name}_step_um"] = 1e6 * float(motion.net_displacement_m)
        numbers[f"{name}_omega_rad_s"] = float(motion.omega_rad_s)
        numbers[f"{name}_mu"] = float(motion.mu)
    table = result.table
    row = int(np.argmin(np.abs(table.mu - numbers["table_ii_mu"])))
    slip, drift = map(float, table.slip_and_drift_speed_rad_s[row])
    numbers |= {"slip_speed_rad_s": slip, "drift_speed_rad_s": drift}
    step_um, other_mm = numbers["table_ii_step_um"], numbers["fig_3_step_um"] / 1e3
    omega, mu = numbers["table_ii_omega_rad_s"], numbers["table_ii_mu"]
    return Drawing(
        draw(result),
        (
            f"The platform that resembles the printed figure moves {other_mm:.2f} mm a turn at "
            f"{numbers['fig_3_omega_rad_s']:.0f} rad/s with assumed masses and µ = "
            f"{numbers['fig_3_mu']:g}.",
            f"The robot of Tables I and II moves {step_um:.1f} µm a turn at {omega:.0f} rad/s with "
            f"µ = {mu:g}; with µ = {table.mu[row]:g} it slides above {slip:.0f} rad/s and gets "
            f"ahead above {drift:.0f} rad/s.",
        ),
        numbers,
        (
            (
                f"slip from {slip:.1f} rad/s, net motion from {drift:.1f}{drive}; whether pulses "
                "repeat was not measured",
                f"{verdict(bool(np.isfinite(drift)) and step_um > 0.0)}; positioning {UNTESTED}",
            ),
            (
                f"Table II gives {step_um:.1f} µm at {omega:.0f} rad/s; another platform gives "
                f"{other_mm:.3f} mm",
                f"{verdict(abs(step_um - PRINTED_STEP_UM) < 0.1 * PRINTED_STEP_UM)} with Table II",
            ),
        ),
    )


@figure(
    "fig03",
    "Motion of the 1-DOF platform over turns of the motor (left), in one turn (middle), and "
    "driving force next to the friction that holds (right)",
    claim=(
        "above a critical motor speed the platform slides, and in one turn it exhibits a net "
        "displacement that depends on the motor speed."
    ),
    claims=(
        "Sec. II-B: slip above a critical speed, “net displacement per cycle”, “micrometer "
        "positioning”",
        "Fig. 3: steps of 0.29 mm",
    ),
    inputs=("platform",),
)
def make(results: Path) -> Drawing:
    """Draw the figure of a results folder."""
    result, drive = PlatformResult.load(RESULTS["platform"].location(results)), ""
    if RESULTS["calibration"].exists(results):
        speed_m_s = STEERING.drive_speed_m_s
        calibration = load_calibration(RESULTS["calibration"].proof_in(results))
        step_m = speed_m_s * 2.0 * np.pi / calibration.motor_speed("forwards", speed_m_s)
        drive = f", {1e6 * step_m:.0f} µm a turn at {1e3 * speed_m_s:g} mm/s"
    return drawing_of(result, drive)

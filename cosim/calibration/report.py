"""Report of a calibration: numbers for a file and a plot."""

from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from cosim.base.colours import BLUE, GREEN, PURPLE, VERMILION
from cosim.base.plotting import styled
from cosim.calibration.measuring import digest
from cosim.calibration.speed_map import DRIVES, MANOEUVRES, Calibration
from cosim.model.config import CoSimConfig
from cosim.model.params import STEERING

_COLOURS = {"forwards": BLUE, "backwards": VERMILION, "left": GREEN, "right": PURPLE}
DITHERS = ((True, ""), (False, "without dither"))


class CalibrationReport(msgspec.Struct, frozen=True, kw_only=True):
    """The content of calibration.json; units in the names."""

    schema_version: int = 1
    digest: str  # of what the calibration depends on
    mu: float
    trials: int  # how many were simulated
    # In both directions, without hopping
    hop_free_rad_s: float
    largest_speed_m_s: float
    largest_turn_rate_rad_s: float
    # By manoeuvre, with and without the steering's dither: motor speeds, mean and scatter of the
    # speed or yaw rate, share of the time in the air
    curves: dict[str, dict[str, list[float]]]


def report_of(calibration: Calibration, config: CoSimConfig, motor_fmu: Path) -> CalibrationReport:
    """Results of a calibration."""
    curves = {}
    for manoeuvre in MANOEUVRES:
        unit = "m_s" if manoeuvre in DRIVES else "rad_s"
        names = ("motor_speed_rad_s", f"mean_{unit}", f"scatter_{unit}", "airborne_share")
        for dithered, suffix in DITHERS:
            curve = calibration.curve(manoeuvre, dithered=dithered)
            name = "_".join(f"{manoeuvre} {suffix}".split())
            if len(curve.omega_rad_s):
                values = curve.omega_rad_s, curve.mean, curve.scatter, curve.airborne_share
                curves[name] = {n: v.tolist() for n, v in zip(names, values, strict=True)}
    return CalibrationReport(
        digest=digest(config, motor_fmu),
        mu=config.robot.mu,
        trials=len(calibration.phase_rad),
        hop_free_rad_s=calibration.hop_free_rad_s,
        largest_speed_m_s=min(calibration.largest(drive) for drive in DRIVES),
        largest_turn_rate_rad_s=min(calibration.largest(side) for side in ("left", "right")),
        curves=curves,
    )


@styled
def draw(calibration: Calibration, title: str) -> Figure:
    """Speeds, yaw rates, and what speed differences and motor phases do."""
    figure = Figure(figsize=(10.0, 7.5), layout="constrained")
    (speeds, rates), (differences, phases) = figure.subplots(2, 2)
    figure.suptitle(title)
    for manoeuvre in MANOEUVRES:
        axes, factor = (speeds, 1e3) if manoeuvre in DRIVES else (rates, np.rad2deg(1.0))
        for dithered, suffix in DITHERS:
            curve = calibration.curve(manoeuvre, dithered=dithered)
            if not len(curve.omega_rad_s):
                continue
            style: Any = {"capsize": 3.0} if dithered else {"linestyle": "--", "alpha": 0.6}
            style |= {"color": _COLOURS[manoeuvre]}
            style["label"] = f"{manoeuvre}, {suffix}" if suffix else manoeuvre
            y, error = factor * curve.mean, factor * curve.scatter
            axes.errorbar(curve.omega_rad_s, y, error, **style)
    for axes, name in ((speeds, "speed, mm/s"), (rates, "yaw rate, °/s")):
        axes.axvline(calibration.hop_free_rad_s, color="0.5", linestyle=":", label="hops above")
        axes.set(xlabel="motor speed, rad/s", ylabel=name)
        axes.legend()
    _draw_differences(differences, calibration)
    _draw_phases(phases, calibration)
    return figure


def _draw_differences(axes: Axes, calibration: Calibration) -> None:
    """Yaw rate of a driving robot over the speed added to both motors."""
    added = calibration.set_points_rad_s.sum(axis=1) / 2.0
    base = (calibration.set_points_rad_s[:, 1] - calibration.set_points_rad_s[:, 0]) / 2.0
    for manoeuvre in DRIVES:
        differs = (added != 0.0) & (base * MANOEUVRES[manoeuvre][1] > np.abs(added))
        slow, *_, fast = np.unique(np.abs(base[differs]))
        for speed, style in ((fast, "o-"), (slow, "x--")):
            chosen = differs & (np.abs(base) == speed)
            how: Any = {"color": _COLOURS[manoeuvre], "label": f"{manoeuvre}, {speed:.0f} rad/s"}
            rate = np.rad2deg(calibration.yaw_rate_rad_s[chosen])
            axes.plot(added[chosen], rate, style, **how)
    axes.set(xlabel="speed added to both motors, rad/s", ylabel="yaw rate, °/s")
    axes.legend()


def _draw_phases(axes: Axes, calibration: Calibration) -> None:
    """Yaw rate over the initial phase between the motors at the speed nearest to that driven at."""
    speed = np.abs(calibration.set_points_rad_s[~calibration.dithered, 1])
    nearest = speed[np.abs(speed - STEERING.forward_speed_rad_s).argmin()]
    for manoeuvre in ("forwards", "left"):
        d, e = MANOEUVRES[manoeuvre]
        for dithered, style in ((True, "o-"), (False, "x--")):
            set_points = calibration.set_points_rad_s == nearest * np.array([d, e])
            chosen = set_points.all(axis=1) & (calibration.dithered == dithered)
            label = f"{manoeuvre}, {'with' if dithered else 'without'} dither"
            phase = np.rad2deg(calibration.phase_rad[chosen])
            rate = np.rad2deg(calibration.yaw_rate_rad_s[chosen])
            axes.plot(phase, rate, style, color=_COLOURS[manoeuvre], label=label)
    axes.set_xlabel(f"initial phase between the motors, ° ({nearest:.0f} rad/s)")
    axes.set_ylabel("yaw rate, °/s")
    axes.legend()


def manoeuvre_rows(calibration: Calibration) -> list[tuple[str, ...]]:
    """Rows of a table: manoeuvre, motor speed, mean, scatter, airborne."""
    rows = []
    for manoeuvre in MANOEUVRES:
        curve = calibration.curve(manoeuvre)
        factor, unit = (1e3, "mm/s") if manoeuvre in DRIVES else (np.rad2deg(1.0), "°/s")
        columns = (curve.omega_rad_s, curve.mean, curve.scatter, curve.airborne_share)
        for omega, mean, scatter, airborne in zip(*columns, strict=True):
            speeds = f"{omega:.0f} rad/s", f"{factor * mean:.2f} {unit}", f"{factor * scatter:.2f}"
            rows.append((manoeuvre, *speeds, f"{airborne:.2%}"))
    return rows

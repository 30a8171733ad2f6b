"""Report of a calibration: numbers for a file and a plot."""

from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from cosim.base.colours import BLUE, GREEN, ORANGE, PURPLE, SKY, VERMILION
from cosim.base.plotting import styled
from cosim.calibration.measuring import digest
from cosim.calibration.speed_map import DIRECTIONS, DRIVES, TURNS, Calibration
from cosim.model.config import CoSimConfig

_COLOURS = dict(zip(DIRECTIONS, (BLUE, VERMILION, SKY, ORANGE, GREEN, PURPLE), strict=True))
DITHERS = ((True, ""), (False, "without dither"))


class CalibrationReport(msgspec.Struct, frozen=True, kw_only=True):
    """The content of calibration.json; units in the names."""

    schema_version: int = 1
    digest: str  # of what the calibration depends on
    mu: float
    trials: int  # how many were simulated
    # Without hopping, ahead and back and in both turns
    hop_free_rad_s: float
    largest_speed_m_s: float
    largest_turn_rate_rad_s: float
    # By primitive, with and without the steering's dither: motor speeds, mean and scatter of the
    # speed or yaw rate, share of the time in the air
    curves: dict[str, dict[str, list[float]]]


def report_of(calibration: Calibration, config: CoSimConfig, motor_fmu: Path) -> CalibrationReport:
    """Results of a calibration."""
    curves = {}
    for primitive in calibration.primitives:
        unit = "m_s" if primitive in DRIVES else "rad_s"
        names = ("motor_speed_rad_s", f"mean_{unit}", f"scatter_{unit}", "airborne_share")
        for dithered, suffix in DITHERS:
            curve = calibration.curve(primitive, dithered=dithered)
            name = "_".join(f"{primitive} {suffix}".split())
            if len(curve.omega_rad_s):
                values = curve.omega_rad_s, curve.mean, curve.scatter, curve.airborne_share
                curves[name] = {n: v.tolist() for n, v in zip(names, values, strict=True)}
    return CalibrationReport(
        digest=digest(config, motor_fmu),
        mu=config.robot.mu,
        trials=len(calibration.phase_rad),
        hop_free_rad_s=calibration.hop_free_rad_s,
        largest_speed_m_s=calibration.largest_of(DRIVES[:2]),
        largest_turn_rate_rad_s=calibration.largest_of(TURNS),
        curves=curves,
    )


@styled
def draw(calibration: Calibration, title: str, driven_rad_s: float) -> Figure:
    """Speeds, yaw rates, and what speed differences and motor phases do.

    Args:
        driven_rad_s: speed of the motors of a robot that drives.
    """
    figure = Figure(figsize=(10.0, 7.5), layout="constrained")
    (speeds, rates), (differences, phases) = figure.subplots(2, 2)
    figure.suptitle(title)
    for primitive in calibration.primitives:
        axes, factor = (speeds, 1e3) if primitive in DRIVES else (rates, np.rad2deg(1.0))
        for dithered, suffix in DITHERS:
            curve = calibration.curve(primitive, dithered=dithered)
            if not len(curve.omega_rad_s):
                continue
            style: Any = {"capsize": 3.0} if dithered else {"linestyle": "--", "alpha": 0.6}
            style |= {"color": _COLOURS[primitive]}
            style["label"] = f"{primitive}, {suffix}" if suffix else primitive
            y, error = factor * curve.mean, factor * curve.scatter
            axes.errorbar(curve.omega_rad_s, y, error, **style)
    for axes, name in ((speeds, "speed, mm/s"), (rates, "yaw rate, °/s")):
        axes.axvline(calibration.hop_free_rad_s, color="0.5", linestyle=":", label="hops above")
        axes.set(xlabel="motor speed, rad/s", ylabel=name)
        axes.legend()
    _draw_differences(differences, calibration)
    _draw_phases(phases, calibration, driven_rad_s)
    return figure


def _draw_differences(axes: Axes, calibration: Calibration) -> None:
    """Yaw rate of a driving robot over the difference that is added to its motors' speeds."""
    added = calibration.difference_rad_s
    for k, primitive in enumerate(DRIVES):
        differs = (added != 0.0) & (calibration.primitive == k)
        speeds = np.unique(calibration.set_speed_rad_s[differs])
        for speed, style in zip(
            speeds[[-1, 0]] if len(speeds) else (), ("o-", "x--"), strict=False
        ):
            chosen = differs & (calibration.set_speed_rad_s == speed)
            how: Any = {"color": _COLOURS[primitive], "label": f"{primitive}, {speed:.0f} rad/s"}
            rate = np.rad2deg(calibration.yaw_rate_rad_s[chosen])
            axes.plot(added[chosen], rate, style, **how)
    axes.set(xlabel="speed difference, rad/s", ylabel="yaw rate, °/s")
    axes.legend()


def _draw_phases(axes: Axes, calibration: Calibration, driven_rad_s: float) -> None:
    """Yaw rate over the initial phase between the motors at the speed nearest to that driven at."""
    speeds = calibration.set_speed_rad_s[~calibration.dithered]
    for primitive in ("forwards", "left_turn") if len(speeds) else ():
        nearest = speeds[np.abs(speeds - driven_rad_s).argmin()]
        same = calibration.primitive == list(DIRECTIONS).index(primitive)
        same &= (calibration.set_speed_rad_s == nearest) & (calibration.difference_rad_s == 0.0)
        for dithered, style in ((True, "o-"), (False, "x--")):
            chosen = same & (calibration.dithered == dithered)
            label = f"{primitive}, {'with' if dithered else 'without'} dither"
            phase = np.rad2deg(calibration.phase_rad[chosen])
            rate = np.rad2deg(calibration.yaw_rate_rad_s[chosen])
            axes.plot(phase, rate, style, color=_COLOURS[primitive], label=label)
        axes.set_title(f"{nearest:.0f} rad/s")
        axes.legend()
    axes.set(xlabel="initial phase between the motors, °", ylabel="yaw rate, °/s")


def speed_rows(calibration: Calibration) -> list[tuple[str, ...]]:
    """Rows of a table: primitive, motor speed, mean, scatter, airborne."""
    rows = []
    for primitive in calibration.primitives:
        curve = calibration.curve(primitive)
        factor, unit = (1e3, "mm/s") if primitive in DRIVES else (np.rad2deg(1.0), "°/s")
        columns = (curve.omega_rad_s, curve.mean, curve.scatter, curve.airborne_share)
        for omega, mean, scatter, airborne in zip(*columns, strict=True):
            speeds = f"{omega:.0f} rad/s", f"{factor * mean:.2f} {unit}", f"{factor * scatter:.2f}"
            rows.append((primitive.replace("_", " "), *speeds, f"{airborne:.2%}"))
    return rows

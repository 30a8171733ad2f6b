"""The rows of docs/validation.md: simulated numbers next to published ones."""

import math
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import numpy as np

from benchmarks.published.driving import PARAMETERS, MeasuredSpeed, value_of
from benchmarks.published.points import PublishedPath, PublishedSpeed, step_um
from cosim.model.preset import find_preset

# A parameter explains a difference if no more than this factor of it does, at first order.
_MOST_FACTOR = 2.0
Row = dict[str, Any]  # with the columns' names and units; None where nothing is published


def rows_of(
    speeds: Mapping[PublishedSpeed, MeasuredSpeed],
    slopes: Mapping[PublishedSpeed, tuple[Mapping[str, float | None], Mapping[str, float]]],
    paths: Iterable[tuple[PublishedPath, bool, list[list[float]]]],
) -> dict[str, list[Row]]:
    """Return measured numbers next to published ones, by the name of their table.

    `speeds` are in mm/s, or °/s, over phases between the motors. `reversals` are speeds backwards
    over those forwards at one motor speed; the published one is of two speeds. `sensitivities` are
    derivatives d ln v / d ln p, with the p of the published speed at first order. `paths` are how
    far robots that drive by the clock end from where they should.

    Args:
        speeds: measured, by the published one.
        slopes: d ln v / d ln p by the parameter, simulated and in closed form.
        paths: published; whether motors had the steering's dither; and of each robot displacement
            in m and turned angle in rad.
    """
    rows = [_speed_row(*pair) for pair in speeds.items()]
    return {
        "speeds": rows,
        "reversals": list(_reversals(rows)),
        "sensitivities": [
            row
            for point, found in slopes.items()
            for row in _sensitivity_rows(point, speeds[point].mean, *found)
        ],
        "paths": [_path_row(*path) for path in paths],
    }


def _speed_row(point: PublishedSpeed, measured: MeasuredSpeed) -> Row:
    turning = point.manoeuvre == "left_turn"
    factor = math.degrees(1.0) if turning else 1e3
    simulated, omega, published = factor * measured.mean, point.omega_rad_s, point.value
    return {
        "preset": point.preset,
        "manoeuvre": point.manoeuvre,
        "motor_speed_rad_s": omega,
        "unit": "°/s" if turning else "mm/s",
        "simulated": simulated,
        "least": factor * measured.least,
        "largest": factor * measured.largest,
        "airborne_share": measured.airborne_share,
        "published": published,
        "ratio": _ratio(simulated, published),
        "step_um": None if turning else step_um(simulated, omega),
        "published_step_um": None if turning or not published else step_um(published, omega),
        "certainty": point.certainty,
        "source": point.source,
    }


def _ratio(simulated: float, published: float | None) -> float | None:
    return None if published is None else simulated / published


def _reversals(speeds: Iterable[Row]) -> Iterator[Row]:
    """Of every machine and motor speed with both directions."""
    rows = {(row["preset"], row["motor_speed_rad_s"], row["manoeuvre"]): row for row in speeds}
    for (preset, omega, manoeuvre), back in rows.items():
        ahead = rows.get((preset, omega, "forwards"))
        if manoeuvre == "backwards" and ahead is not None:
            simulated, published = back["simulated"] / ahead["simulated"], None
            if back["published"] and ahead["published"]:
                published = back["published"] / ahead["published"]
            yield {
                "preset": preset,
                "motor_speed_rad_s": omega,
                "simulated": simulated,
                "published": published,
                "ratio": _ratio(simulated, published),
                "source": back["source"],
            }


def _sensitivity_rows(
    point: PublishedSpeed,
    speed_m_s: float,
    dynamics: Mapping[str, float | None],
    platform: Mapping[str, float],
) -> Iterator[Row]:
    config = find_preset(point.preset).config()
    assert point.value is not None
    wanted = math.log(1e-3 * point.value / speed_m_s) if speed_m_s > 0.0 else math.nan
    for name, slope in dynamics.items():
        value = value_of(config, name) if name in PARAMETERS else point.omega_rad_s
        change = wanted / slope if slope else math.nan
        explains = abs(change) <= math.log(_MOST_FACTOR)
        yield {
            "preset": point.preset,
            "motor_speed_rad_s": point.omega_rad_s,
            "parameter": name,
            "value": value,
            "dynamics": slope,
            "platform": platform.get(name),
            "explains": value * math.exp(change) if explains else None,
        }


def _path_row(path: PublishedPath, dithered: bool, driven: list[list[float]]) -> Row:
    ends = np.array(driven) - path.meant
    off_mm = 1e3 * np.hypot(ends[:, 0], ends[:, 1])
    turned = np.degrees(ends[:, 2])
    return {
        "path": path.name,
        "dithered": dithered,
        "robots": len(ends),
        "off_mm": float(off_mm.mean()),
        "off_largest_mm": float(off_mm.max()),
        "sideways_mm": float(1e3 * ends[:, 1].mean()),
        "turned_deg": float(turned.mean()),
        "turned_scatter_deg": float(turned.std()),
        "published_mm": path.off_mm,
        "ratio": float(off_mm.mean() / np.mean(path.off_mm)) if path.off_mm else None,
        "published_deg": path.turned_deg,
        "source": path.source,
    }

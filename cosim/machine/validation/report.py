"""The rows and tables of docs/validation.md: simulated numbers next to published ones."""

import math
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import msgspec
import numpy as np

from cosim.base.table import Column, Columns, markdown
from cosim.machine.validation.driving import PARAMETERS, MeasuredSpeed, value_of
from cosim.machine.validation.published import PublishedPath, PublishedSpeed, step_um
from cosim.model.preset import find_preset

# A parameter explains a difference if no more than this factor of it does, at first order.
_MOST_FACTOR = 2.0
Row = dict[str, Any]  # with the columns' names and units; None where nothing is published


class ValidationReport(msgspec.Struct, frozen=True, kw_only=True):
    """The content of validation.json."""

    schema_version: int = 1
    phases: int
    seed: int
    speeds: tuple[Row, ...]  # in mm/s, or °/s, over phases between the motors
    # Speed backwards over that forwards at one motor speed; the published one is of two speeds
    reversals: tuple[Row, ...]
    # Derivatives d ln v / d ln p; `explains` is the p of the published speed, at first order
    sensitivities: tuple[Row, ...]
    # Ends of a path driven by the clock: distance and angle off where it should have ended
    paths: tuple[Row, ...]
    # Droplets: measured, and simulated for what is not known of them; then robot by robot
    droplets: tuple[Row, ...] = ()
    robots: tuple[Row, ...] = ()


def report_of(
    speeds: Mapping[PublishedSpeed, MeasuredSpeed],
    slopes: Mapping[PublishedSpeed, tuple[Mapping[str, float | None], Mapping[str, float]]],
    paths: Iterable[tuple[PublishedPath, bool, list[list[float]]]],
    phases: int,
    seed: int,
) -> ValidationReport:
    """Measured numbers next to published ones.

    Args:
        slopes: d ln v / d ln p by the parameter, simulated and in closed form.
        paths: published; whether motors had the steering's dither; and of each robot displacement
            in m and turned angle in rad.
    """
    rows = tuple(_speed_row(*pair) for pair in speeds.items())
    return ValidationReport(
        phases=phases,
        seed=seed,
        speeds=rows,
        reversals=tuple(_reversals(rows)),
        sensitivities=tuple(
            row
            for point, found in slopes.items()
            for row in _sensitivity_rows(point, speeds[point].mean, *found)
        ),
        paths=tuple(_path_row(*path) for path in paths),
    )


def _speed_row(point: PublishedSpeed, measured: MeasuredSpeed) -> Row:
    turning = point.manoeuvre == "left"
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


def _column(heading: str, form: str) -> Column:
    """Return the column of a format; a dash where a value of it is None."""

    def text(row: Row) -> str:
        try:
            return form.format(**row)
        except TypeError:
            return "–"

    return Column(heading, text)


def _source(published: str, certainty: str) -> Column:
    """Return the column with the source of a published value, and its certainty."""

    def text(row: Row) -> str:
        short = row["source"].partition(",")[0]
        return f"{short}, {certainty or row['certainty']}" if row[published] else "–"

    return Column("source", text)


_PRESET, _OMEGA = _column("preset", "{preset}"), _column("rad/s", "{motor_speed_rad_s:.0f}")
_RATIO = _column("ratio", "{ratio:.2f}")
_TABLES: dict[str, tuple[str, Columns]] = {
    "droplets": (
        "Droplets",
        (
            _column("pulses", "{pulses}"),
            _column("µ", "{mu:g}"),
            _column("spin-up", "{spin_up_ms:.0f} ms"),
            _column("unbalance, fitted", "{unbalance_g_mm:.2f} g mm"),
            _column("robots within reach", "{robots}"),
            _column(
                "drive over turn, mm/rad",
                "{drive_over_turn_mm_rad:.1f} ({least_mm_rad:.1f} to {largest_mm_rad:.1f})",
            ),
            _column("forward over backward", "{forward_over_backward:.2f}"),
            _column("spread of the unbalance", "{unbalance_spread:.0%}"),
            _column("others within", "{others_within:d} of 10"),
            _column("turning, rms error", "{turn_error:.0%}"),
        ),
    ),
    "robots": (
        "Droplets, robot by robot",
        (
            _column("robot", "{robot}"),
            _column("drive", "{drive_mm_s:.2f} mm/s"),
            _column("turn, measured", "{turn_deg_s:.1f} °/s"),
            _column("turn, simulated", "{simulated_deg_s:.1f} °/s"),
            _column("unbalance", "{unbalance_g_mm:.2f} g mm"),
        ),
    ),
    "speeds": (
        "Speeds",
        (
            _PRESET,
            _column("manoeuvre", "{manoeuvre}"),
            _OMEGA,
            _column(
                "simulated (range over phases)",
                "{simulated:.2f} ({least:.2f} to {largest:.2f}) {unit}",
            ),
            _column("in the air", "{airborne_share:.0%}"),
            _column("published", "{published:g}"),
            _RATIO,
            _column("step, simulated", "{step_um:.1f} µm"),
            _column("published", "{published_step_um:.1f} µm (derived)"),
            _source("published", ""),
        ),
    ),
    "reversals": (
        "Backwards",
        (
            _PRESET,
            _OMEGA,
            _column("backwards over forwards, simulated", "{simulated:.2f}"),
            _column("published", "{published:.2f}"),
            _RATIO,
            _source("published", "derived"),
        ),
    ),
    "sensitivities": (
        "What a speed depends on",
        (
            _PRESET,
            _OMEGA,
            _column("parameter", "{parameter}"),
            _column("value", "{value:.3g}"),
            _column("dynamics", "{dynamics:+.2f}"),
            _column("platform", "{platform:+.2f}"),
            _column("explains", "{explains:.3g}"),
        ),
    ),
    "paths": (
        "Paths by the clock",
        (
            _column("path", "{path}"),
            Column("dither", lambda row: "on" if row["dithered"] else "off"),
            _column("off, simulated", "{off_mm:.1f} mm"),
            _column("largest", "{off_largest_mm:.1f} mm"),
            _column("to the left", "{sideways_mm:+.1f} mm"),
            _column("turned, simulated", "{turned_deg:+.1f} ± {turned_scatter_deg:.1f}°"),
            Column(
                "off, published",
                lambda row: " and ".join(f"{off:g} mm" for off in row["published_mm"]) or "–",
            ),
            _RATIO,
            _column("turned", "{published_deg:g}°"),
            _source("published_mm", "seen"),
        ),
    ),
}


def tables(report: ValidationReport) -> list[tuple[str, Columns, tuple[Row, ...]]]:
    """Title, columns and rows of all tables."""
    return [(title, columns, getattr(report, rows)) for rows, (title, columns) in _TABLES.items()]


def text_of(report: ValidationReport) -> str:
    """Return the tables as Markdown, with the sources of their numbers."""
    texts = [f"## {title}\n\n{markdown(columns, rows)}" for title, columns, rows in tables(report)]
    sources = dict.fromkeys(f"- {row['source']}" for row in (*report.speeds, *report.paths))
    return "\n\n".join([*texts, "\n".join(sources)])

"""The rows of docs/validation.md, simulated and published; `tables` has the text."""

import math
from collections.abc import Iterator, Mapping, Sequence

import msgspec
import numpy as np

from cosim.machine.validation.driving import MeasuredSpeed, v_meant_m
from cosim.machine.validation.published import PublishedPath, PublishedSpeed, step_um
from cosim.machine.validation.sensitivity import PARAMETERS, value_of
from cosim.model.preset import find_preset

# A parameter explains a difference if no more than this factor of it does, at first order.
_MOST_FACTOR = 2.0


class SpeedRow(msgspec.Struct, frozen=True, kw_only=True):
    """A speed in mm/s or a yaw rate in °/s, over phases between the motors; None: not published."""

    preset: str
    manoeuvre: str
    motor_speed_rad_s: float
    unit: str
    simulated: float
    least: float
    largest: float
    airborne_share: float
    published: float | None
    ratio: float | None
    step_um: float | None
    published_step_um: float | None
    certainty: str
    source: str


class ReversalRow(msgspec.Struct, frozen=True, kw_only=True):
    """Speed backwards over that forwards at one motor speed; the published one is of two speeds."""

    preset: str
    motor_speed_rad_s: float
    simulated: float
    published: float | None
    ratio: float | None
    source: str


class SensitivityRow(msgspec.Struct, frozen=True, kw_only=True):
    """A derivative d ln v / d ln p; `explains` is the p of the published speed, at first order."""

    preset: str
    motor_speed_rad_s: float
    parameter: str
    value: float
    dynamics: float | None
    platform: float | None
    explains: float | None


class PathRow(msgspec.Struct, frozen=True, kw_only=True):
    """Ends of a path driven by the clock: distance and angle off where it should have ended."""

    path: str
    dithered: bool
    robots: int
    off_mm: float
    off_largest_mm: float
    sideways_mm: float
    turned_deg: float
    turned_scatter_deg: float
    published_mm: tuple[float, ...]
    ratio: float | None
    published_deg: float | None
    source: str


class ValidationReport(msgspec.Struct, frozen=True, kw_only=True):
    """The content of validation.json."""

    schema_version: int = 1
    phases: int
    seed: int
    speeds: tuple[SpeedRow, ...]
    reversals: tuple[ReversalRow, ...]
    sensitivities: tuple[SensitivityRow, ...]
    paths: tuple[PathRow, ...]


def report_of(
    speeds: Sequence[tuple[PublishedSpeed, MeasuredSpeed]],
    slopes: Sequence[tuple[PublishedSpeed, Mapping[str, float | None], Mapping[str, float]]],
    paths: Sequence[tuple[PublishedPath | None, bool, list[list[float]]]],
    phases: int,
    seed: int,
) -> ValidationReport:
    """Measured numbers next to published ones.

    Args:
        speeds: published and measured.
        slopes: where; d ln v / d ln p by the parameter, simulated and in closed form.
        paths: published, None for the V-shaped steps; whether motors had the steering's dither;
            and of each robot displacement in m and turned angle in rad, over what was intended.
        phases: between the motors, of each speed.
        seed: of noise and phases on the paths.
    """
    rows, measured = tuple(_speed_row(*pair) for pair in speeds), dict(speeds)
    return ValidationReport(
        phases=phases,
        seed=seed,
        speeds=rows,
        reversals=tuple(_reversals(rows)),
        sensitivities=tuple(
            row
            for point, dynamics, platform in slopes
            for row in _sensitivity_rows(point, measured[point].mean, dynamics, platform)
        ),
        paths=tuple(_path_row(*path) for path in paths),
    )


def _speed_row(point: PublishedSpeed, measured: MeasuredSpeed) -> SpeedRow:
    turning = point.manoeuvre == "left"
    factor = math.degrees(1.0) if turning else 1e3
    simulated, omega = factor * measured.mean, point.omega_rad_s
    return SpeedRow(
        preset=point.preset,
        manoeuvre=point.manoeuvre,
        motor_speed_rad_s=omega,
        unit="°/s" if turning else "mm/s",
        simulated=simulated,
        least=factor * measured.least,
        largest=factor * measured.largest,
        airborne_share=measured.airborne_share,
        published=point.value,
        ratio=None if point.value is None else simulated / point.value,
        step_um=None if turning else step_um(simulated, omega),
        published_step_um=None if turning or point.value is None else step_um(point.value, omega),
        certainty=point.certainty,
        source=point.source,
    )


def _reversals(speeds: Sequence[SpeedRow]) -> Iterator[ReversalRow]:
    """Of every machine and motor speed with both directions."""
    rows = {(row.preset, row.motor_speed_rad_s, row.manoeuvre): row for row in speeds}
    for (preset, omega, manoeuvre), back in rows.items():
        ahead = rows.get((preset, omega, "forwards"))
        if manoeuvre == "backwards" and ahead is not None:
            simulated, published = back.simulated / ahead.simulated, None
            if back.published is not None and ahead.published is not None:
                published = back.published / ahead.published
            yield ReversalRow(
                preset=preset,
                motor_speed_rad_s=omega,
                simulated=simulated,
                published=published,
                ratio=None if published is None else simulated / published,
                source=back.source,
            )


def _sensitivity_rows(
    point: PublishedSpeed,
    speed_m_s: float,
    dynamics: Mapping[str, float | None],
    platform: Mapping[str, float],
) -> list[SensitivityRow]:
    config = find_preset(point.preset).config()
    assert point.value is not None
    wanted = math.log(1e-3 * point.value / speed_m_s) if speed_m_s > 0.0 else math.nan
    rows = []
    for name, slope in dynamics.items():
        value = value_of(config, name) if name in PARAMETERS else point.omega_rad_s
        change = wanted / slope if slope else math.nan
        explains = abs(change) <= math.log(_MOST_FACTOR)
        rows.append(
            SensitivityRow(
                preset=point.preset,
                motor_speed_rad_s=point.omega_rad_s,
                parameter=name,
                value=value,
                dynamics=slope,
                platform=platform.get(name),
                explains=value * math.exp(change) if explains else None,
            )
        )
    return rows


def _path_row(path: PublishedPath | None, dithered: bool, driven: list[list[float]]) -> PathRow:
    ends = np.array(driven)
    off_mm = 1e3 * np.hypot(ends[:, 0], ends[:, 1])
    turned = np.degrees(ends[:, 2])
    if path is None:
        name = f"V-shaped steps, {1e3 * v_meant_m():.1f} mm to the left"
    else:
        name = f"{'triangle' if path.sides == 3 else 'square'} of {path.side_mm / 10.0:g} cm"
    return PathRow(
        path=name,
        dithered=dithered,
        robots=len(ends),
        off_mm=float(off_mm.mean()),
        off_largest_mm=float(off_mm.max()),
        sideways_mm=float(1e3 * ends[:, 1].mean()),
        turned_deg=float(turned.mean()),
        turned_scatter_deg=float(turned.std()),
        published_mm=() if path is None else path.off_mm,
        ratio=None if path is None else float(off_mm.mean() / np.mean(path.off_mm)),
        published_deg=None if path is None else path.turned_deg,
        source="not at hand" if path is None else path.source,
    )

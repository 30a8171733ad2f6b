"""The tables of docs/validation.md as text."""

from typing import Any, NamedTuple

from cosim.base.table import Column, Columns, field, known, markdown
from cosim.machine.validation.report import SpeedRow, ValidationReport


def _source(row: Any) -> str:
    return row.source.partition(",")[0]


def _speed(row: SpeedRow) -> str:
    return f"{row.simulated:.2f} ({row.least:.2f} to {row.largest:.2f}) {row.unit}"


_PRESET, _OMEGA = field("preset"), field("motor_speed_rad_s", "{:.0f}", "rad/s")
_RATIO = field("ratio", "{:.2f}")
SPEEDS = (
    _PRESET,
    field("manoeuvre"),
    _OMEGA,
    Column("simulated (range over phases)", _speed),
    field("airborne_share", "{:.0%}", "in the air"),
    field("published", "{:g}"),
    _RATIO,
    field("step_um", "{:.1f} µm", "step, simulated"),
    field("published_step_um", "{:.1f} µm (derived)", "published"),
    Column(
        "source", lambda row: "–" if row.published is None else f"{_source(row)}, {row.certainty}"
    ),
)
REVERSALS = (
    _PRESET,
    _OMEGA,
    field("simulated", "{:.2f}", "backwards over forwards, simulated"),
    field("published", "{:.2f}"),
    _RATIO,
    Column("source", lambda row: "–" if row.published is None else f"{_source(row)}, derived"),
)
SENSITIVITIES = (
    _PRESET,
    _OMEGA,
    field("parameter"),
    field("value", "{:.3g}"),
    field("dynamics", "{:+.2f}"),
    field("platform", "{:+.2f}"),
    field("explains", "{:.3g}"),
)
PATHS = (
    field("path"),
    Column("dither", lambda row: "on" if row.dithered else "off"),
    field("off_mm", "{:.1f} mm", "off, simulated"),
    field("off_largest_mm", "{:.1f} mm", "largest"),
    field("sideways_mm", "{:+.1f} mm", "to the left"),
    Column(
        "turned, simulated", lambda row: f"{row.turned_deg:+.1f} ± {row.turned_scatter_deg:.1f}°"
    ),
    Column("off, published", lambda r: " and ".join(f"{o:g} mm" for o in r.published_mm) or "–"),
    _RATIO,
    Column("turned", lambda row: known(row.published_deg, "{:g}°")),
    Column("source", lambda row: f"{_source(row)}, seen" if row.published_mm else "–"),
)


class TitledTable(NamedTuple):
    """A table of a report: its title, columns and rows."""

    title: str
    columns: Columns
    rows: tuple[Any, ...]


def tables(report: ValidationReport) -> list[TitledTable]:
    """Return all tables."""
    return [
        TitledTable("Speeds", SPEEDS, report.speeds),
        TitledTable("Backwards", REVERSALS, report.reversals),
        TitledTable("What a speed depends on", SENSITIVITIES, report.sensitivities),
        TitledTable("Paths by the clock", PATHS, report.paths),
    ]


def text_of(report: ValidationReport) -> str:
    """Return the tables as Markdown, with the sources of their numbers."""
    parts = [f"## {t.title}\n\n{markdown(t.columns, t.rows)}" for t in tables(report)]
    sources = dict.fromkeys(f"- {row.source}" for row in (*report.speeds, *report.paths))
    return "\n\n".join([*parts, "\n".join(sources)])

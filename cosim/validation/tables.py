"""The tables of docs/validation.md as text."""

from collections.abc import Sequence

from cosim.validation.report import PathRow, ReversalRow, SensitivityRow, SpeedRow, ValidationReport


def _text(value: float | None, form: str = ".2f") -> str:
    return "–" if value is None else format(value, form)


def _name(source: str) -> str:
    return source.partition(",")[0]


SPEED_HEADER = (
    "preset",
    "manoeuvre",
    "rad/s",
    "ours (range over phases)",
    "in the air",
    "theirs",
    "ratio",
    "step, ours",
    "theirs",
    "source",
)
SENSITIVITY_HEADER = ("preset", "rad/s", "parameter", "value", "dynamics", "platform", "explains")
REVERSAL_HEADER = ("preset", "rad/s", "backwards over forwards, ours", "theirs", "ratio", "source")
PATH_HEADER = (
    "path",
    "dither",
    "off, ours",
    "largest",
    "to the left",
    "turned, ours",
    "off, theirs",
    "ratio",
    "turned",
    "source",
)


def speed_cells(row: SpeedRow) -> tuple[str, ...]:
    """A row as text."""
    published = row.theirs is not None
    return (
        row.preset,
        row.manoeuvre,
        f"{row.motor_speed_rad_s:.0f}",
        f"{row.ours:.2f} ({row.least:.2f} to {row.largest:.2f}) {row.unit}",
        f"{row.airborne_share:.0%}",
        _text(row.theirs, "g"),
        _text(row.ratio),
        "–" if row.step_um is None else f"{row.step_um:.1f} µm",
        "–" if row.their_step_um is None else f"{row.their_step_um:.1f} µm (derived)",
        f"{_name(row.source)}, {row.sure}" if published else "–",
    )


def reversal_cells(row: ReversalRow) -> tuple[str, ...]:
    """A row as text."""
    return (
        row.preset,
        f"{row.motor_speed_rad_s:.0f}",
        f"{row.ours:.2f}",
        _text(row.theirs),
        _text(row.ratio),
        "–" if row.theirs is None else f"{_name(row.source)}, derived",
    )


def sensitivity_cells(row: SensitivityRow) -> tuple[str, ...]:
    """A row as text."""
    return (
        row.preset,
        f"{row.motor_speed_rad_s:.0f}",
        row.parameter,
        f"{row.value:.3g}",
        _text(row.dynamics, "+.2f"),
        _text(row.platform, "+.2f"),
        _text(row.explains, ".3g"),
    )


def path_cells(row: PathRow) -> tuple[str, ...]:
    """A row as text."""
    return (
        row.path,
        "on" if row.dithered else "off",
        f"{row.off_mm:.1f} mm",
        f"{row.off_largest_mm:.1f} mm",
        f"{row.sideways_mm:+.1f} mm",
        f"{row.turned_deg:+.1f} ± {row.turned_scatter_deg:.1f}°",
        " and ".join(f"{off:g} mm" for off in row.theirs_mm) or "–",
        _text(row.ratio),
        _text(row.theirs_deg, "g") + ("" if row.theirs_deg is None else "°"),
        f"{_name(row.source)}, seen" if row.theirs_mm else "–",
    )


Table = tuple[str, Sequence[str], list[tuple[str, ...]]]


def tables(report: ValidationReport) -> list[Table]:
    """Title, header and rows of every table."""
    return [
        ("Speeds", SPEED_HEADER, [speed_cells(row) for row in report.speeds]),
        ("Backwards", REVERSAL_HEADER, [reversal_cells(row) for row in report.reversals]),
        (
            "What a speed depends on",
            SENSITIVITY_HEADER,
            [sensitivity_cells(row) for row in report.sensitivities],
        ),
        ("Paths by the clock", PATH_HEADER, [path_cells(row) for row in report.paths]),
    ]


def markdown(report: ValidationReport) -> str:
    """The tables as Markdown, with the sources of their numbers."""
    parts = []
    for title, header, rows in tables(report):
        lines = [header, ["---"] * len(header), *rows]
        parts.append(f"## {title}\n\n" + "\n".join(f"| {' | '.join(row)} |" for row in lines))
    sources = dict.fromkeys(f"- {row.source}" for row in (*report.speeds, *report.paths))
    return "\n\n".join([*parts, "\n".join(sources)]) + "\n"

"""Tables of rows: on a terminal, as Markdown, and as files for programs."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import msgspec

from cosim.base.errors import visible
from cosim.base.storage import replacing, write_json, write_whole

if TYPE_CHECKING:
    from rich.console import Console

_BORDER = 3  # of each column: a line and a space on both sides
_NAME_WIDTH = 24  # up to which a name stands on one line


class Column(NamedTuple):
    """A column of a table: its heading, and the text of a row's cell."""

    heading: str
    text: Callable[[Any], str]


Columns = Sequence[Column]


def field(name: str, form: str = "{}", heading: str | None = None) -> Column:
    """Return the column of an attribute in a format; a dash where it is None."""
    title = name.replace("_", " ") if heading is None else heading
    return Column(title, lambda row: format_value(getattr(row, name), form))


def format_value(value: Any, form: str) -> str:
    """Return a value in a format, a dash for None."""
    return "–" if value is None else form.format(value)


def markdown(columns: Columns, rows: Iterable[Any]) -> str:
    """Return a table as Markdown."""
    headings = [column.heading for column in columns]
    lines = [headings, ["---"] * len(headings), *_cells(columns, rows)]
    cells = [[" ".join(cell.replace("|", "\\|").split("\n")) for cell in line] for line in lines]
    return "\n".join("| " + " | ".join(line) + " |" for line in cells)


def show(columns: Columns, rows: Iterable[Any], **layout: Any) -> None:
    """Print a table; `layout` is that of `show_texts`."""
    show_texts([column.heading for column in columns], _cells(columns, rows), **layout)


def show_texts(
    header: Sequence[str],
    rows: Iterable[Sequence[str]],
    *,
    names: int = 1,
    numbers: int = 0,
    title: str | None = None,
    console: "Console | None" = None,
) -> None:
    """Print a table, or several if the console is too narrow for one: no number is ever cut.

    Args:
        names: how many of the first columns name a row: each table has them, and long ones in
            several lines.
        numbers: how many of the last columns are set flush right.
    """
    from rich.cells import cell_len  # noqa: PLC0415 - slow to import
    from rich.console import Console  # noqa: PLC0415
    from rich.table import Table  # noqa: PLC0415
    from rich.text import Text  # noqa: PLC0415

    console, rows = console or Console(), list(rows)
    columns = list(zip(header, *rows, strict=True))
    widths = [max(map(cell_len, column)) + _BORDER for column in columns]
    left = 1 + sum(min(width, _NAME_WIDTH + _BORDER) for width in widths[:names])
    rest, parts = list(range(names, len(header))), 0
    while rest or not parts:  # once where all columns are names
        shown, parts = rest[:1], parts + 1
        del rest[:1]
        while rest and left + sum(widths[k] for k in (*shown, rest[0])) <= console.width:
            shown.append(rest.pop(0))
        # What is a `Text` has no markup, which names of files may look like.
        table = Table(title=None if title is None else Text(title, "table.title"))
        for k in (*range(names), *shown):
            justify = "right" if k >= len(header) - numbers else "left"
            table.add_column(Text(header[k]), justify=justify, no_wrap=k >= names, overflow="fold")
        for row in rows:
            table.add_row(*(Text(visible(row[k])) for k in (*range(names), *shown)))
        console.print(table)
        title = None


def _cells(columns: Columns, rows: Iterable[Any]) -> Iterable[list[str]]:
    return ([column.text(row) for column in columns] for row in rows)


def write_report(path: Path, report: Any, text: str) -> None:
    """Write a report as JSON and its Markdown next to it, to a path with .json and with .md."""
    write_json(path.with_suffix(".json"), report)
    write_whole(path.with_suffix(".md"), text + "\n")


def arrow_of(rows: Iterable[Mapping[str, Any]]) -> Any:
    """Return rows as a `pyarrow.Table`; what a row does not have is null."""
    import pyarrow  # noqa: PLC0415 - slow to import

    known_rows = list(rows)
    names = dict.fromkeys(name for row in known_rows for name in row)
    columns = {name: [msgspec.to_builtins(row.get(name)) for row in known_rows] for name in names}
    return pyarrow.table(columns)


def write_parquet(path: Path, rows: Iterable[Mapping[str, Any]]) -> None:
    """Write rows to a Parquet file, whole or not at all."""
    from pyarrow import parquet  # noqa: PLC0415 - slow to import

    table = arrow_of(rows)
    with replacing(path) as temporary:
        parquet.write_table(table, temporary)

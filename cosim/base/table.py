"""Tables of rows: on a terminal, as Markdown, and as files for programs."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import msgspec

from cosim.base.command import show_table
from cosim.base.storage import replacing, write_json, write_whole


class Column(NamedTuple):
    """A column of a table.

    Attributes:
        heading: with the unit, if the cells do not name it.
        text: of a row, what its cell says.
    """

    heading: str
    text: Callable[[Any], str]


Columns = Sequence[Column]


def field(name: str, form: str = "{}", heading: str | None = None) -> Column:
    """Return the column of an attribute; a dash where it is None.

    Args:
        name: of the attribute.
        form: format of its value.
        heading: of the column, by default the name.
    """
    title = name.replace("_", " ") if heading is None else heading
    return Column(title, lambda row: known(getattr(row, name), form))


def known(value: Any, form: str) -> str:
    """Return a value in a format, a dash for None."""
    return "–" if value is None else form.format(value)


def markdown(columns: Columns, rows: Iterable[Any]) -> str:
    """Return a table as Markdown."""
    headings = [column.heading for column in columns]
    lines = [headings, ["---"] * len(headings), *_cells(columns, rows)]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def show(
    columns: Columns, rows: Iterable[Any], *, names: int = 1, title: str | None = None
) -> None:
    """Print a table, in as many parts as the console is wide for; see `show_table`."""
    headings = [column.heading for column in columns]
    show_table(None, headings, list(_cells(columns, rows)), names=names, title=title)


def _cells(columns: Columns, rows: Iterable[Any]) -> Iterable[list[str]]:
    return ([column.text(row) for column in columns] for row in rows)


def write_report(path: Path, report: Any, text: str) -> None:
    """Write a report as JSON and its table as Markdown next to it, each whole or not at all.

    Args:
        path: of both, without a suffix.
        report: a record.
        text: Markdown.
    """
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

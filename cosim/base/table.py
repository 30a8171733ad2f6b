"""Tables of rows: on a terminal, as Markdown, and as files for programs."""

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import msgspec

from cosim.base.storage import replacing

_GAP = 2  # between columns
_WORD = re.compile(r"\[[^]]*\]|\S+")  # or an interval
_HEADING_AND_ONE = 2  # rows
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


def show(columns: Columns, rows: Iterable[Any], *, brief: Columns = (), **layout: Any) -> None:
    """Print a table; `layout` is that of `show_texts`.

    Args:
        brief: columns in place of the others where these do not fit.
    """
    all_rows = list(rows)
    if brief and not _fits(columns, all_rows, layout.get("names", 1)):
        columns = brief
    show_texts([column.heading for column in columns], _cells(columns, all_rows), **layout)


def _least(column: Sequence[str], *, named: bool) -> int:
    """Return the width of the longest word or interval, which is cut only in a name."""
    from rich.cells import cell_len  # noqa: PLC0415 - slow to import

    longest = max(cell_len(word) for cell in column for word in ("", *_WORD.findall(cell)))
    return min(longest, _NAME_WIDTH) if named else longest


def _fit(columns: Sequence[Sequence[str]], names: int) -> bool:
    """Return whether the words of columns fit next to each other."""
    from rich.console import Console  # noqa: PLC0415 - slow to import

    words = sum(_least(column, named=k < names) + _GAP for k, column in enumerate(columns))
    return words - _GAP <= Console().width


def _turned(columns: Sequence[Sequence[str]]) -> list[tuple[str, ...]]:
    """Return columns as rows."""
    return list(zip(*columns, strict=True))


def _fits(columns: Columns, rows: Iterable[Any], names: int) -> bool:
    """Return whether all columns fit, as they are or as rows."""
    header = [column.heading for column in columns]
    texts = list(zip(header, *_cells(columns, rows), strict=True))
    return _fit(texts, names) or _fit(_turned(texts), 1)


def show_texts(
    header: Sequence[str],
    rows: Iterable[Sequence[str]],
    *,
    names: int = 1,
    numbers: int = 0,
    title: str | None = None,
) -> None:
    """Print a table that fits the console or a pipe of 80 columns; no number is ever cut.

    Cells have several lines where they must. If words alone are too wide, each row becomes a
    column; if that is too wide too, columns with one value in all rows become a line above the
    table, and only what is still too wide makes several tables.

    Args:
        names: how many of the first columns name a row: each of several tables has them.
        numbers: how many of the last columns are set flush right.
    """
    from rich import box  # noqa: PLC0415 - slow to import
    from rich.cells import cell_len  # noqa: PLC0415
    from rich.console import Console  # noqa: PLC0415
    from rich.table import Table  # noqa: PLC0415
    from rich.text import Text  # noqa: PLC0415

    console, columns = Console(), list(zip(header, *rows, strict=True))
    if not _fit(columns, names):
        if _fit(turned := _turned(columns), 1):
            columns, names, numbers = turned, 1, 0
        elif len(turned) > _HEADING_AND_ONE:
            equal = [k for k, column in enumerate(columns) if k and len({*column[1:]}) == 1]
            if equal:
                print("all rows:", ", ".join(" ".join(columns[k][:2]) for k in equal))
            columns = [column for k, column in enumerate(columns) if k not in equal]
            names -= sum(k < names for k in equal)
    lowest = [_least(column, named=k < names) for k, column in enumerate(columns)]
    first, rest = list(range(names)), list(range(names, len(columns)))
    while rest or first:
        shown = [*first, *rest[:1]]
        del rest[:1]
        while rest and sum(lowest[k] + _GAP for k in (*shown, rest[0])) - _GAP <= console.width:
            shown.append(rest.pop(0))
        whole = {k: max(map(cell_len, columns[k])) for k in shown}
        widths = whole.copy()
        while sum(widths.values()) + _GAP * (len(shown) - 1) > console.width:
            above = [k for k in shown if widths[k] > lowest[k]] or shown
            widths[max(above, key=widths.__getitem__)] -= 1
        # What is a `Text` has no markup, which names of files may look like.
        heading = None if title is None else Text(title, "table.title")
        style: Any = {"box": box.SIMPLE_HEAD, "show_edge": False, "pad_edge": False}
        table = Table(title=heading, **style, padding=(0, 1, 0, 0))
        for k in shown:
            justify = "right" if k >= len(columns) - numbers else "left"
            table.add_column(Text(columns[k][0]), justify=justify, width=widths[k], overflow="fold")
        for row in zip(*(columns[k][1:] for k in shown), strict=True):
            cells = (
                cell if widths[k] == whole[k] else cell.replace(" [", "\n[")
                for k, cell in zip(shown, row, strict=True)
            )
            table.add_row(*map(Text, cells))
        console.print(table)
        title = None
        first = first if rest else []


def _cells(columns: Columns, rows: Iterable[Any]) -> Iterable[list[str]]:
    return ([column.text(row) for column in columns] for row in rows)


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

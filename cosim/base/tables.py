"""Tables for terminals of any width: columns that do not fit side by side come below each other."""

from collections.abc import Sequence

from rich.cells import cell_len
from rich.console import Console
from rich.table import Table

_BORDER = 3  # of each column: a line and a space on both sides
_NAME_WIDTH = 24  # up to which a name stands on one line


def show_table(
    console: Console | None,
    header: Sequence[str],
    rows: Sequence[Sequence[str]],
    *,
    names: int = 1,
    numbers: int = 0,
    title: str | None = None,
) -> None:
    """Print a table, or several if the console is too narrow for one: no number is ever cut.

    Args:
        console: to print on; None for that of stdout.
        header: of the columns.
        rows: of text, as long as the header.
        names: how many of the first columns name a row: each table has them, and long ones in
            several lines.
        numbers: how many of the last columns are set flush right.
        title: of the table.
    """
    console = console or Console()
    columns = list(zip(header, *rows, strict=True))
    widths = [max(map(cell_len, column)) + _BORDER for column in columns]
    left = 1 + sum(min(width, _NAME_WIDTH + _BORDER) for width in widths[:names])
    rest = list(range(names, len(header)))
    while rest:
        shown = [rest.pop(0)]
        while rest and left + sum(widths[k] for k in (*shown, rest[0])) <= console.width:
            shown.append(rest.pop(0))
        table = Table(title=title)
        for k in (*range(names), *shown):
            justify = "right" if k >= len(header) - numbers else "left"
            table.add_column(header[k], justify=justify, no_wrap=k >= names, overflow="fold")
        for row in rows:
            table.add_row(*(row[k] for k in (*range(names), *shown)))
        console.print(table)
        title = None

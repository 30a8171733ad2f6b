"""HTML documentation of the FMUs for the archives: equations, variables, how they step."""

import html
from string import Template

from fmus.models import read_text
from fmus.variables import Table, Variable


def render_html(table: Table) -> bytes:
    """`documentation/index.html` of the archive.

    Args:
        table: the variables.
    """
    template = Template(read_text(table.name, "documentation.html"))
    rows = "\n".join(_row(variable) for variable in table.variables)
    values = {
        "name": table.name,
        "description": table.description,
        "rows": rows,
        "more": read_text(table.name, f"{table.name}.html"),
    }
    return template.substitute(values).encode()


def _row(variable: Variable) -> str:
    def limit(value: float | None) -> str:
        return "" if value is None else f"{value:g}"

    cells = (
        variable.name,
        variable.causality,
        variable.unit or variable.type,
        "" if variable.start is None else f"{variable.start}",
        limit(variable.min),
        limit(variable.max),
        variable.description,
    )
    return "<tr>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in cells) + "</tr>"

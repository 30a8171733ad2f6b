"""HTML documentation of the motor FMUs for the archives: equations, variables, how they step."""

import html
from string import Template

from fmus.variables import ARRAY_SOURCES, SOURCES, Table, Variable


def render_html(table: Table) -> bytes:
    """`documentation/index.html` of the archive.

    Args:
        table: the variables.
    """
    template = Template((SOURCES / "documentation.html").read_text("utf-8"))
    rows = "\n".join(_row(variable) for variable in table.variables)
    (more,) = (
        path.read_text("utf-8")
        for folder in (SOURCES, ARRAY_SOURCES)
        for path in folder.glob(f"{table.name}.html")
    )
    values = {"name": table.name, "description": table.description, "rows": rows, "more": more}
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

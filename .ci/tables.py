"""Draw pictures in docs/images from the tables of the pages, so that both say the same.

`uv run python .ci/tables.py` draws all again. Each picture carries the values that it was drawn
from, and `tests/test_docs.py` compares them with the table.
"""

import re
from dataclasses import dataclass
from pathlib import Path
from string import Formatter

import matplotlib.pyplot as plt
from PIL import Image

from cosim.base.plotting import styled

DOCS = Path(__file__).parents[1] / "docs"
NUMBER = r"([-−]?\d[\d ]*(?:\.\d+)?)"
BETWEEN = re.compile(rf"[\[(]{NUMBER},? (?:to )?{NUMBER}[\])]")
AROUND = re.compile(rf"± {NUMBER}")
MARKERS = "osD^v"


@dataclass(frozen=True)
class Picture:
    """A picture of one table: points with intervals, a row of them for each label.

    Attributes:
        page: below docs/, without suffix.
        table: how the table's first line begins, after the bar.
        values: columns that are drawn, with their colours' names in the legend.
        label: what names a row, with columns in braces.
        axis: name and unit of the values.
        keep: pattern of the label of the rows that are drawn.
        logarithmic: whether the axis is.
    """

    page: str
    table: str
    values: dict[str, str]
    label: str
    axis: str
    keep: str = ""
    logarithmic: bool = False


PICTURES = {
    "performance": Picture(
        "performance", "figure | this run", {"this run": "this run"}, "{figure}", "ns",
        keep="_ns", logarithmic=True),
    "steering": Picture(
        "steering", "rad/s | forwards", {"forwards": "forwards", "backwards": "backwards"},
        "{rad/s} rad/s",
        "mm/s, standard deviation over phases and seeds"),
    "validation": Picture(
        "validation", "preset | manoeuvre", {"simulated": "simulated", "published": "published"},
        "{preset}, {manoeuvre}, {rad/s} rad/s", "mm/s, range over phases", keep="wards"),
}  # fmt: skip


@dataclass(frozen=True)
class Point:
    """A value of a table with its interval."""

    value: float
    low: float
    high: float


def _number(text: str) -> float:
    return float(text.replace("−", "-").replace(" ", ""))


def point(cell: str) -> Point | None:
    """Return what a cell says, or nothing if it begins with no number."""
    text = cell.lstrip("*")
    if (start := re.match(NUMBER, text)) is None:
        return None
    value = _number(start[1])
    low = high = value
    if between := BETWEEN.search(text):
        low, high = map(_number, between.groups())
    elif around := AROUND.search(text):
        low, high = value - _number(around[1]), value + _number(around[1])
    return Point(value, low, high)


def read_rows(picture: Picture) -> list[dict[str, str]]:
    """Return the rows of a picture's table: cells by the name of their column.

    Raises:
        ValueError: the page has not exactly one such table, or the table lacks a column.
    """
    text = re.sub("<!--.*?-->", "", (DOCS / f"{picture.page}.md").read_text(encoding="utf-8"))
    found = re.findall(rf"^\| {re.escape(picture.table)}.*(?:\n\|.*)+", text, re.MULTILINE)
    if len(found) != 1:
        raise ValueError(f"docs/{picture.page}.md has {len(found)} tables '{picture.table}', not 1")
    header, _, *lines = (
        [cell.strip() for cell in line.split("|")[1:-1]] for line in found[0].splitlines()
    )
    labels = [name for _, name, _, _ in Formatter().parse(picture.label) if name]
    used = [*labels, *picture.values]
    if lacking := [name for name in used if not any(h.startswith(name) for h in header)]:
        raise ValueError(f"the table of docs/{picture.page}.md has no column {', '.join(lacking)}")
    places = {name: [h.startswith(name) for h in header].index(True) for name in used}
    return [
        {name: row[place] for name, place in places.items()}
        for row in lines
        if re.search(picture.keep, " ".join(row[places[name]] for name in labels))
    ]


def drawn_from(file: Path) -> str:
    """Return the text of the rows that a picture was drawn from, as it is in the file."""
    with Image.open(file) as image:
        return str(image.info.get("Source", ""))


@styled
def draw(name: str, file: Path) -> None:
    """Draw one picture of `PICTURES` into a file."""
    picture = PICTURES[name]
    rows = read_rows(picture)
    figure, axes = plt.subplots(figsize=(6.4, 1.15 + 0.22 * len(rows)))
    for number, (column, legend) in enumerate(picture.values.items()):
        shift = 0.5 * ((number + 0.5) / len(picture.values) - 0.5)
        points = [(place + shift, point(row[column])) for place, row in enumerate(rows)]
        known = [(place, p) for place, p in points if p is not None]
        for place, p in known:
            bar = [[p.value - p.low], [p.high - p.value]]
            axes.errorbar(
                p.value, place, xerr=bar, color=f"C{number}", ms=4, capsize=2,
                fmt=MARKERS[number],
            )  # fmt: skip
        axes.plot([], [], MARKERS[number], color=f"C{number}", ms=4, label=legend)
    names = [picture.label.format_map(row).replace("`", "") for row in rows]
    axes.set_yticks(range(len(rows)), names)
    axes.set_ylim(len(rows) - 0.5, -0.5)
    if picture.logarithmic:
        axes.set_xscale("log")
    axes.set_xlabel(picture.axis)
    handles, labels = axes.get_legend_handles_labels()
    if len(labels) > 1:
        figure.legend(handles, labels, loc="outside upper right", ncols=len(labels))
    figure.savefig(file, dpi=130, metadata={"Source": str(rows), "Software": None})
    plt.close(figure)


if __name__ == "__main__":
    for name in PICTURES:
        draw(name, DOCS / "images" / f"{name}.png")
        print(f"docs/images/{name}.png")

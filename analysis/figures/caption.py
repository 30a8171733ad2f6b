"""What stands below a figure: the paper's claim and our number, in a file beside the pictures."""

import json
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from matplotlib.figure import Figure

from analysis.figures.style import FigureError
from cosim.base.reading import Kind, read_json
from cosim.base.storage import replacing


@dataclass(frozen=True)
class Caption:
    """Caption of a figure; numbers in it are computed from the data drawn.

    Attributes:
        figure: name of the figure, that of its files.
        title: what it shows.
        claim: what the paper says or shows; empty if the paper has no such figure.
        ours: what we find, one sentence each.
        numbers: the numbers in `ours` by name, unit suffixes in the names.
        inputs: results it was drawn from, below the results folder.
    """

    figure: str
    title: str
    claim: str
    ours: tuple[str, ...]
    numbers: dict[str, Any] = field(default_factory=dict)
    inputs: tuple[str, ...] = ()

    def text(self) -> str:
        """The caption in words, for a page."""
        claim = f" The paper: {self.claim}" if self.claim else ""
        return f"{self.title}.{claim} Here: {' '.join(self.ours)}"


class Drawing(NamedTuple):
    """A figure that is drawn, with its caption."""

    figure: Figure
    caption: Caption


def write_caption(caption: Caption, folder: Path) -> Path:
    """Write `<figure>.json` and return its path."""
    path = folder / f"{caption.figure}.json"
    with replacing(path) as temporary:
        text = json.dumps(asdict(caption), indent=1, ensure_ascii=False, allow_nan=False)
        temporary.write_text(text + "\n", encoding="utf-8")
    return path


def read_caption(folder: Path, figure: str) -> Caption:
    """The caption of a figure that `python -m analysis.figures` wrote.

    Raises:
        FigureError: there is none, or it is damaged.
    """
    mend = f"draw it with `python -m analysis.figures {figure} --out {folder}`"
    kind = Kind("caption of a figure", mend, FigureError)
    return read_json(folder / f"{figure}.json", kind, Caption)

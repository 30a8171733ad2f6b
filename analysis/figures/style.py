"""Figures of the paper and their files, in the style of `cosim.base.plotting`.

A figure is a PNG, a PDF, and a JSON file with its caption: the paper's claim and our numbers. The
function that draws it says by `figure` what it shows and needs; any module of this folder may have
such functions.
"""

import functools
import pkgutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from cosim.base.errors import UserError
from cosim.base.plotting import save_figure, styled
from cosim.base.reading import Kind, read_json
from cosim.base.storage import write_json

WIDTH_IN = 7.2  # two columns of a journal page
FORMATS = (".png", ".pdf")
NOTHING = "–"  # where a number has no value


@styled
def save(figure: Figure, out: Path) -> list[Path]:
    """Write the figure as PNG and PDF and return the files; same data give the same bytes."""
    if out.suffix not in (*FORMATS, ""):
        raise UserError(f"--out {out}: name a .png or .pdf file, both are written")
    files = [out.with_suffix(suffix) for suffix in FORMATS]
    for file in files:
        # No date of creation: same results, same file.
        metadata = {"CreationDate": None} if file.suffix == ".pdf" else {}
        save_figure(figure, file, metadata=metadata)
    return files


CONFIRMED, NOT_CONFIRMED, UNTESTED = "confirmed", "not confirmed", "cannot be tested"


@dataclass(frozen=True)
class Claim:
    """A claim of the paper, in short, with our result and the verdict on it."""

    paper: str
    ours: str
    verdict: str


def verdict(holds: bool | None) -> str:
    """Return whether a claim is confirmed; None if the data cannot tell."""
    return UNTESTED if holds is None else CONFIRMED if holds else NOT_CONFIRMED


def verdicts(holds: Mapping[str, bool | None]) -> str:
    """Return one verdict for where a claim holds and where not, as "confirmed to 90 %, …"."""
    found: dict[str, list[str]] = {}
    for where, does in holds.items():
        found.setdefault(verdict(does), []).append(where)
    return ", ".join(f"{each} {' and '.join(places)}" for each, places in found.items())


@dataclass(frozen=True)
class Drawing:
    """A figure that is drawn, and what it shows."""

    figure: Figure
    ours: tuple[str, ...]  # what we find, one line each
    # The numbers in `ours` by name, unit suffixes in the names
    numbers: dict[str, Any] = field(default_factory=dict)
    # Our result and the verdict, for each claim of the paper that the figure bears on
    judged: tuple[tuple[str, str], ...] = ()
    words: dict[str, Any] = field(default_factory=dict)  # that its title takes


@dataclass(frozen=True)
class FigureEntry:
    """What is said of a figure where it is drawn."""

    draw: Callable[[Path], Drawing]  # from a folder of results
    title: str  # what it shows; takes words in braces from the drawing
    claim: str = ""  # what the paper says or shows; empty if the paper has no such figure
    claims: tuple[str, ...] = ()  # of the paper, in short, as docs/paper.md has them
    inputs: tuple[str, ...] = ()  # results that it is drawn from, see `analysis.reading.results`


_FIGURES: dict[str, FigureEntry] = {}


def figure(name: str, title: str, **facts: Any) -> Callable[[Callable], Callable[[Path], Drawing]]:
    """Register what draws a figure by the name of its files; arguments as of `FigureEntry`."""

    def register(draw: Callable[[Path], Drawing]) -> Callable[[Path], Drawing]:
        _FIGURES[name] = FigureEntry(draw, title, **facts)
        return draw

    return register


@functools.cache
def figure_entries() -> dict[str, FigureEntry]:
    """Return all figures of the modules in this folder by name, in the paper's order."""
    for module in pkgutil.iter_modules([str(Path(__file__).parent)]):
        import_module(f"analysis.figures.{module.name}")
    return dict(sorted(_FIGURES.items()))


@dataclass(frozen=True)
class Caption:
    """Caption of a figure; numbers in it are computed from the data drawn."""

    figure: str  # name of the figure, that of its files
    # title, claim, inputs: see `FigureEntry`
    title: str
    claim: str
    # ours, numbers: see `Drawing`
    ours: tuple[str, ...]
    numbers: dict[str, Any] = field(default_factory=dict)
    inputs: tuple[str, ...] = ()
    claims: tuple[Claim, ...] = ()  # on which it bears, as the report lists them

    @classmethod
    def of(cls, name: str, drawing: Drawing) -> "Caption":
        """Return the caption of a drawing of a figure."""
        entry = figure_entries()[name]
        return cls(
            name,
            entry.title.format(**drawing.words),
            entry.claim,
            drawing.ours,
            drawing.numbers,
            entry.inputs,
            tuple(Claim(p, *j) for p, j in zip(entry.claims, drawing.judged, strict=True)),
        )

    def text(self) -> str:
        """The caption as text, for a page."""
        claim = f" The paper: {self.claim}" if self.claim else ""
        return f"{self.title}.{claim} Here: {' '.join(self.ours)}"


def write_caption(caption: Caption, folder: Path) -> Path:
    """Write `<figure>.json` and return its path."""
    path = folder / f"{caption.figure}.json"
    write_json(path, caption)
    return path


def read_caption(folder: Path, figure: str) -> Caption:
    """The caption of a figure that `minirobots figures` wrote."""
    fix = f"draw it with `minirobots figures {figure} --out {folder}`"
    kind = Kind("caption of a figure", fix)
    return read_json(folder / f"{figure}.json", kind, Caption)

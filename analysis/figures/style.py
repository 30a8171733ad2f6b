"""One look for all figures: colours that colour-blind readers tell apart, PNG and PDF together."""

from pathlib import Path
from typing import Any

import matplotlib as mpl
from cycler import cycler
from matplotlib.figure import Figure

from cosim.base.errors import UserError
from cosim.base.storage import replacing

# Okabe and Ito's palette.
BLACK, ORANGE, SKY, GREEN = "#000000", "#E69F00", "#56B4E9", "#009E73"
YELLOW, BLUE, VERMILION, PURPLE = "#F0E442", "#0072B2", "#D55E00", "#CC79A7"
GREY = "#808080"

WIDTH_IN = 7.2  # two columns of a journal page
FORMATS = (".png", ".pdf")

_SETTINGS: dict[Any, Any] = {
    "axes.grid": True,
    "axes.labelsize": 9,
    "axes.prop_cycle": cycler(color=[BLUE, VERMILION, GREEN, ORANGE, PURPLE, SKY]),
    "axes.spines.right": False,
    "axes.spines.top": False,
    "axes.titlesize": 9,
    "figure.constrained_layout.use": True,
    "font.size": 9,
    "grid.alpha": 0.3,
    "legend.fontsize": 8,
    "legend.frameon": False,
    "lines.linewidth": 1.2,
    "savefig.dpi": 200,
}


class FigureError(UserError):
    """A figure that cannot be drawn or written as asked."""


def use_style() -> None:
    """Set matplotlib's defaults for every figure of the project."""
    mpl.use("Agg")
    mpl.rcParams.update(_SETTINGS)


def save(figure: Figure, out: Path) -> list[Path]:
    """Write the figure as PNG and PDF beside each other; the same data give the same bytes.

    Args:
        figure: drawn.
        out: file name, ending .png, .pdf or without ending.

    Returns:
        The files written.

    Raises:
        FigureError: `out` ends otherwise.
        OSError: the folder cannot be written.
    """
    if out.suffix not in (*FORMATS, ""):
        raise FigureError(f"--out {out}: name a .png or .pdf file, both are written")
    files = [out.with_suffix(suffix) for suffix in FORMATS]
    for file in files:
        # No date of creation: same results, same file.
        metadata = {"CreationDate": None} if file.suffix == ".pdf" else {}
        with replacing(file) as path:
            figure.savefig(path, metadata=metadata)
    return files

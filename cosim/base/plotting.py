"""Style of all figures: matplotlib's settings, and colours that colour-blind readers tell apart."""

from pathlib import Path
from typing import Any

import matplotlib as mpl
from cycler import cycler
from matplotlib.figure import Figure

from cosim.base.storage import replacing

# Okabe and Ito's palette.
BLACK, ORANGE, SKY, GREEN = "#000000", "#E69F00", "#56B4E9", "#009E73"
BLUE, VERMILION, PURPLE = "#0072B2", "#D55E00", "#CC79A7"
GREY = "#808080"

SETTINGS: dict[Any, Any] = {
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

# Decorator of functions that make a figure without changing the caller's own settings.
styled = mpl.rc_context(SETTINGS)


def save_figure(figure: Figure, path: Path, **how: Any) -> None:
    """Write a figure, whole or not at all, with arguments of `Figure.savefig`."""
    with replacing(path) as temporary:
        figure.savefig(temporary, **how)

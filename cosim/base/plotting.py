"""Style of all figures: matplotlib's settings."""

from pathlib import Path
from typing import Any

import matplotlib as mpl
from cycler import cycler
from matplotlib.figure import Figure

from cosim.base.colours import ROBOT_COLOURS
from cosim.base.storage import replacing

SETTINGS: dict[Any, Any] = {
    "axes.grid": True,
    "axes.labelsize": 9,
    "axes.prop_cycle": cycler(color=ROBOT_COLOURS),
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

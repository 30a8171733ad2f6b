"""Figure of success in co-simulation by training method, from a result of `cosim.transfer`."""

from pathlib import Path

from analysis.caption import Drawing
from analysis.results import RESULTS
from analysis.style import FigureError


def make(results: Path) -> Drawing:
    """Draw the figure of a results folder.

    Raises:
        FigureError: there is no such result.
    """
    path = RESULTS["transfer"].proof_in(results)
    raise FigureError(f"{path}: not readable")

"""Every figure of the project, drawn from a results folder.

Where results lie, and which command makes them, is said in `analysis.reading.results`. Nothing is
simulated here.
"""

from collections.abc import Iterable
from pathlib import Path

import matplotlib.pyplot as plt

from analysis.figures.style import Caption, figure_entries, save, write_caption
from analysis.reading.results import missing
from cosim.base.errors import UserError
from cosim.base.plotting import save_figure, styled
from cosim.base.progress import Progress, silent

# Of a page of the docs; such a picture takes well under 150 kB.
SMALL_WIDTH_PX = 900


@styled
def draw_figures(
    names: Iterable[str],
    results: Path,
    out: Path,
    *,
    small: bool = False,
    progress: Progress = silent,
) -> tuple[dict[str, list[Path]], dict[str, str]]:
    """Draw what can be drawn: return files by figure, and why other figures could not be drawn.

    Where `small`, only PNGs of 900 pixels are written, for the docs.
    """
    drawn: dict[str, list[Path]] = {}
    lacking: dict[str, str] = {}
    wanted = list(dict.fromkeys(names))
    for number, name in enumerate(wanted):
        progress("drawing figures", number, len(wanted), name)
        entry = figure_entries()[name]
        if needed := missing(entry.inputs, results):
            commands = "; ".join(f"`{result.command(results)}`" for result in needed)
            lacking[name] = f"run {commands} first"
            continue
        try:
            drawing = entry.draw(results)
        except UserError as error:
            lacking[name] = str(error)
            continue
        figure, picture = drawing.figure, out / f"{name}.png"
        if small:
            dpi = SMALL_WIDTH_PX / figure.get_figwidth()
            save_figure(figure, picture, dpi=dpi, pil_kwargs={"optimize": True})
            drawn[name] = [picture]
        else:
            written = save(figure, picture)
            drawn[name] = [*written, write_caption(Caption.of(name, drawing), out)]
        plt.close(figure)
    progress("drawing figures", len(wanted), len(wanted))
    return drawn, lacking

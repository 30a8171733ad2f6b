"""Every figure of the project, drawn from a results folder.

Figures are drawn by their own modules, `DRAWN_BY` says which; where results lie, and which command
makes them, is said in `analysis.reading.results`. Nothing is simulated here.
"""

from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path

import matplotlib.pyplot as plt

from analysis.figures import fig03, fig05, fig07, learning, motor_cycle, paths, schematics, transfer
from analysis.figures.style import Caption, Drawing, save, write_caption
from analysis.reading.results import missing
from cosim.base.errors import UserError
from cosim.base.plotting import styled
from cosim.base.progress import Progress, silent
from cosim.base.storage import replacing

DRAWN_BY: dict[str, Callable[[Path], Drawing]] = {
    "fig02": schematics.fig02,
    "fig03": fig03.make,
    "fig04": schematics.fig04,
    "fig05": fig05.make,
    "fig06": schematics.fig06,
    "fig07": fig07.make,
    "fig08": partial(learning.learned, "fig08"),
    "fig09": paths.fig09,
    "fig10": learning.fig10,
    "fig11": partial(learning.learned, "fig11"),
    "fig12": paths.fig12,
    "groups": fig05.in_groups,
    "motor_cycle": motor_cycle.make,
    "obstacles": fig05.among_obstacles,
    "path_ratio": learning.path_ratio,
    "sequel": learning.sequel,
    "transfer": transfer.make,
}
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
    """Draw what can be drawn.

    Args:
        results: folder of results.
        out: folder to write to.
        small: whether only PNGs of 900 pixels are written, for the docs.

    Returns:
        Files written, by figure, and why the other figures could not be drawn.
    """
    drawn: dict[str, list[Path]] = {}
    lacking: dict[str, str] = {}
    wanted = list(dict.fromkeys(names))
    for number, name in enumerate(wanted):
        progress("drawing figures", number, len(wanted), name)
        if needed := missing(name, results):
            commands = "; ".join(f"`{result.command(results)}`" for result in needed)
            lacking[name] = f"run {commands} first"
            continue
        try:
            drawing = DRAWN_BY[name](results)
        except UserError as error:
            lacking[name] = str(error)
            continue
        figure, picture = drawing.figure, out / f"{name}.png"
        if small:
            dpi = SMALL_WIDTH_PX / figure.get_figwidth()
            with replacing(picture) as temporary:
                figure.savefig(temporary, dpi=dpi, pil_kwargs={"optimize": True})
            drawn[name] = [picture]
        else:
            written = save(figure, picture)
            drawn[name] = [*written, write_caption(Caption.of(name, drawing), out)]
        plt.close(figure)
    progress("drawing figures", len(wanted), len(wanted))
    return drawn, lacking

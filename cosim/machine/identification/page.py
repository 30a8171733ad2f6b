"""The page of an identification: one HTML file with its pictures in it."""

import io
from pathlib import Path

import jinja2
import numpy as np
from matplotlib.figure import Figure

from cosim.base.plotting import BLUE, VERMILION, styled
from cosim.base.storage import write_whole
from cosim.machine.identification.fit import QUANTILE, Fit
from cosim.machine.identification.parameters import PARAMETERS
from cosim.machine.identification.result import PRESET_FILE, Identified
from cosim.machine.identification.track import SeenTrack

_MEASURED, _SIMULATED = BLUE, VERMILION


def write_page(identified: Identified, path: Path) -> None:
    """Write the page.

    Args:
        identified: what it is of.
        path: of the file.

    Raises:
        OSError: it cannot be written.
    """
    folder = Path(__file__).with_name("templates")
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(folder), autoescape=True, undefined=jinja2.StrictUndefined
    )
    text = environment.get_template("report.html.j2").render(
        report=identified.report,
        rows=rows(identified),
        drawing=_svg(_draw(identified.track, identified.fit)),
        preset=PRESET_FILE,
        expected=f"{QUANTILE**2:.2f}",
    )
    write_whole(path, text)


def rows(identified: Identified) -> list[tuple[str, ...]]:
    """Of every parameter: name, description, value, interval, and rises at the interval's ends."""
    table = []
    for parameter, found in zip(PARAMETERS, identified.report.parameters, strict=True):
        value, low, high = (parameter.scale * v for v in (found.value, found.low, found.high))
        ends = ", ".join("–" if rise is None else f"{rise:.1f}" for rise in found.rises)
        known = f"{low:.3f} to {high:.3f}" if found.identifiable else "not identifiable"
        unit = f" {parameter.unit}" if parameter.unit else ""
        table.append((parameter.name, parameter.description, f"{value:.3f}{unit}", known, ends))
    return table


@styled
def _draw(track: SeenTrack, fit: Fit) -> Figure:
    """Tracks seen and simulated, headings, and residuals."""
    seen, own = track.poses, _laid_over(fit.frames, track.poses)
    figure = Figure(figsize=(10.0, 8.0), layout="constrained")
    (plane, turning), (errors, spread) = figure.subplots(2, 2)
    for poses, colour, form, label in (
        (seen, _MEASURED, ".", "seen"),
        (own, _SIMULATED, "-", "simulated"),
    ):
        plane.plot(1e3 * poses[:, 0], 1e3 * poses[:, 1], form, color=colour, ms=1.5, label=label)
        turning.plot(track.times, np.rad2deg(poses[:, 2]), form, color=colour, ms=1.5, label=label)
    plane.set(title="track", xlabel="x, mm", ylabel="y, mm", aspect="equal")
    plane.legend()
    turning.set(title="heading", xlabel="s", ylabel="°")
    for k, (name, colour) in enumerate(
        (("x", _MEASURED), ("y", "#009e73"), ("heading", _SIMULATED))
    ):
        residuals = fit.residuals[:, k]
        errors.plot(track.times[1:], residuals, ".", ms=2, color=colour, label=name)
        spread.hist(residuals, bins=np.linspace(-5.0, 5.0, 41), histtype="step", color=colour)
    errors.set(title="residuals over their standard deviations", xlabel="s")
    errors.legend()
    spread.set(title="the same, counted", xlabel="standard deviations", ylabel="frames")
    return figure


def _laid_over(frames: np.ndarray, poses: np.ndarray) -> np.ndarray:
    """The simulated track (n, 3), moved and turned as a whole to where the robot was seen."""
    turn = np.mean(poses[:, 2] - frames[:, 2])
    places, seen = (track[:, 0] + 1j * track[:, 1] for track in (frames, poses))
    places = places * np.exp(1j * turn)
    places += np.mean(seen - places)
    return np.column_stack([places.real, places.imag, frames[:, 2] + turn])


def _svg(figure: Figure) -> str:
    content = io.StringIO()
    figure.savefig(content, format="svg", metadata={"Date": None})
    return content.getvalue().partition("<svg")[1] + content.getvalue().partition("<svg")[2]

"""Save the Rerun viewer's picture of a recording."""

from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import tyro

from cosim.base.progress import Progress, under_way
from minirobots.options import CommandOptions, File, ending


class Screenshot(CommandOptions):
    """Draw a recording as the Rerun viewer shows it and save the picture.

    The viewer draws with software Vulkan, which on Debian needs the packages mesa-vulkan-drivers,
    libvulkan1 and libegl1.
    """

    recording: tyro.conf.Positional[Path]
    """Recording to open (.rrd)."""
    out: Annotated[File, ending(".png")] = Path("screenshot.png")
    """Picture to write (.png)."""
    width: Annotated[int, tyro.conf.arg(metavar="PX")] = 1280
    """Width of the picture in pixels."""
    time: Annotated[float | None, tyro.conf.arg(metavar="S", aliases=["--time-s"])] = None
    """Simulated time in s at which the recording is shown; by default as the viewer opens it."""
    tab: str | None = None
    """Tab to show, such as contact or policies; by default the first."""


def run(options: Screenshot, progress: Progress) -> Iterator[Any]:
    """Draw the recording, save the picture, and print what the viewer could not draw."""
    from analysis.viewer import screenshot, shrink

    with under_way(progress, "drawing in the viewer"):
        report = screenshot(options.recording, options.out, options.time, options.tab)
        shrink(options.out, options.width)
    yield asdict(report) | {"out": str(options.out)}
    for name, faults in report.views:
        for fault in faults:
            print(f"view {name}: {fault}")
    for warning in report.warnings:
        print(f"viewer: {warning}")
    print(f"loaded in {report.load_s:.1f} s, picture in {options.out}")

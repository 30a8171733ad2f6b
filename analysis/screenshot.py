"""`python -m analysis.screenshot FILE`: a picture of a recording in the Rerun viewer."""

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated

import tyro

from cosim.base.command import Json, parse, print_json
from cosim.base.errors import run_command


@dataclass(frozen=True)
class Screenshot:
    """Draw a recording as the Rerun viewer shows it and save the picture.

    The viewer draws with software Vulkan, which on Debian takes the packages mesa-vulkan-drivers,
    libvulkan1 and libegl1.
    """

    recording: Annotated[Path, tyro.conf.Positional]
    """Recording to open (.rrd)."""
    out: Annotated[Path, tyro.conf.arg(metavar="FILE")] = Path("screenshot.png")
    """Picture to write (.png)."""
    width: Annotated[int, tyro.conf.arg(metavar="PX")] = 1280
    """Width of the picture in pixels."""
    time: Annotated[float | None, tyro.conf.arg(metavar="S", aliases=["--time-s"])] = None
    """Simulated time in s at which the recording is shown; by default as the viewer opens it."""
    tab: str | None = None
    """Tab to show, such as contact or policies; by default the first."""
    json: Json = False


def main() -> None:
    """Command line; see `Screenshot`."""
    options = parse(Screenshot, "analysis.screenshot")
    from analysis.viewer import screenshot, shrink
    from cosim.base.progress import progress_bars, under_way

    with progress_bars() as progress, under_way(progress, "drawing in the viewer"):
        report = screenshot(options.recording, options.out, options.time, options.tab)
        shrink(options.out, options.width)
    for name, faults in report.views:
        for fault in faults:
            print(f"view {name}: {fault}")
    for warning in report.warnings:
        print(f"viewer: {warning}")
    print(f"loaded in {report.load_s:.1f} s, picture in {options.out}")
    if options.json:
        print_json(asdict(report) | {"out": str(options.out)})


if __name__ == "__main__":
    run_command(main)

"""`python -m analysis.screenshot FILE`: a picture of a recording in the Rerun viewer.

The viewer runs headless and draws with software Vulkan, which on Debian takes the packages
mesa-vulkan-drivers, libvulkan1 and libegl1.
"""

import socket
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro
from PIL import Image
from rerun.experimental import ViewerClient

from cosim.errors import UserError, run_command
from cosim.storage import replacing

LOAD_TIMEOUT_S = 60.0
SETTLE_PERIOD_S = 1.0
SETTLE_TRIES = 30


class ViewerError(UserError):
    """The viewer could not be started or did not load the recording."""


@dataclass(frozen=True)
class Screenshot:
    """Draw a recording as the Rerun viewer shows it and save the picture."""

    recording: Annotated[Path, tyro.conf.Positional]
    """Recording to open (.rrd)."""
    out: Annotated[Path, tyro.conf.arg(metavar="FILE")] = Path("screenshot.png")
    """Picture to write (.png)."""
    width: int = 1280
    """Width of the picture in pixels."""
    time_s: Annotated[float | None, tyro.conf.arg(metavar="S")] = None
    """Simulated time at which the recording is shown; by default as the viewer opens it."""


@dataclass(frozen=True)
class ViewerReport:
    """What the viewer says of a recording.

    Attributes:
        views: name of each view with the reports of what it could not draw.
        warnings: the viewer's own log from level warning up, without those on software rendering.
        entities: paths in the recording.
        load_s: time until everything was loaded, in s.
    """

    views: list[tuple[str, list[Any]]]
    warnings: list[str]
    entities: list[str]
    load_s: float


def screenshot(recording: Path, picture: Path, time_s: float | None = None) -> ViewerReport:
    """Open a recording headless, save what is seen, and report what the viewer says.

    Args:
        recording: to open.
        picture: PNG to write.
        time_s: simulated time to show, in s.

    Raises:
        ViewerError: the recording does not exist, or the viewer does not start or load it.
    """
    if not recording.is_file():
        raise ViewerError(f"recording {recording} does not exist; name an .rrd file")
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    try:
        viewer = ViewerClient.spawn(headless=True, port=port, hide_welcome_screen=True)
    except Exception as error:  # rerun raises RuntimeError whatever the cause
        raise ViewerError(
            f"the Rerun viewer does not start ({error}); "
            "install mesa-vulkan-drivers, libvulkan1 and libegl1"
        ) from error
    with viewer:
        began = time.monotonic()
        viewer.open(str(recording.resolve()))
        while viewer.get_state().loading:
            if time.monotonic() - began > LOAD_TIMEOUT_S:
                raise ViewerError(f"the viewer did not load {recording} in {LOAD_TIMEOUT_S:.0f} s")
            time.sleep(0.05)
        load_s = time.monotonic() - began
        if time_s is not None:
            viewer.set_time("sim_time", duration=time_s, play_state="paused")
        with replacing(picture) as temporary:
            _settled(viewer, temporary)
        return ViewerReport(
            views=[(view.name, list(view.reports)) for view in viewer.get_state().views],
            warnings=[
                entry.message
                for entry in viewer.get_logs()
                if entry.level in {"WARN", "ERROR"} and "oftware rasterizer" not in entry.message
            ],
            entities=[e.entity_path for e in viewer.get_recording_schema(paths_only=True).entities],
            load_s=load_s,
        )


def _settled(viewer: ViewerClient, picture: Path) -> None:
    """Save pictures until two in a row are equal."""
    before = b""
    for _ in range(SETTLE_TRIES):
        time.sleep(SETTLE_PERIOD_S)
        viewer.save_screenshot(str(picture))
        now = picture.read_bytes()
        if now == before:
            return
        before = now


def shrink(picture: Path, width: int) -> None:
    """Make a PNG small enough for a page: the given width in pixels, 256 colours."""
    with Image.open(picture) as full:
        height = round(full.height * width / full.width)
        small = full.convert("RGB").resize((width, height), Image.Resampling.LANCZOS)
    with replacing(picture) as temporary:
        small.quantize(256).save(temporary, optimize=True)


def main() -> None:
    """Command line; see `Screenshot`."""
    options = tyro.cli(Screenshot, prog="python -m analysis.screenshot")
    report = screenshot(options.recording, options.out, options.time_s)
    shrink(options.out, options.width)
    for name, faults in report.views:
        for fault in faults:
            print(f"view {name}: {fault}")
    for warning in report.warnings:
        print(f"viewer: {warning}")
    print(f"loaded in {report.load_s:.1f} s, picture in {options.out}")


if __name__ == "__main__":
    run_command(main)

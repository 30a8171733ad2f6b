"""Recordings in the Rerun viewer: a picture, and the viewer's report.

The viewer runs headless and draws with software Vulkan, which on Debian takes the packages
mesa-vulkan-drivers, libvulkan1 and libegl1.
"""

import contextlib
import os
import socket
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from matplotlib import image
from rerun.experimental import ViewerClient

from cosim.base.errors import UserError
from cosim.base.reading import Kind, require_file
from cosim.base.storage import replacing
from cosim.recording.live import viewer_executable

LOAD_TIMEOUT_S = 60.0
SETTLE_PERIOD_S = 1.0
SETTLE_TRIES = 30


@dataclass(frozen=True)
class ViewerReport:
    """The viewer's report on a recording."""

    # Name of each view with the reports of what it could not draw
    views: list[tuple[str, list[Any]]]
    # The viewer's own log from level warning up, without those on software rendering
    warnings: list[str]
    entities: list[str]
    load_s: float  # time until everything was loaded


def screenshot(
    recording: Path,
    picture: Path,
    time_s: float | None = None,
    tab: str | None = None,
    *,
    visit_tabs: bool = False,
) -> ViewerReport:
    """Open a recording headless, save a picture (PNG), and return the viewer's report.

    Args:
        visit_tabs: whether every tab is drawn before, for a report on all views.
    """
    require_file(recording, Kind("recording", "name an .rrd file"))
    with _headless() as viewer:
        began = time.monotonic()
        viewer.open(str(recording.resolve()))
        while viewer.get_state().loading:
            if time.monotonic() - began > LOAD_TIMEOUT_S:
                raise UserError(f"the viewer did not load {recording} in {LOAD_TIMEOUT_S:.0f} s")
            time.sleep(0.05)
        load_s = time.monotonic() - began
        if time_s is not None:
            viewer.set_time("sim_time", duration=time_s, play_state="paused")
        blueprint = viewer.get_blueprint().blueprint
        names = _tab_names(blueprint)
        faults: dict[str, list[Any]] = {}
        visited = list(names) if visit_tabs else []
        for name in [*visited, tab or next(iter(names), None)]:
            if name is not None:
                _show_tab(viewer, blueprint, names, name)
                time.sleep(SETTLE_PERIOD_S)
            _collect(viewer, faults)
        with replacing(picture) as temporary:
            _settled(viewer, temporary)
        _collect(viewer, faults)
        return ViewerReport(
            views=list(faults.items()),
            warnings=[
                entry.message
                for entry in viewer.get_logs()
                if entry.level in {"WARN", "ERROR"} and "oftware rasterizer" not in entry.message
            ],
            entities=[e.entity_path for e in viewer.get_recording_schema(paths_only=True).entities],
            load_s=load_s,
        )


@contextlib.contextmanager
def _headless() -> Iterator[ViewerClient]:
    """Start a viewer that draws to memory, and end it; its log is kept from the terminal."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    stderr = os.dup(2)  # which the viewer inherits, for its log and its panic
    try:
        with Path(os.devnull).open("w") as nothing:
            os.dup2(nothing.fileno(), 2)
        executable = viewer_executable()
        try:
            viewer = ViewerClient.spawn(
                headless=True, port=port, hide_welcome_screen=True, executable_path=executable
            )
        finally:
            os.dup2(stderr, 2)
            os.close(stderr)
        with viewer:
            yield viewer
    except (ConnectionError, RuntimeError) as error:  # as rerun raises them, whatever the cause
        raise UserError(
            f"the Rerun viewer does not draw ({error}); install software Vulkan, on Debian "
            "`apt install mesa-vulkan-drivers libvulkan1 libegl1`"
        ) from error


def _tab_names(blueprint: dict[str, Any]) -> dict[str, tuple[str, str]]:
    """Tabs by their names: path of the container that has them, and which of its contents.

    Tabs within a tab come after the others: a blueprint names its containers in any order.
    """
    containers = {path: entry.get("ContainerBlueprint", {}) for path, entry in blueprint.items()}
    views = {path: entry.get("ViewBlueprint", {}) for path, entry in blueprint.items()}
    tabs = {
        path: [c["contents"]] if isinstance(c["contents"], str) else c["contents"]  # of one tab
        for path, c in containers.items()
        if c.get("container_kind") == "Tabs"
    }
    within = {f"/{part}" for parts in tabs.values() for part in parts}
    return {
        (containers[f"/{part}"] or views[f"/{part}"])["display_name"]: (path, part)
        for path in sorted(tabs, key=within.__contains__)
        for part in tabs[path]
    }


def _show_tab(
    viewer: ViewerClient, blueprint: dict[str, Any], names: dict[str, tuple[str, str]], name: str
) -> None:
    if name not in names:
        raise UserError(f"the recording has no tab '{name}'; it has {', '.join(names) or 'none'}")
    path, part = names[name]
    blueprint[path]["ContainerBlueprint"]["active_tab"] = part
    for outer, inner in names.values():  # of tabs within a tab, that one too
        if f"/{inner}" == path:
            blueprint[outer]["ContainerBlueprint"]["active_tab"] = inner
    viewer.set_blueprint(blueprint, of="recording")


def _collect(viewer: ViewerClient, faults: dict[str, list[Any]]) -> None:
    """Add what the views report to what they reported before."""
    for view in viewer.get_state().views:
        known = faults.setdefault(view.name, [])
        known += [report for report in view.reports if report not in known]


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
    """Make a PNG small enough for a page: the given width in pixels."""
    scale = width / image.imread(picture).shape[1]
    with replacing(picture) as temporary:
        image.thumbnail(str(picture), str(temporary), scale, "lanczos")

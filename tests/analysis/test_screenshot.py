"""The default recordings in the real viewer, headless: every view draws without a complaint."""

import os
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import rerun as rr
from matplotlib.image import imread

from analysis.viewer import _show_tab, _tab_names, screenshot, shrink
from cosim.base.arguments import ConfigError
from cosim.base.errors import UserError
from minirobots.commands.recordings import Screenshot
from tests.alone import python


@pytest.fixture(scope="module")
def run_folder(tmp_path_factory):
    """A short run of the main command."""
    out = tmp_path_factory.mktemp("viewer") / "run"
    brief = ("--train-episodes", "20000", "--time-limit", "4", "--out", str(out))
    python("-m", "minirobots", "run", *brief, check=True)
    return out


@pytest.mark.viewer
@pytest.mark.parametrize(
    ("recording", "views", "time_s"),
    [
        pytest.param("episodes/ep_000.rrd", 51, 3.0, marks=pytest.mark.long),
        ("training.rrd", 10, None),
    ],
)
def test_recording_opens_without_a_complaint(run_folder, tmp_path, recording, views, time_s):
    picture = tmp_path / "picture.png"
    report = screenshot(run_folder / recording, picture, time_s, visit_tabs=True)
    assert len(report.views) == views
    assert [(name, faults) for name, faults in report.views if faults] == []
    assert report.warnings == []
    assert len(report.entities) > views
    shrink(picture, 640)
    pixels = imread(picture)
    assert pixels.shape[:2] == (360, 640)
    assert pixels[..., :3].mean(axis=2).std() > 0.04  # not blank


@pytest.mark.viewer
def test_missing_tab_is_named(run_folder, tmp_path):
    with pytest.raises(UserError, match=r"tab 'sounds'; .*overview, motors, motion"):
        screenshot(run_folder / "episodes" / "ep_000.rrd", tmp_path / "a.png", tab="sounds")


def test_tabs_within_a_tab_are_not_the_first():
    def tabs(name: str, *parts: str) -> dict[str, Any]:
        contents = parts if len(parts) != 1 else parts[0]  # as the viewer says it
        entry = {"display_name": name, "container_kind": "Tabs", "contents": contents}
        return {"ContainerBlueprint": entry}

    shown = {part: {"ViewBlueprint": {"display_name": part}} for part in ("/r1", "/overview")}
    for order in (("/inner", "/outer"), ("/outer", "/inner")):
        parts = {"/inner": tabs("policies", "r1"), "/outer": tabs("", "overview", "inner")}
        names = _tab_names({path: parts[path] for path in order} | shown)
        assert list(names) == ["/overview", "policies", "/r1"]


def test_a_tab_within_a_tab_is_opened_with_that():
    kept: list[dict[str, Any]] = []
    client: Any = SimpleNamespace(set_blueprint=lambda blueprint, of: kept.append(blueprint))
    blueprint: dict[str, Any] = {p: {"ContainerBlueprint": {}} for p in ("/root", "/inner")}
    names = {"overview": ("/root", "first"), "policies": ("/root", "inner")}
    _show_tab(client, blueprint, names | {"policy · r2": ("/inner", "second")}, "policy · r2")
    active = {path: part["ContainerBlueprint"]["active_tab"] for path, part in kept[0].items()}
    assert active == {"/root": "inner", "/inner": "second"}


def test_a_picture_without_width_is_refused():
    with pytest.raises(ConfigError, match="width = 0 is invalid"):
        Screenshot(recording=Path("a.rrd"), width=0)


def test_missing_recording_is_named(tmp_path):
    with pytest.raises(UserError, match=r"nothing\.rrd: no such recording"):
        screenshot(tmp_path / "nothing.rrd", tmp_path / "a.png")


@pytest.mark.slow
def test_missing_drivers_end_in_a_sentence(tmp_path, monkeypatch):
    """Nothing of the viewer's panic reaches the terminal."""
    for name in ("VK_DRIVER_FILES", "VK_ICD_FILENAMES", "__EGL_VENDOR_LIBRARY_FILENAMES"):
        monkeypatch.setenv(name, "/nonexistent")
    with rr.RecordingStream("test") as stream:
        stream.save(tmp_path / "a.rrd")
        stream.log("a", rr.Scalars(1.0))
    env = os.environ | {"PYTHONPATH": str(Path(__file__).parents[2])}
    done = python("-m", "minirobots", "screenshot", "a.rrd", cwd=tmp_path, env=env)
    assert (done.returncode, done.stdout) == (2, "")
    errors = done.stderr.removeprefix("drawing in the viewer …\n")
    assert errors.startswith("error: the Rerun viewer does not draw (")
    assert errors.endswith("apt install mesa-vulkan-drivers libvulkan1 libegl1`\n")
    assert errors.count("\n") == 1
    assert [path.name for path in tmp_path.iterdir()] == ["a.rrd"]

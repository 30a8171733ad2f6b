"""The command of all figures on a small results folder, and what is said of other folders."""

import json
import shutil
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.image import imread

from analysis.figures import paths, transfer
from analysis.figures.draw import SMALL_WIDTH_PX
from analysis.figures.learning import load_variants
from analysis.figures.style import Caption, figure_entries, read_caption, save, write_caption
from analysis.reading.results import RESULTS, read_experiment
from cosim.base.errors import UserError
from cosim.base.storage import write_json
from cosim.machine.platform.motion import PlatformResult

MAX_SMALL_BYTES = 150_000


@pytest.fixture(scope="module")
def drawn(reproduction):
    """Folder of all figures of the small results."""
    return reproduction / "figures"


@pytest.mark.parametrize("name", figure_entries())
def test_figure_is_written_with_a_caption(name, drawn):
    assert (drawn / f"{name}.png").read_bytes().startswith(b"\x89PNG")
    assert (drawn / f"{name}.pdf").read_bytes().startswith(b"%PDF")
    caption, entry = read_caption(drawn, name), figure_entries()[name]
    assert (caption.figure, caption.inputs, caption.claim) == (name, entry.inputs, entry.claim)
    assert tuple(claim.paper for claim in caption.claims) == entry.claims
    assert caption.ours
    assert not {*"{}$"} & {*caption.text()}  # words are filled in, without mathematics of TeX


def test_same_results_give_the_same_files(results, drawn, tmp_path, command):
    names = ("fig03", "fig08", "motor_cycle")
    done = command("figures", *names, "--results", results, "--out", tmp_path, "--json")
    content = json.loads(done.stdout.splitlines()[-1])
    assert content["lacking"] == {}
    for name in names:
        files = [Path(file) for file in content["drawn"][name]]
        assert files == [tmp_path / f"{name}{suffix}" for suffix in (".png", ".pdf", ".json")]
        for file in files:
            assert file.read_bytes() == (drawn / file.name).read_bytes(), file


def test_small_pictures_are_small(results, tmp_path, command):
    command("figures", "fig05", "fig08", "--results", results, "--out", tmp_path, "--small")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["fig05.png", "fig08.png"]
    for path in tmp_path.iterdir():
        assert path.stat().st_size < MAX_SMALL_BYTES
        assert imread(path).shape[1] == SMALL_WIDTH_PX


@pytest.mark.long
def test_missing_results_are_named_with_their_command(tmp_path, command):
    out = ("--results", tmp_path, "--out", tmp_path / "out", "--small")
    page = command("figures", "all", *out).stdout
    for name, entry in figure_entries().items():
        expected = f"not drawn: {name}: run `minirobots " if entry.inputs else f"{name}.png"
        assert expected in page
    for arguments, error in (
        (("fig03", "fig05", *out, "--strict"), "leave out --strict"),
        (("fig03", *out), "no figure could be drawn"),
        (("fig99",), "no figure is called fig99; choose from all, fig02"),
    ):
        refused = command("figures", *arguments)
        assert (refused.returncode, error in refused.stderr) == (2, True)
    (tmp_path / "platform.npz").write_text("not a result")
    page = command("figures", "fig03", "fig05", *out).stdout  # the other one is drawn
    assert "not drawn: fig03" in page
    assert "not a result of `minirobots platform`" in page


def test_captions_come_back_and_what_is_none_is_named(tmp_path):
    caption = Caption("fig03", "Motion", "it slides", ("5 µm a turn.",), {"step_um": 5.0}, ("a",))
    assert write_caption(caption, tmp_path) == tmp_path / "fig03.json"
    assert read_caption(tmp_path, "fig03") == caption
    assert caption.text() == "Motion. The paper: it slides Here: 5 µm a turn."
    (tmp_path / "fig05.json").write_text("[]")
    (tmp_path / "fig07.json").write_text('{"figure": "fig07"')
    for figure in ("fig02", "fig05", "fig07"):
        with pytest.raises(UserError, match=f"minirobots figures {figure}"):
            read_caption(tmp_path, figure)
    with pytest.raises(UserError, match=r"name a \.png or \.pdf file"):
        save(plt.figure(), tmp_path / "figure.svg")


def test_other_results_are_refused(results, tmp_path):
    with pytest.raises(UserError, match=r"platform\.npz: no such result of `minirobots"):
        PlatformResult.load(tmp_path / "platform.npz")
    (tmp_path / "text.npz").write_text("not a result")
    np.savez(tmp_path / "other.npz", a=np.zeros(3))
    for name in ("text.npz", "other.npz"):
        with pytest.raises(UserError, match="not a result of `minirobots platform`"):
            PlatformResult.load(tmp_path / name)
    with pytest.raises(UserError, match=r"run `minirobots run --scenario 1a"):
        paths.fig09(tmp_path)
    with pytest.raises(UserError, match=r"no such result of `minirobots study`"):
        transfer.make(tmp_path)
    for content in ("no table", [], {}, {"rows": [{"success": 1.0}]}):
        write_json(RESULTS["transfer"].proof_in(tmp_path), content)
        with pytest.raises(UserError, match="not a result of"):
            transfer.make(tmp_path)
    with pytest.raises(UserError, match=r"run `minirobots experiments fig08"):
        read_experiment("fig08", tmp_path)
    copy = RESULTS["fig08"].location(tmp_path)
    shutil.copytree(RESULTS["fig11"].location(results), copy)
    with pytest.raises(UserError, match="not a result of fig08"):
        read_experiment("fig08", tmp_path)
    shutil.copytree(RESULTS["fig08"].location(results), copy, dirs_exist_ok=True)
    (copy / "1a" / "run_001" / "policy.npz").unlink()
    with pytest.raises(UserError, match="runs are missing"):
        load_variants(copy, read_experiment("fig08", tmp_path))

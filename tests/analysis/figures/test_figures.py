"""The command of all figures on a small results folder."""

import json
from pathlib import Path

import pytest
from matplotlib.image import imread

from analysis.figures.draw import SMALL_WIDTH_PX
from analysis.figures.style import read_caption
from analysis.reading.results import FIGURES

MAX_SMALL_BYTES = 150_000


@pytest.fixture(scope="module")
def drawn(reproduction):
    """Folder of all figures of the small results."""
    return reproduction / "figures"


@pytest.mark.parametrize("name", FIGURES)
def test_figure_is_written_with_a_caption(name, drawn):
    assert (drawn / f"{name}.png").read_bytes().startswith(b"\x89PNG")
    assert (drawn / f"{name}.pdf").read_bytes().startswith(b"%PDF")
    caption = read_caption(drawn, name)
    assert caption.figure == name
    assert caption.ours
    assert caption.inputs == FIGURES[name]


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
    for name, needed in FIGURES.items():
        expected = f"not drawn: {name}: run `minirobots " if needed else f"{name}.png"
        assert expected in page
    strict = command("figures", "fig03", "fig05", *out, "--strict")
    assert (strict.returncode, "leave out --strict" in strict.stderr) == (2, True)
    nothing = command("figures", "fig03", *out)
    assert (nothing.returncode, "no figure could be drawn" in nothing.stderr) == (2, True)
    refused = command("figures", "fig99")
    assert refused.returncode == 2
    assert "no figure is called fig99; choose from all, fig02" in refused.stderr
    (tmp_path / "platform.npz").write_text("not a result")
    page = command("figures", "fig03", "fig05", *out).stdout  # the other one is drawn
    assert "not drawn: fig03" in page
    assert "not a result of `minirobots platform`" in page

"""The command of all figures on a small results folder."""

import json
import sys
from pathlib import Path

import pytest
from PIL import Image

from analysis.figures import __main__ as figures
from analysis.figures.draw import DRAWN_BY, SMALL_WIDTH_PX
from analysis.figures.style import read_caption
from analysis.reading.results import FIGURES
from cosim.base.errors import UserError, run_command

MAX_SMALL_BYTES = 150_000


def draw(monkeypatch, *arguments):
    monkeypatch.setattr(sys, "argv", ["figures", *map(str, arguments)])
    figures.main()


def test_every_figure_is_drawn_by_someone():
    assert DRAWN_BY.keys() == FIGURES.keys()


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


def test_same_results_give_the_same_files(results, drawn, tmp_path, monkeypatch, capsys):
    names = ("fig03", "fig08", "motor_cycle")
    draw(monkeypatch, *names, "--results", results, "--out", tmp_path, "--json")
    content = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert content["lacking"] == {}
    for name in names:
        files = [Path(file) for file in content["drawn"][name]]
        assert files == [tmp_path / f"{name}{suffix}" for suffix in (".png", ".pdf", ".json")]
        for file in files:
            assert file.read_bytes() == (drawn / file.name).read_bytes(), file


def test_small_pictures_are_small(results, tmp_path, monkeypatch):
    draw(monkeypatch, "fig05", "fig08", "--results", results, "--out", tmp_path, "--small")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["fig05.png", "fig08.png"]
    for path in tmp_path.iterdir():
        assert path.stat().st_size < MAX_SMALL_BYTES
        with Image.open(path) as image:
            assert image.width == SMALL_WIDTH_PX


def test_missing_results_are_named_with_their_command(tmp_path, monkeypatch, capsys):
    out = ("--results", tmp_path, "--out", tmp_path / "out", "--small")
    draw(monkeypatch, "all", *out)
    page = capsys.readouterr().out
    for name, needed in FIGURES.items():
        expected = f"not drawn: {name}: run `python -m " if needed else f"{name}.png"
        assert expected in page
    with pytest.raises(UserError, match="leave out --strict"):
        draw(monkeypatch, "fig03", "fig05", *out, "--strict")
    with pytest.raises(UserError, match="no figure could be drawn"):
        draw(monkeypatch, "fig03", *out)


def test_damaged_results_leave_the_other_figures(tmp_path, monkeypatch, capsys):
    (tmp_path / "platform.npz").write_text("not a result")
    draw(monkeypatch, "fig03", "fig05", "--results", tmp_path, "--out", tmp_path / "out")
    page = capsys.readouterr().out
    assert "not drawn: fig03" in page
    assert "not a result of `python -m cosim.platform`" in page


def test_unknown_figures_are_refused(monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["figures", "fig99"])
    with pytest.raises(SystemExit) as exit_status:
        run_command(figures.main)
    assert exit_status.value.code == 2
    assert "no figure is called fig99; choose from all, fig02" in capsys.readouterr().err

"""The command of all figures on a small results folder."""

import json
import sys

import pytest
from PIL import Image

from analysis import figures
from analysis.caption import read_caption
from analysis.results import FIGURES
from analysis.style import FigureError
from cosim.errors import run_command

MAX_SMALL_BYTES = 150_000


def draw(monkeypatch, *arguments):
    monkeypatch.setattr(sys, "argv", ["figures", *map(str, arguments)])
    figures.main()


def test_every_figure_is_drawn_by_someone():
    assert figures.DRAWN_BY.keys() == FIGURES.keys()


def test_all_figures_are_written_with_captions_and_repeat(results, tmp_path, monkeypatch, capsys):
    for folder in ("one", "two"):
        draw(monkeypatch, "all", "--results", results, "--out", tmp_path / folder, "--json")
    content = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert content["lacking"] == {}
    assert list(content["drawn"]) == list(FIGURES)
    for name in FIGURES:
        for suffix, magic in ((".png", b"\x89PNG"), (".pdf", b"%PDF")):
            first = (tmp_path / "one" / f"{name}{suffix}").read_bytes()
            assert first.startswith(magic)
            assert first == (tmp_path / "two" / f"{name}{suffix}").read_bytes(), name
        caption = read_caption(tmp_path / "one", name)
        assert caption.figure == name
        assert caption.ours
        assert caption.inputs == FIGURES[name]


def test_small_pictures_are_small(results, tmp_path, monkeypatch):
    draw(monkeypatch, "fig05", "fig08", "--results", results, "--out", tmp_path, "--small")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["fig05.png", "fig08.png"]
    for path in tmp_path.iterdir():
        assert path.stat().st_size < MAX_SMALL_BYTES
        with Image.open(path) as image:
            assert image.width == figures.SMALL_WIDTH_PX


def test_missing_results_are_named_with_their_command(tmp_path, monkeypatch, capsys):
    draw(monkeypatch, "all", "--results", tmp_path, "--out", tmp_path / "out")
    page = capsys.readouterr().out
    assert "fig05.png" in page  # needs no results
    for name in FIGURES:
        if name != "fig05":
            assert f"not drawn: {name}: run `python -m " in page
    with pytest.raises(FigureError, match="leave out --strict"):
        draw(monkeypatch, "all", "--results", tmp_path, "--out", tmp_path / "out", "--strict")
    with pytest.raises(FigureError, match="no figure could be drawn"):
        draw(monkeypatch, "fig03", "--results", tmp_path, "--out", tmp_path / "out")


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
    assert "no figure is called fig99; choose from all, fig03" in capsys.readouterr().err

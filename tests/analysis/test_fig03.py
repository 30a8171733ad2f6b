"""Fig. 3 from a result file of `cosim.platform`, and what is said of other files."""

import numpy as np
import pytest

from analysis import fig03
from analysis.style import FigureError
from cosim import platform


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    out = tmp_path_factory.mktemp("fig03") / "platform.npz"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("sys.argv", ["platform", "--out", str(out)])
        platform.main()
    return out


def draw(monkeypatch, results, out):
    monkeypatch.setattr("sys.argv", ["fig03", "--results", str(results), "--out", str(out)])
    fig03.main()


def test_png_and_pdf_are_written_and_repeat_in_every_byte(results, tmp_path, monkeypatch):
    draw(monkeypatch, results, tmp_path / "one.png")
    draw(monkeypatch, results, tmp_path / "two")
    for suffix, magic in ((".png", b"\x89PNG"), (".pdf", b"%PDF")):
        first = (tmp_path / f"one{suffix}").read_bytes()
        assert first.startswith(magic)
        assert first == (tmp_path / f"two{suffix}").read_bytes()


def test_curves_are_those_of_the_file(results):
    arrays = fig03.load(results)
    figure = fig03.draw(arrays)
    cycles, cycle, forces = figure.axes[3:]
    position = 1e6 * arrays["table_ii_position_m"]
    np.testing.assert_array_equal(cycles.lines[0].get_ydata(), position)
    step = 1e6 * float(arrays["table_ii_net_displacement_m"])
    assert np.asarray(cycle.lines[0].get_ydata())[-1] == pytest.approx(step, rel=1e-4)
    assert any(f"{step:.3g}" in text.get_text() for text in cycle.texts)
    assert forces.lines[0].get_label() == "driving force"


def test_files_that_are_no_results_are_named(tmp_path):
    with pytest.raises(FigureError, match=r"none\.npz: no such result file; run `python -m"):
        fig03.load(tmp_path / "none.npz")
    (tmp_path / "text.npz").write_text("not a result")
    with pytest.raises(FigureError, match=r"not a result of `python -m cosim\.platform`"):
        fig03.load(tmp_path / "text.npz")
    np.savez(tmp_path / "other.npz", a=np.zeros(3))
    with pytest.raises(FigureError, match="not a result"):
        fig03.load(tmp_path / "other.npz")


def test_other_formats_are_refused(results, tmp_path, monkeypatch):
    with pytest.raises(FigureError, match=r"name a \.png or \.pdf file"):
        draw(monkeypatch, results, tmp_path / "figure.svg")

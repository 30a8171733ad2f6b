"""Captions come back as they were written, and what is none is named."""

import pytest

from analysis.figures.style import Caption, read_caption, write_caption
from cosim.base.errors import UserError

CAPTION = Caption("fig03", "Motion", "it slides", ("5 µm a turn.",), {"step_um": 5.0}, ("a.npz",))


def test_caption_comes_back(tmp_path):
    assert write_caption(CAPTION, tmp_path) == tmp_path / "fig03.json"
    assert read_caption(tmp_path, "fig03") == CAPTION
    assert CAPTION.text() == "Motion. The paper: it slides Here: 5 µm a turn."


def test_what_is_no_caption_is_named(tmp_path):
    (tmp_path / "fig05.json").write_text("[]")
    (tmp_path / "fig07.json").write_text('{"figure": "fig07"')
    for figure in ("fig03", "fig05", "fig07"):
        with pytest.raises(UserError, match=f"minirobots figures {figure}"):
            read_caption(tmp_path, figure)

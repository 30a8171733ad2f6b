"""The layout of results: every figure's inputs are defined, and every command exists."""

import pytest

from analysis.figures.style import figure_entries
from analysis.reading.results import RESULTS, missing, recordings
from cosim.base.errors import UserError
from minirobots.commands import COMMANDS


def test_figures_are_drawn_from_defined_results(tmp_path):
    assert {name for entry in figure_entries().values() for name in entry.inputs} <= RESULTS.keys()
    assert len({result.path for result in RESULTS.values()}) == len(RESULTS)
    for result in RESULTS.values():
        assert result.maker in COMMANDS
        assert result.command(tmp_path).startswith(f"minirobots {result.maker} ")
        assert result.command(tmp_path).endswith(f"--out {tmp_path / result.path}")


def test_what_is_missing_has_no_proof_and_recordings_are_found_in_order(tmp_path):
    needed = figure_entries()["path_ratio"].inputs
    assert missing(figure_entries()["fig05"].inputs, tmp_path) == []
    assert [r.name for r in missing(needed, tmp_path)] == ["fig08", "fig11"]
    proof = RESULTS["fig08"].proof_in(tmp_path)
    proof.parent.mkdir(parents=True)
    proof.write_text("{}")
    assert [r.name for r in missing(needed, tmp_path)] == ["fig11"]
    with pytest.raises(UserError, match="run `minirobots run --scenario 2 --method paper"):
        recordings("episodes_2_paper", tmp_path)
    folder = tmp_path / "episodes" / "2-paper" / "episodes"
    folder.mkdir(parents=True)
    for name in ("ep_001.rrd", "ep_000.rrd", "ep_002.rrd.part"):
        (folder / name).touch()
    found = [path.name for path in recordings("episodes_2_paper", tmp_path)]
    assert found == ["ep_000.rrd", "ep_001.rrd"]

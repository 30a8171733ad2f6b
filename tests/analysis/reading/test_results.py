"""The layout of results: every figure's inputs are defined, and every command exists."""

import pytest

from analysis.reading.results import FIGURES, RESULTS, missing, recordings
from minirobots.commands import COMMANDS


def test_figures_are_drawn_from_defined_results():
    assert {name for names in FIGURES.values() for name in names} <= RESULTS.keys()
    locations = [result.path for result in RESULTS.values()]
    assert len(set(locations)) == len(locations)


@pytest.mark.parametrize("name", ["platform", "motor_test", "fig08", "episodes_4_paper"])
def test_commands_exist_and_name_the_place(name, tmp_path):
    result = RESULTS[name]
    assert result.maker in COMMANDS
    assert result.command(tmp_path).endswith(f"--out {tmp_path / result.path}")
    assert result.command(tmp_path).startswith(f"minirobots {result.maker} ")


def test_what_is_missing_has_no_proof_and_recordings_are_found_in_order(tmp_path):
    assert missing("fig05", tmp_path) == []
    assert [r.name for r in missing("path_ratio", tmp_path)] == ["fig08", "fig11"]
    proof = RESULTS["fig08"].proof_in(tmp_path)
    proof.parent.mkdir(parents=True)
    proof.write_text("{}")
    assert [r.name for r in missing("path_ratio", tmp_path)] == ["fig11"]
    folder = tmp_path / "episodes" / "2-paper" / "episodes"
    folder.mkdir(parents=True)
    for name in ("ep_001.rrd", "ep_000.rrd", "ep_002.rrd.part"):
        (folder / name).touch()
    found = [path.name for path in recordings("episodes_2_paper", tmp_path)]
    assert found == ["ep_000.rrd", "ep_001.rrd"]

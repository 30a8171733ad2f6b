"""Recordings read back: whole and cut; and what is said of them."""

import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest

import analysis
from analysis.reading.findings import find, intervals, sliding
from cosim.base.errors import FileError
from cosim.model.config import CoSimConfig
from cosim.model.params import TABLE_II
from cosim.recording.reader import DrivenMove, Signal, Texts, _moves, read_episode, read_rrd


@pytest.fixture(scope="module")
def episode(recording):
    return read_episode(recording)


def test_episode_says_what_was_run(episode, run_folder):
    summary = json.loads((run_folder / "summary.json").read_text())
    (result,) = summary["episodes"]
    assert episode.complete
    assert episode.outcome == result["outcome"] == "timeout"
    assert episode.time_s == result["sim_time_s"] == 30.0
    assert episode.robots == ("r1", "r2")
    assert episode.facts["seed"] == summary["seed"]
    assert [list(start) for start in episode.facts["starts"]] == result["starts"]
    assert episode.facts["versions"] == summary["versions"]
    table = CoSimConfig().table()
    assert episode.parameters.keys() == table.keys()
    for name, parameter in episode.parameters.items():
        known = {"value": summary["parameters"][name], "source": parameter.source}
        assert parameter._asdict() == table[name] | known
    assert episode.parameter("V_s_max") == TABLE_II.V_s_max


def test_names_of_signals_may_be_short_and_missing_ones_are_named(episode):
    for short, path in (
        ("r1/motors/omega", "/sim/r1/motors/omega"),
        ("r2/position", "/sim/r2/position"),  # and /raw/r2/position
        ("r1/cell", "/rl/r1/cell"),
        ("raw/r1/omega", "/raw/r1/omega"),
    ):
        assert episode.signals[short] is episode.signals[path]
    assert "r3/position" not in episode.signals
    assert all(path.startswith("/") for path in episode.signals)
    with pytest.raises(KeyError, match=r"signal r1/motor/omega; .* r1/mo"):
        episode.signals["r1/motor/omega"]
    with pytest.raises(KeyError, match=r"signal qqq; record .*defaults"):
        episode.signals["qqq"]
    with pytest.raises(FileError, match="lacks its parameter nothing"):
        episode.parameter("nothing")


def test_an_episode_is_saved_under_another_name_and_nothing_is_lost(recording, episode, tmp_path):
    saved = tmp_path / "new" / "copy.rrd"
    episode.save(saved)
    assert saved.read_bytes() == recording.read_bytes()
    assert analysis.open(str(recording)).recording_id == episode.recording_id
    with pytest.raises(FileError, match="it exists; move it away"):
        episode.save(saved)


@pytest.fixture(scope="module")
def cut_recording(recording, tmp_path_factory):
    """What is there of the recording if its writer was stopped before its end."""
    cut = tmp_path_factory.mktemp("cut") / "ep_000.rrd.part"
    shutil.copy(recording, cut)
    with cut.open("r+b") as file:
        file.truncate(int(0.8 * recording.stat().st_size))
    return cut


def test_recording_cut_in_the_middle_is_read(cut_recording, episode):
    part = read_episode(cut_recording)
    assert (part.complete, part.outcome, part.path) == (False, "", cut_recording)
    assert part.recording_id == episode.recording_id
    whole, held = (e.signals["/raw/r1/omega"].values for e in (episode, part))
    assert 0 < len(held) <= len(whole)
    np.testing.assert_array_equal(held, whole[: len(held)])


def test_what_is_no_episode_is_refused_in_one_sentence(tmp_path, run_folder):
    (tmp_path / "left.rrd.part").touch()
    (tmp_path / "empty.rrd").touch()
    (tmp_path / "broken.rrd").write_bytes(b"RRF2 and then nothing of use")
    for path, error in (
        (tmp_path / "none.rrd", r"no such recording; name an \.rrd file"),
        (tmp_path / "left.rrd", r"its writer left .*left\.rrd\.part"),
        (Path("/dev/null"), "/dev/null: a device or a pipe, no recording"),
        (tmp_path, "a folder, no recording"),
        (tmp_path / "empty.rrd", "not a readable Rerun recording"),
        (tmp_path / "broken.rrd", "not a readable Rerun recording"),
    ):
        with pytest.raises(FileError, match=error):
            read_episode(path)
    with pytest.raises(FileError, match="holds no episode"):
        read_episode(run_folder / "training.rrd")
    training = read_rrd(run_folder / "training.rrd")
    assert training.complete
    assert training.signals == {}  # nothing there is on the timeline of simulated time


def test_moves_end_time_out_or_are_cut_off():
    states = Texts(np.array([0.0, 4.0, 6.0, 46.0, 46.0]), ("0°", "ended", "90°", "given up", "45°"))
    assert _moves(states, 50.0) == (
        DrivenMove(0.0, 4.0, "0°", ended=True, given_up=False),
        DrivenMove(6.0, 46.0, "90°", ended=False, given_up=True),
        DrivenMove(46.0, 50.0, "45°", ended=False, given_up=False),
    )


def test_feet_at_the_friction_limit_slide_for_intervals():
    mask = np.array([True, False, True, True, False, True])
    assert intervals(mask).tolist() == [[0, 0], [2, 3], [5, 5]]
    assert intervals(np.zeros(3, dtype=bool)).tolist() == []
    time_s = np.zeros(2)
    normal = Signal(time_s, np.array([[1.0, 1.0, 0.0], [2.0, 1.0, 1.0]]), (), "N")
    forces = np.array([[0.09, 0.12, 0.1, 0, 0, 0], [0, 0.3, 0, 0, 0, 0.15]])
    friction = Signal(time_s, forces, (), "N")
    expected = [[True, False, False], [True, False, True]]
    assert sliding(friction, normal, 0.15).tolist() == expected


def test_findings_say_when_and_what(episode):
    findings = {(finding.kind, finding.where): finding for finding in find(episode)}
    voltage = episode.signals["/sim/r1/motors/voltage"]
    share = float((np.abs(voltage.values[:, 0]) >= TABLE_II.V_s_max).mean())
    saturation = findings["voltage saturation", "r1 D"]
    assert saturation.numbers["share"] == share > 0.0  # the motors start from rest
    assert saturation.time_s is not None
    assert saturation.time_s < 0.1
    assert 0.0 < findings["slipping", "r1"].numbers["share"] < 1.0
    assert findings["not arrived", "r1"].time_s == 30.0
    assert not any(kind in {"near miss", "collision"} for kind, _ in findings)


def test_inspect_prints_a_page_and_json(recording, episode, cut_recording, command):
    page = command("inspect", recording, "--parameters", "--json").stdout
    content = json.loads(page.splitlines()[-1])
    for row in content["signals"]:
        signal = episode.signals[row["signal"]]
        values = signal.values.reshape(len(signal.time_s), -1)
        known = values[:, signal.names.index(row["component"])]
        known = known[np.isfinite(known)]
        measures = {"minimum": np.min, "mean": np.mean, "maximum": np.max, "deviation": np.std}
        for name, measure in measures.items() if len(known) else ():
            assert row[name] == pytest.approx(float(measure(known)), rel=1e-6), (row, name)
    assert content["outcome"] == "timeout"
    moves = episode.moves["r1"]
    assert content["robots"]["r1"] == {
        "path_length_m": content["robots"]["r1"]["path_length_m"],
        "moves": len(moves),
        "moves_ended": sum(move.ended for move in moves),
        "moves_timed_out": sum(move.given_up for move in moves),
    }
    row = next(r for r in content["signals"] if r["signal"] == "/sim/r1/motors/omega")
    expected = {"component": "D", "unit": "rad/s", "samples": 6000, "period_s": 0.005}
    assert row | expected == row
    raw = next(r for r in content["signals"] if r["signal"] == "/raw/r1/omega")
    assert raw["period_s"] == 1e-5  # within bursts
    for text in ("outcome timeout", "voltage saturation", "V_s_max", "motors/omega_des"):
        assert text in page
    of_speeds = page.split("/sim/r1/motors/omega in rad/s, 6000 samples every 0.005 s\n")[1]
    assert re.match(r"  D(?: +\S+){4}\n  E(?: +\S+){4}\n/", of_speeds)
    assert "its writer was stopped" in command("inspect", cut_recording).stdout

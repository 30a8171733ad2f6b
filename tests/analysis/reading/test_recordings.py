"""Recordings read back: whole, cut, and left by a killed writer; and what is said of them."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

import analysis
from analysis.reading.findings import find, intervals, sliding
from cosim.base.errors import FileError
from cosim.model.config import CoSimConfig
from cosim.model.params import TABLE_II, TIMING
from cosim.recording.reader import DrivenMove, Signal, Texts, _moves, read_episode, read_rrd


@pytest.fixture(scope="module")
def episode(recording):
    return read_episode(recording)


def test_episode_says_what_was_run(episode, run_folder):
    summary = json.loads((run_folder / "summary.json").read_text())
    (result,) = summary["episodes"]
    assert episode.complete
    assert episode.outcome == result["outcome"] == "timeout"
    assert episode.time_s == result["sim_time_s"] == 8.0
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


def test_signals_are_arrays_in_order_of_time(episode):
    omega = episode.signals["/sim/r1/motors/omega"]
    assert omega.components == ("D", "E")
    assert omega.values.shape == (8000, 2)
    assert omega.time_s == pytest.approx(TIMING.control_period_s * np.arange(1, 8001), abs=1e-9)
    raw = episode.signals["/raw/r2/omega"]
    assert np.diff(raw.time_s).min() == pytest.approx(TIMING.dt_s, abs=1e-9)
    assert (omega.unit, episode.signals["/world/r1/robot:translation"].unit) == ("rad/s", "m")
    for path, signal in episode.signals.items():
        assert (np.diff(signal.time_s) >= 0.0).all(), path
        assert len(signal.time_s) == len(signal.values), path
        assert signal.unit or not path.startswith(("/sim/", "/raw/", "/rl/")), path


def test_names_of_signals_may_be_short(episode):
    for short, path in (
        ("r1/motors/omega", "/sim/r1/motors/omega"),
        ("r2/position", "/sim/r2/position"),  # and /raw/r2/position
        ("r1/cell", "/rl/r1/cell"),
        ("raw/r1/omega", "/raw/r1/omega"),
    ):
        assert episode.signals[short] is episode.signals[path]
    assert "r3/position" not in episode.signals
    assert all(path.startswith("/") for path in episode.signals)


def test_an_episode_is_saved_under_another_name_and_nothing_is_lost(recording, episode, tmp_path):
    saved = tmp_path / "new" / "copy.rrd"
    episode.save(saved)
    assert saved.read_bytes() == recording.read_bytes()
    assert analysis.open(str(recording)).recording_id == episode.recording_id
    with pytest.raises(FileError, match="it exists; move it away"):
        episode.save(saved)


def test_signals_agree_with_each_other(episode):
    """Burst and control-period samples at the same times are the same numbers."""
    slow, raw = (episode.signals[f"/{rate}/r1/{name}"] for rate, name in
                 (("sim", "motors/omega"), ("raw", "omega")))  # fmt: skip
    _, i, j = np.intersect1d(
        np.round(1e9 * slow.time_s), np.round(1e9 * raw.time_s), return_indices=True
    )
    assert len(i) >= 4 * 8  # bursts of 9 ms at least
    np.testing.assert_array_equal(slow.values[i], raw.values[j])
    position = episode.signals["/world/r1/robot:translation"]
    assert position.values[-1, 2] == pytest.approx(0.015, abs=1e-3)


def test_missing_signals_and_parameters_are_named(episode):
    with pytest.raises(match=r"signal r1/motor/omega; .* r1/mo"):
        episode.signals["r1/motor/omega"]
    with pytest.raises(KeyError, match=r"signal qqq; record .*defaults"):
        episode.signals["qqq"]
    with pytest.raises(match="lacks its parameter nothing"):
        episode.parameter("nothing")


def test_recording_of_a_killed_run_is_read(killed_recording):
    episode = read_episode(killed_recording)
    assert not episode.complete
    assert episode.outcome == ""
    assert episode.time_s >= TIMING.rl_step_s
    assert len(episode.signals["/sim/r1/motors/omega"].time_s) >= 2000


def test_recording_cut_in_the_middle_is_read(recording, episode, tmp_path):
    cut = tmp_path / "cut.rrd"
    shutil.copy(recording, cut)
    with cut.open("r+b") as file:
        file.truncate(int(0.8 * recording.stat().st_size))
    part = read_episode(cut)
    assert not part.complete
    assert part.path == cut
    assert part.recording_id == episode.recording_id
    whole = episode.signals["/raw/r1/omega"]
    held = part.signals["/raw/r1/omega"]
    assert 0 < len(held.time_s) <= len(whole.time_s)
    np.testing.assert_array_equal(held.values, whole.values[: len(held.values)])


def test_what_is_no_episode_is_refused_in_one_sentence(tmp_path, run_folder):
    with pytest.raises(match=r"no such recording; name an \.rrd file"):
        read_episode(tmp_path / "none.rrd")
    (tmp_path / "left.rrd.part").touch()
    with pytest.raises(match=r"its writer left .*left\.rrd\.part"):
        read_episode(tmp_path / "left.rrd")
    for path, what in ((Path("/dev/null"), "a device"), (tmp_path, "a folder")):
        with pytest.raises(match=f"{path}: {what}, no recording"):
            read_episode(path)
    for content in (b"", b"RRF2 and then nothing of use"):
        broken = tmp_path / "broken.rrd"
        broken.write_bytes(content)
        with pytest.raises(match="not a readable Rerun recording"):
            read_episode(broken)
    with pytest.raises(match="holds no episode"):
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
    assert findings["not arrived", "r1"].time_s == 8.0
    assert not any(kind in {"near miss", "collision"} for kind, _ in findings)


def test_inspect_prints_a_page_and_json(recording, killed_recording, command):
    page = command("inspect", recording, "--parameters", "--json").stdout
    content = json.loads(page.splitlines()[-1])
    assert content["outcome"] == "timeout"
    assert content["robots"]["r1"]["moves"] >= 1
    row = next(r for r in content["signals"] if r["signal"] == "/sim/r1/motors/omega")
    assert (row["component"], row["unit"], row["samples"], row["period_s"]) == (
        "D", "rad/s", 8000, 0.001,
    )  # fmt: skip
    for text in ("outcome timeout", "voltage saturation", "V_s_max", "motors/omega_des"):
        assert text in page
    assert "its writer was stopped" in command("inspect", killed_recording).stdout

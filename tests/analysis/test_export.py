"""Recordings written for other programs: read back by their own readers, every value is there."""

import csv
import json
import re
from pathlib import Path

import numpy as np
import pyarrow.parquet
import pytest

import analysis
from analysis.export import export
from cosim.recording.reader import Episode, Signal, Signals, Texts

MADE_UP = Path("made_up.rrd")
Values = dict[tuple[str, str], tuple[str, list[float], list]]


@pytest.fixture(scope="module")
def episode(recording):
    return analysis.open(recording)


@pytest.fixture(scope="module")
def expected(episode) -> Values:
    """Unit, times and values by signal and component."""
    held: Values = {}
    for path, signal in episode.signals.items():
        columns = signal.values.reshape(len(signal.time_s), -1).T
        for name, column in zip(signal.components or ("0", "1", "2", "3"), columns, strict=False):
            held[path, name] = signal.unit, signal.time_s.tolist(), column.tolist()
    for path, texts in episode.texts.items():
        held[path, "text"] = "", texts.time_s.tolist(), list(texts.texts)
    return held


def read_csv(path):
    with path.open(newline="") as file:
        for row in csv.DictReader(file):
            yield row | {k: float(row[k]) if row[k] else None for k in ("time_s", "value")}


READERS = {"parquet": lambda path: pyarrow.parquet.read_table(path).to_pylist(), "csv": read_csv}


def read(path) -> Values:
    found: Values = {}
    for row in READERS[path.suffix[1:]](path):
        key = row["signal"], row["component"] or "text"
        _, times, values = found.setdefault(key, (row["unit"], [], []))
        times.append(row["time_s"])
        values.append(row["text"] if row["value"] is None else row["value"])
    return found


@pytest.mark.parametrize("kind", READERS)
def test_every_value_is_read_back(command, recording, expected, kind, tmp_path):
    out = tmp_path / f"episode.{kind}"
    run = command("export", recording, "--to", kind, "--out", out, "--json")
    assert run.returncode == 0, run.stderr
    said = json.loads(run.stdout.splitlines()[-1])
    assert said["bytes"] == out.stat().st_size
    assert [path.name for path in tmp_path.iterdir()] == [out.name]
    found = read(out)
    assert found.keys() == {key for key, (_, times, _) in expected.items() if times}
    for key, entry in found.items():
        assert entry == expected[key], key
    if kind == "parquet":
        metadata = pyarrow.parquet.read_schema(out).metadata
        run_of = json.loads(metadata[b"minirobots"])
        assert (run_of["facts"]["scenario"], run_of["parameters"]["mu"]["unit"]) == ("2", "1")


@pytest.mark.parametrize("kind", READERS)
def test_long_names_and_odd_values_survive(tmp_path, kind):
    long = "/sim/r1/" + "long_" * 20
    values = np.array([np.nan, np.inf])
    held = {long + k: Signal(np.array([0.001, 0.002]), values, (), "m") for k in "ab"}
    lines = ["one, two", 'a "quoted" word']
    texts = {"/log": Texts(np.array([0.001, 0.002]), tuple(lines))}
    run = MADE_UP, "id", True, "", 1.0, ("r1",), {}, {}
    episode = Episode(*run, Signals(str(MADE_UP), held), texts, {}, None)
    export(episode, kind, tmp_path / f"e.{kind}")
    found = read(tmp_path / f"e.{kind}")
    assert found["/log", "text"][2] == lines
    for path in held:
        unit, _, read_back = found[path, "0"]
        assert unit == "m"
        np.testing.assert_array_equal(read_back, values)


@pytest.mark.parametrize("kind", READERS)
def test_some_signals_at_some_rate(command, recording, episode, tmp_path, kind):
    """Each format has the chosen signals, of each period the first sample."""
    names = ("r1/motors/omega", "/rl/r2/*")
    chosen = {path for path in (*episode.signals, *episode.texts) if path.startswith("/rl/r2/")}
    chosen.add("/sim/r1/motors/omega")
    whole = episode.signals["r1/motors/omega"]
    ns = np.round(1e9 * whole.time_s).astype(int)
    _, kept = np.unique(ns // 50_000_000, return_index=True)
    out = tmp_path / f"e.{kind}"
    options = ("--out", out, "--rate", "20", "--signals", *names)
    run = command("export", recording, "--to", kind, *options)
    assert run.returncode == 0, run.stderr
    found = read(out)
    assert {path for path, _ in found} == chosen
    unit, times, values = found["/sim/r1/motors/omega", whole.components[0]]
    assert unit == whole.unit
    assert times == whole.time_s[kept].tolist()
    assert values == whole.values[kept, 0].tolist()
    assert found["/rl/r2/move", "text"][2] == list(episode.texts["/rl/r2/move"].texts)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--signals", "r1/motors/omga"), "omga: .* has no such signal or state; .* lists them"),
        (("--signals", "r1/motors/omega", "r9/*"), r"--signals r9/\*: "),
        (("--rate", "0"), "--rate 0 is invalid; give samples per second above 0"),
        (("--rate", "nan"), "--rate nan is invalid"),
        (("--rate", "1e9"), r"--rate 1e\+09 is invalid; .* above 0 and below 1e9"),
        (("--to", "xls"), "parquet"),
    ],
)
def test_refusals_leave_nothing(command, recording, tmp_path, options, said):
    for of in (recording, tmp_path / "none.rrd"):
        run = command("export", of, "--to", "csv", "--out", tmp_path / "e.csv", *options)
        assert run.returncode == 2
        assert of != recording or re.search(said, run.stderr + run.stdout)
    assert not list(tmp_path.iterdir())

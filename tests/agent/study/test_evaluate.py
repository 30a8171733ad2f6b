"""Evaluation in the co-simulation: real short episodes, kept, continued, counted and recorded."""

import os
import resource
import signal
import sqlite3
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import pytest
from pyarrow import parquet

from agent.evaluation.cases import Case, Job
from agent.evaluation.rows import measures
from agent.study.grid import EvaluationReport, policy_files
from agent.study.options import Sampling
from agent.study.report import Report
from agent.study.store import FILE, EpisodeStore, export
from agent.study.user import STARTS, measured
from cosim.base.errors import UserError
from cosim.base.jobs import Workers
from cosim.base.progress import silent
from cosim.model.config import CoSimConfig
from cosim.model.outcome import Outcome
from cosim.model.params import TABLE_I
from cosim.recording.reader import read_rrd
from cosim.simulation.result import EpisodeResult
from minirobots.commands.policies import Evaluate

RESULT = EpisodeResult(
    Outcome.SUCCESS, 10.0, 60.0, 9.0, None, ((0, 0),), (10.0,), 0.0, 8.0, 9.0, (9.0,), 0
)


@pytest.fixture
def case(near_policy, motor_fmu):
    return Case(near_policy, CoSimConfig(), motor_fmu, 0)


def run(near_file, out, *, starts=None, recordings=0, jobs=1, **physics) -> Report:
    how = Sampling(out=out, where=Workers(jobs=jobs))
    count, exactly = STARTS if starts is None else starts, starts is not None
    sample: Any = {"exactly": exactly, "recordings": recordings, "kind": EvaluationReport}
    sample |= {"store": EpisodeStore(out), "progress": silent, "episodes": False}
    return measured({str(near_file): near_file}, [None], how, physics, count, **sample)


def rows(folder: Path) -> dict[int, str]:
    """Rows of a folder's only case, by index of the start."""
    with sqlite3.connect(folder / FILE) as file:
        return dict(file.execute("SELECT start, result FROM episodes ORDER BY start"))


def results(folder: Path) -> list[EpisodeResult]:
    """These without the time that they took."""
    found = [msgspec.json.decode(text, type=EpisodeResult) for text in rows(folder).values()]
    return [msgspec.structs.replace(result, realtime_factor=1.0) for result in found]


@pytest.fixture(scope="module")
def whole(near_file, tmp_path_factory) -> tuple[Path, Report]:
    """All four starts, two at a time, one success recorded."""
    out = tmp_path_factory.mktemp("whole")
    return out, run(near_file, out, jobs=2, recordings=1)


def test_report_counts_every_start(whole):
    out, report = whole
    (row,) = report.rows
    assert (row.episodes, row.starts, row.scenario) == (4, 4, "near")
    assert row.interval("success") == pytest.approx((1.0, 0.5101, 1.0), abs=1e-4)
    assert row.collision == row.timeout == row.out_of_board == 0.0
    assert row.path_length_cm == pytest.approx(1.5, abs=0.2)
    assert row.path_ratio_to_grid == pytest.approx(1.0, abs=0.15)
    assert row.min_distance_cm == pytest.approx(7.07, abs=0.3)
    assert 0.0 < row.energy_j < 10.0
    assert row.failures == ()
    assert len({result.starts for result in results(out)}) == 4
    (recording,) = map(Path, row.recordings)
    assert recording.name.endswith("-success.rrd")
    assert recording.stat().st_size > 100_000


def test_jobs_and_interruptions_change_nothing(whole, near_file, tmp_path):
    run(near_file, tmp_path, starts=2)
    kept = rows(tmp_path)
    assert len(kept) == 2
    run(near_file, tmp_path)
    assert rows(tmp_path).items() >= kept.items()
    assert results(tmp_path) == results(whole[0])
    before = (tmp_path / FILE).read_bytes()
    run(near_file, tmp_path)
    assert (tmp_path / FILE).read_bytes() == before


def test_recordings_keep_what_came_of_the_episode(whole):
    out, report = whole
    (recording,) = map(Path, report.rows[0].recordings)
    result = msgspec.json.decode(rows(out)[int(recording.stem.split("-")[-2])], type=EpisodeResult)
    assert read_rrd(recording).properties["result"] == {
        "outcome": "success",
        "path_length_cm": sum(result.path_length_cm_by_robot) / 2,
        "rotation_deg": pytest.approx(sum(result.rotation_deg_by_robot) / 2),
        "sim_time_s": result.sim_time_s,
        "contact_time_s": 0.0,
        "energy_j": result.energy_j,
        "conflicts": result.conflicts,
        "min_distance_cm": result.min_distance_cm,
    }


def test_paths_over_those_of_the_grid_begin_again_after_all_starts(case):
    """As episodes of a claim do, each time with other noise."""
    grid = case.policy.evaluate_on_grid(case.starts)
    cells = grid.path_cells.mean(axis=1).tolist()
    assert len({*cells}) > 1
    short, long = cells.index(min(cells)), cells.index(max(cells))
    lengths = {short: 2.5, len(cells) + long: 3.0, 2 * len(cells) + short: 4.0}
    found = measures(
        [(case, {k: msgspec.structs.replace(RESULT, path_length_cm=v) for k, v in lengths.items()})]
    )
    ratios = [2.5 / cells[short], 3.0 / cells[long], 4.0 / cells[short]]
    assert found["path_ratio_to_grid"] == pytest.approx(sum(ratios) / 3)


def test_failure_is_listed_and_recorded(near_file, tmp_path):
    (row,) = run(near_file, tmp_path, starts=1, time_limit=2.0, recordings=1).rows
    assert (row.success, row.timeout, row.failing_starts) == (0.0, 1.0, 1)
    assert row.path_length_cm is row.path_ratio_to_grid is None
    (failure,) = row.failures
    assert (failure.outcome, failure.recording) == (Outcome.TIMEOUT, row.recordings[0])


def test_samples_are_seeded_and_nested(case):
    assert sorted(case.sample(4)) == [0, 1, 2, 3]
    assert case.sample(2) == case.sample(4)[:2]
    assert len({tuple(replace(case, seed=k).sample(4)) for k in range(9)}) > 1
    with pytest.raises(UserError, match="scenario near has only 4 starts, not 5"):
        case.sample(5)


def test_every_configuration_has_its_own_rows(case, near_policy, tmp_path):
    slippery = CoSimConfig(robot=TABLE_I._replace(mu=0.1))
    other_policy = replace(near_policy, q=near_policy.q + 1.0)
    store = EpisodeStore(tmp_path)
    store.keep(Job(case, 0), RESULT)
    for of in ({"config": slippery}, {"seed": 1}, {"policy": other_policy}):
        assert store.find(Job(replace(case, **of), 0)) is None
    assert EpisodeStore(tmp_path).find(Job(replace(case), 0)) == RESULT


def test_reading_writes_nothing_and_two_writers_lose_nothing(case, tmp_path, caplog):
    assert EpisodeStore(tmp_path / "new").results(case) == {}
    assert not (tmp_path / "new").exists()
    EpisodeStore(tmp_path).keep(Job(case, 0), RESULT)
    before = {path: path.stat().st_mtime_ns for path in tmp_path.iterdir()}
    assert EpisodeStore(tmp_path).results(case) == {0: RESULT}
    assert before == {path: path.stat().st_mtime_ns for path in tmp_path.iterdir()}
    first, second = EpisodeStore(tmp_path), EpisodeStore(tmp_path)
    for number, store in enumerate((second, first, second), start=1):
        store.keep(Job(case, number), RESULT)
    assert list(EpisodeStore(tmp_path).results(case)) == [0, 1, 2, 3]
    (tmp_path / "old").mkdir()
    (tmp_path / "old" / "near-0123.jsonl").write_text("{}\n")
    EpisodeStore(tmp_path / "old")
    assert "results of an earlier version (*.jsonl) are not read" in caplog.text


def test_a_row_counts_the_beginning_of_its_sample(case):
    """A long episode is still under way, or was lost, while later ones have ended."""
    none = measures([(case, {})])
    assert none.pop("episodes") == 0
    assert set(none.values()) == {None}
    store, indices = EpisodeStore(), case.rounds(6)
    for place in (0, 1, 3, 5):
        store.keep(Job(case, indices[place]), RESULT)
    assert list(store.completed_prefix(case, indices)) == indices[:2]
    store.keep(Job(case, indices[2]), RESULT)
    assert list(store.completed_prefix(case, indices)) == indices[:4]


@pytest.mark.parametrize("content", [b"notes without an end", os.urandom(5000)])
def test_a_file_of_something_else_is_kept(case, tmp_path, content):
    (tmp_path / FILE).write_bytes(content)
    for act in (EpisodeStore.results, lambda store, case: store.keep(Job(case, 0), RESULT)):
        with pytest.raises(UserError, match=r"not a file of results or damaged .* move it away"):
            act(EpisodeStore(tmp_path), case)
    assert (tmp_path / FILE).read_bytes() == content


@pytest.mark.parametrize(
    "tables", ["CREATE TABLE notes (text)", "CREATE TABLE episodes (digest, start)"]
)
def test_a_file_of_other_tables_is_named(case, tmp_path, tables):
    with sqlite3.connect(tmp_path / FILE) as file:
        file.execute(tables)
    with pytest.raises(UserError, match=r"not a file of results .*no such .* move it away"):
        EpisodeStore(tmp_path).results(case)


@pytest.mark.parametrize("text", [b"\xff", b"[" * 100_000, b'{"outcome": 1e999}', b"3", 7])
def test_a_damaged_row_is_reported(case, tmp_path, text):
    EpisodeStore(tmp_path).keep(Job(case, 0), RESULT)
    with sqlite3.connect(tmp_path / FILE) as file:
        file.execute("UPDATE episodes SET result = ?", (text,))
    with pytest.raises(UserError, match=f"{FILE}: not a file of results or damaged"):
        EpisodeStore(tmp_path).results(case)


def test_a_row_that_does_not_fit_is_an_error_and_leaves_whole_rows(case, tmp_path):
    EpisodeStore(tmp_path).keep(Job(case, 0), RESULT)
    size = (tmp_path / FILE).stat().st_size
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    signalled = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, limits[1]))
    long = msgspec.structs.replace(RESULT, path_length_cm_by_robot=(0.1,) * 10_000)
    try:
        with pytest.raises(UserError, match=rf"{FILE}: cannot be read or written .* free some"):
            EpisodeStore(tmp_path).keep(Job(case, 1), long)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        signal.signal(signal.SIGXFSZ, signalled)
    EpisodeStore(tmp_path).keep(Job(case, 2), RESULT)
    assert list(EpisodeStore(tmp_path).results(case)) == [0, 2]


def test_a_method_is_one_next_to_a_folder_of_its_name(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("paper", "other"):
        (tmp_path / name).mkdir()
    assert policy_files(["paper"]) == ["paper"]
    with pytest.raises(UserError, match="other: no run_"):
        policy_files(["other"])


def test_episodes_are_exported(whole, tmp_path):
    export(whole[0], tmp_path / "episodes.parquet")
    table = parquet.read_table(tmp_path / "episodes.parquet").to_pydict()
    assert table["outcome"] == ["success"] * 4
    assert sorted(table["index"]) == [0, 1, 2, 3]
    assert set(table["mu"]) == {0.15}
    with pytest.raises(UserError, match="no such file of results"):
        export(tmp_path, tmp_path / "none.parquet")


def test_command_prints_json_last(command, whole, near_file):
    out, report = whole
    options = ("--starts", "all", "--out", out, "--recordings", 1, "--json")
    done = command("evaluate", near_file, *options)  # everything is there already
    assert done.returncode == 0, done.stderr
    assert "outcomes with 95 % intervals" in done.stdout
    assert msgspec.json.decode(done.stdout.splitlines()[-1], type=EvaluationReport) == report


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"starts": "many"}, "--starts many is neither 'all' nor a positive number"),
        ({"starts": "0"}, "--starts 0 is neither"),
        ({"recordings": -1}, "recordings = -1 is invalid: expected int >= 0"),
        ({"seed": -1}, "seed = -1"),
        ({"budget_minutes": -1.0}, "budget_minutes = -1.0 is invalid"),
    ],
)
def test_bad_options_are_refused(options, message):
    with pytest.raises(UserError, match=message):
        Evaluate(**options)

"""Evaluation in the co-simulation: real short episodes, kept, continued, counted and recorded."""

import resource
import signal
from dataclasses import replace
from pathlib import Path

import msgspec
import pytest
from pyarrow import parquet

from agent.evaluation.cases import Case
from agent.evaluation.outcomes import summary
from agent.evaluation.statistics import rate
from agent.study.evaluate import EvaluationReport, evaluate
from agent.study.store import ResultFile, export
from cosim.base.errors import UserError
from cosim.base.jobs import Workers
from cosim.model.config import CoSimConfig
from cosim.model.outcome import Outcome
from cosim.model.params import TABLE_I
from cosim.simulation.options import SimulationOptions
from cosim.simulation.result import EpisodeResult
from minirobots.commands.policies import Evaluate

RESULT = EpisodeResult(
    Outcome.SUCCESS, 10.0, 60.0, 9.0, None, ((0, 0),), (10.0,), 0.0, 8.0, 9.0, (9.0,), 0
)


@pytest.fixture
def case(near_policy, motor_fmu):
    return Case(near_policy, CoSimConfig(), motor_fmu, 0)


def run(near_file, out, *, starts=None, recordings=0, jobs=1, **physics):
    where = Workers(jobs=jobs)
    report = evaluate(
        [near_file],
        SimulationOptions(**physics),
        out,
        starts=starts,
        recordings=recordings,
        where=where,
    )
    return Path(report.policies[0].results), report


def results(path: Path) -> dict[int, EpisodeResult]:
    """Results of a file without the time that they took."""
    return {
        index: msgspec.structs.replace(result, realtime_factor=1.0, recording=None)
        for index, result in ResultFile(path).results.items()
    }


@pytest.fixture(scope="module")
def whole(near_file, tmp_path_factory):
    """All four starts, two at a time, one success recorded."""
    out = tmp_path_factory.mktemp("whole")
    return run(near_file, out, jobs=2, recordings=1)


def test_report_counts_every_start(whole):
    path, report = whole
    (row,) = report.policies
    assert (row.episodes, row.starts, row.scenario) == (4, 4, "near")
    assert (row.success, row.success_high) == (1.0, 1.0)
    assert row.success_low == pytest.approx(0.5101, abs=1e-4)
    assert row.collision == row.timeout == row.out_of_board == 0.0
    assert row.path_length_cm == pytest.approx(1.5, abs=0.2)
    assert row.path_ratio_to_grid == pytest.approx(1.0, abs=0.15)
    assert row.min_distance_cm == pytest.approx(7.07, abs=0.3)
    assert 0.0 < row.energy_j < 10.0
    assert row.failures == ()
    assert len({r.starts for r in results(path).values()}) == 4


def test_jobs_and_interruptions_change_nothing(whole, near_file, tmp_path):
    path, _ = run(near_file, tmp_path, starts=2)
    assert len(results(path)) == 2
    kept = path.read_bytes()
    # a process killed while it wrote a third result
    path.write_bytes(kept + b'{"index": 3, "outc')
    run(near_file, tmp_path)
    assert path.read_bytes().startswith(kept + b'{"outcome":')
    assert results(path) == results(whole[0])
    written = path.read_bytes()
    run(near_file, tmp_path)
    assert path.read_bytes() == written


def test_success_is_recorded(whole):
    _, report = whole
    (path,) = map(Path, report.policies[0].recordings)
    assert path.name.endswith("-success.rrd")
    assert path.stat().st_size > 100_000


def test_failure_is_listed_and_recorded(near_file, tmp_path):
    _, report = run(near_file, tmp_path, starts=1, time_limit=2.0, recordings=1)
    (row,) = report.policies
    assert (row.success, row.timeout, row.failing_starts) == (0.0, 1.0, 1)
    assert row.path_length_cm is row.path_ratio_to_grid is None
    (failure,) = row.failures
    assert failure.outcome == Outcome.TIMEOUT
    assert failure.recording == row.recordings[0]


def test_samples_are_seeded_and_nested(near_policy, motor_fmu):
    case = Case(near_policy, CoSimConfig(), motor_fmu, 0)
    assert sorted(case.sample(4)) == [0, 1, 2, 3]
    assert case.sample(2) == case.sample(4)[:2]
    others = {tuple(Case(near_policy, CoSimConfig(), motor_fmu, k).sample(4)) for k in range(9)}
    assert len(others) > 1
    with pytest.raises(UserError, match="scenario near has only 4 starts, not 5"):
        case.sample(5)


def test_every_configuration_has_its_own_file(near_policy, motor_fmu, tmp_path):
    case = Case(near_policy, CoSimConfig(), motor_fmu, 0)
    slippery = CoSimConfig(robot=TABLE_I._replace(mu=0.1))
    other_policy = replace(near_policy, q=near_policy.q + 1.0)
    others = [
        replace(case, config=slippery),
        replace(case, seed=1),
        replace(case, policy=other_policy),
    ]
    files = [ResultFile.of_case(tmp_path, c) for c in (case, *others)]
    assert len({file.path for file in files}) == 4
    assert not any(file.path.exists() for file in files)  # nothing is kept yet
    for file in files:
        file.add(0, RESULT)
    files[0].path.replace(files[1].path)
    with pytest.raises(UserError, match="holds results of another configuration"):
        ResultFile.of_case(tmp_path, others[0])
    files[2].path.write_bytes(files[2].path.read_bytes() + b'{"index":1}\n')
    with pytest.raises(UserError, match="line 3 is damaged"):
        ResultFile.of_case(tmp_path, others[1])


def read_only(folder):
    """Names, contents and times of the files of a folder."""
    return {path: (path.read_bytes(), path.stat().st_mtime_ns) for path in folder.iterdir()}


@pytest.mark.parametrize("kept", [0, 20, -20, -1])
def test_reading_writes_nothing_and_appending_repairs_the_end(case, tmp_path, kept):
    """Whether the last line, or the first one, was cut off."""
    path = ResultFile.of_case(tmp_path, case).path
    assert not path.exists()
    ResultFile.of_case(tmp_path, case).add(0, RESULT)
    whole = path.read_bytes()
    path.write_bytes(whole[:kept])
    before = read_only(tmp_path)
    file = ResultFile.of_case(tmp_path, case)
    assert file.results == {}
    assert read_only(tmp_path) == before
    file.add(0, RESULT)
    assert path.read_bytes() == whole


def test_a_file_of_something_else_is_kept(case, tmp_path):
    path = ResultFile.of_case(tmp_path, case).path
    path.write_bytes(b"notes without an end")
    with pytest.raises(UserError, match="not a file of results; move it away"):
        ResultFile.of_case(tmp_path, case)
    assert path.read_bytes() == b"notes without an end"


def test_a_second_writer_is_refused(case, tmp_path):
    first, second = ResultFile.of_case(tmp_path, case), ResultFile.of_case(tmp_path, case)
    first.add(0, RESULT)
    with pytest.raises(UserError, match="another process writes to this file"):
        second.add(1, RESULT)
    first.add(2, RESULT)
    assert list(ResultFile.of_case(tmp_path, case).results) == [0, 2]


def test_a_row_that_does_not_fit_is_an_error_and_leaves_whole_lines(case, tmp_path):
    file = ResultFile.of_case(tmp_path, case)
    file.add(0, RESULT)
    whole = file.path.read_bytes()
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    signalled = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (len(whole) + 10, limits[1]))
    try:
        with pytest.raises(OSError, match=file.path.name):
            file.add(1, RESULT)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        signal.signal(signal.SIGXFSZ, signalled)
    file.add(2, RESULT)
    assert file.path.read_bytes().startswith(whole)
    assert list(ResultFile.of_case(tmp_path, case).results) == [0, 2]


@pytest.mark.parametrize(
    ("count", "episodes", "low", "high"),
    [(0, 30, 0.0, 0.11351), (30, 30, 0.88649, 1.0), (95, 100, 0.88825, 0.97846)],
)
def test_wilson_interval(count, episodes, low, high):
    assert rate(count, episodes) == pytest.approx((count / episodes, low, high), abs=1e-5)


def test_no_episode_gives_no_numbers(near_policy, motor_fmu):
    values = msgspec.structs.asdict(summary(Case(near_policy, CoSimConfig(), motor_fmu, 0), {}))
    assert values.pop("episodes") == 0
    assert set(values.values()) == {None}


def test_the_default_is_at_most_what_the_scenario_has(whole, near_file):
    out = whole[0].parent
    some, every = (run(near_file, out, starts=s, recordings=1)[1] for s in (None, "all"))
    assert some == every == whole[1]
    with pytest.raises(UserError, match="has only 4 starts, not 50"):
        run(near_file, out, starts=50)
    assert Evaluate(policies=()).starts is None


def test_episodes_are_exported(whole, tmp_path):
    export(whole[0].parent, tmp_path / "episodes.parquet")
    table = parquet.read_table(tmp_path / "episodes.parquet").to_pydict()
    assert table["outcome"] == ["success"] * 4
    assert sorted(table["index"]) == [0, 1, 2, 3]
    assert set(table["mu"]) == {0.15}
    with pytest.raises(UserError, match="has no results of episodes"):
        export(tmp_path, tmp_path / "none.parquet")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"starts": "many"}, "--starts many is neither 'all' nor a positive number"),
        ({"starts": "0"}, "--starts 0 is neither"),
        ({"recordings": -1}, "recordings = -1 is invalid: expected int >= 0"),
    ],
)
def test_bad_options_are_refused(options, message):
    with pytest.raises(UserError, match=message):
        Evaluate(policies=(), **options)


def test_command_prints_json_last(command, whole, near_file):
    path, report = whole
    out = path.parent
    options = ("--starts", "all", "--out", out, "--recordings", 1, "--json")
    done = command("evaluate", near_file, *options)  # everything is there already
    assert done.returncode == 0, done.stderr
    assert "outcomes with 95 % intervals" in done.stdout
    assert msgspec.json.decode(done.stdout.splitlines()[-1], type=EvaluationReport) == report


def test_policy_of_another_scenario_is_refused(command, near_file, tmp_path):
    done = command("evaluate", near_file, "--scenario", "4", "--out", tmp_path / "out")
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert "was trained on scenario near" in done.stderr
    assert not (tmp_path / "out").exists()

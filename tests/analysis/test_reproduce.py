"""The reproduction in the very small: all stages, real; what it keeps, continues and refuses."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any, get_args

import pytest

from agent.experiments.variants import Name, variants_of
from analysis.figures.style import figure_entries
from analysis.profiles import FULL
from analysis.reading.results import RESULTS
from analysis.timings import Timings
from cosim.base.errors import UserError
from cosim.base.progress import silent
from minirobots import reproduction as stages
from minirobots.commands.paper import Reproduce
from minirobots.reproduction import command_of, compared, reproduce
from tests.fingerprint import changes, fingerprint, parts


@pytest.fixture
def out(reproduction):
    return reproduction


def test_every_result_figure_and_page_is_made_and_timed(out):
    results = out / "results"
    assert all(result.exists(results) for result in RESULTS.values())
    page = (out / "report" / "index.html").read_text(encoding="utf-8")
    assert "tiny" in page
    assert all(f'id="{figure}"' in page for figure in figure_entries())
    content = json.loads((results / "timings.json").read_text())
    assert set(content["stages"]) == {*RESULTS, "figures"}
    for stage in content["stages"].values():
        assert (stage["finished"], stage["attempts"]) == (True, 1)
        assert stage["seconds"] > 0.0
    assert content["profile"]["name"] == "tiny"


def test_report_is_written_again_from_existing_results(out, command):
    page, timings = out / "report" / "index.html", out / "results" / "timings.json"
    before, timed = page.read_text(encoding="utf-8"), timings.read_bytes()
    page.unlink()
    done = command("reproduce", "--out", out, "--report-only", "--json")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout.splitlines()[-1]) == {"page": str(page)}
    assert "not drawn" not in done.stderr
    # The figures' own time is known only after the first page was written.
    after = page.read_text(encoding="utf-8")
    assert [line for line in before.splitlines() if line not in after] == []
    assert timings.read_bytes() == timed


def test_finished_stages_are_kept_and_lost_ones_made_again(out, tiny, monkeypatch):
    results = out / "results"
    lost, kept = results / "motor_test.rrd", results / "episodes" / "2-moves" / "summary.json"
    policy = results / "experiments" / "fig08" / "1a" / "run_000" / "policy.npz"
    RESULTS["fig08"].proof_in(results).unlink()
    lost.unlink()
    before = kept.stat().st_mtime_ns, policy.stat().st_mtime_ns
    said: list[str] = []
    monkeypatch.setattr(stages, "draw_figures", lambda *_, **__: ({}, {}))
    monkeypatch.setattr(stages, "write_report", lambda *_: out)
    reproduce(out, tiny, seed=0, jobs=1, say=said.append)
    assert sum("finished before" in text for text in said) == len(RESULTS) - 2
    assert lost.is_file()
    assert RESULTS["fig08"].exists(results)
    # The experiment went on from its runs instead of training them again.
    assert (kept.stat().st_mtime_ns, policy.stat().st_mtime_ns) == before


def test_stages_of_another_version_are_made_again(out, tiny, monkeypatch):
    timings = Timings(out / "results", tiny, 0)
    assert timings.finished("platform")
    monkeypatch.setattr("analysis.timings.made_by", lambda: "another")
    assert not timings.finished("platform")


def test_a_seed_is_that_of_all_that_is_drawn(tmp_path):
    for result in RESULTS.values():
        if result.maker in ("run", "experiments"):
            options = command_of(result, tmp_path, FULL, 3, 1)
            assert getattr(options, "train_seed", 3) == 3
            assert getattr(options, "seed", None) == 3 or options.physics.seed == 3


def test_the_experiment_prints_json_and_keeps_its_runs(out, command):
    folder = RESULTS["fig08"].location(out / "results")
    before = json.loads((folder / "results.json").read_text())
    options = ("--runs", 2, "--episodes", 3000, "--greedy-points", 6, "--jobs", 1, "--json")
    printed = command("experiments", "fig08", "--out", folder, *options).stdout
    content = json.loads(printed.splitlines()[-1])
    assert content["variants"] == before["variants"]
    assert content["variants"]["1b"]["over_runs"]["success"]["runs"] == 2


def test_every_experiment_changes_one_thing_of_the_default():
    for name in get_args(Name):
        variants = variants_of(name)
        distinct = {(v.scenario, v.process, v.learning, v.method) for v in variants.values()}
        assert {v.reference for v in variants.values()} <= {None, *variants}
        assert len(distinct) == len(variants)


def test_other_profiles_and_seeds_are_refused(out, tiny):
    for profile, seed in ((replace(tiny, runs=3), 0), (tiny, 1)):
        with pytest.raises(UserError, match=r"profile tiny, seed 0, .* choose another --out"):
            reproduce(out, profile, seed=seed, jobs=1, say=print)
    refused: tuple[tuple[dict[str, Any], str], ...] = (
        ({"jobs": 0}, "--jobs must be at least 1"),
        ({"seed": -1}, "seed = -1 is invalid: expected int >= 0"),
        ({"report_only": True, "quick": True}, "no effect with --report-only"),
    )
    for options, error in refused:
        with pytest.raises(UserError, match=error):
            Reproduce(out=out, **options).run(silent)


def test_a_stage_is_made_again_if_it_was_interrupted_or_is_of_another_version(
    tmp_path, tiny, monkeypatch
):
    ticks = iter([10.0, 17.0, 100.0, 103.0])
    monkeypatch.setattr("analysis.timings.time.perf_counter", lambda: next(ticks))
    timings = Timings(tmp_path, tiny, seed=0)
    with pytest.raises(KeyboardInterrupt), timings.stage("fig08"):
        raise KeyboardInterrupt
    assert not timings.finished("fig08")
    again = Timings(tmp_path, tiny, seed=0)
    assert not again.finished("fig08")
    with again.stage("fig08"):
        pass
    assert again.finished("fig08")
    assert again.seconds("fig08") == 7.0 + 3.0
    content = json.loads((tmp_path / "timings.json").read_text())
    assert content["stages"]["fig08"]["attempts"] == 2
    monkeypatch.setattr("agent.training.learning.VERSION", 2)
    assert not Timings(tmp_path, tiny, seed=0).finished("fig08")


@pytest.mark.long
def test_amounts_are_those_of_the_page_and_seeds_those_of_everything_random():
    """Training, starts and noise: each command that draws gets the seed as each of its seeds."""
    for result in RESULTS.values():
        if result.maker == "study":
            options = compared(FULL, 7, 1)
            assert (options["trainings"], options["episodes"]) == (10, 10)
            assert len(options["scenario"]) == 5
        else:
            options = vars(command_of(result, Path("x"), FULL, 7, 1))
        if result.maker == "experiments":
            printed = 2_000_000 if result.name == "sequel" else 5_000_000
            assert (options["runs"], options["episodes"]) == (20, printed)
        options |= vars(options.pop("physics")) if result.maker == "run" else {}
        seeds = {name: value for name, value in options.items() if name.endswith("seed")}
        drawn = result.maker not in ("calibrate", "motor-test", "platform")
        assert set(seeds.values()) == {7} if drawn else not seeds, (result.name, seeds)


def test_outputs_are_those_of_the_golden_file(reproduction):
    page = dict(parts(reproduction / "report" / "index.html", "report"))
    assert not changes("reproduction", fingerprint(reproduction / "figures", "") | page)

"""The reproduction in the very small: all stages, real; what it keeps, continues and refuses."""

import json
from dataclasses import replace
from pathlib import Path

import pytest

from analysis.profiles import QUICK
from analysis.reading.results import FIGURES, RESULTS
from analysis.timings import Timings
from cosim.base.errors import UserError
from cosim.base.progress import silent
from minirobots import reproduction as stages
from minirobots.commands.paper import Reproduce
from minirobots.reproduction import command_of, reproduce


@pytest.fixture
def out(reproduction):
    return reproduction


def test_every_result_figure_and_page_is_made(out):
    results = out / "results"
    assert all(result.exists(results) for result in RESULTS.values())
    for figure in FIGURES:
        for ending in (".png", ".pdf", ".json"):
            assert (out / "figures" / f"{figure}{ending}").is_file()
    page = (out / "report" / "index.html").read_text(encoding="utf-8")
    assert "tiny" in page
    assert all(f'id="{figure}"' in page for figure in FIGURES)


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


def test_timings_are_of_every_stage(out):
    content = json.loads((out / "results" / "timings.json").read_text())
    assert set(content["stages"]) == {*RESULTS, "figures"}
    for stage in content["stages"].values():
        assert stage["finished"]
        assert stage["seconds"] > 0.0
        assert stage["attempts"] == 1
    assert content["profile"]["name"] == "tiny"


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


def test_other_profiles_and_seeds_are_refused(out, tiny):
    with pytest.raises(UserError, match="profile tiny, seed 0"):
        reproduce(out, replace(tiny, runs=3), seed=0, jobs=1, say=print)
    with pytest.raises(UserError, match="choose another --out"):
        reproduce(out, tiny, seed=1, jobs=1, say=print)
    with pytest.raises(UserError, match="--jobs must be at least 1"):
        Reproduce(out=out, jobs=0).run(silent)
    with pytest.raises(UserError, match="seed = -1 is invalid: expected int >= 0"):
        Reproduce(out=out, seed=-1)
    with pytest.raises(UserError, match="no effect with --report-only"):
        Reproduce(out=out, report_only=True, quick=True)


def test_stages_of_another_version_are_made_again(tmp_path, tiny, monkeypatch):
    timings = Timings(tmp_path, tiny, seed=0)
    with timings.stage("fig08"):
        pass
    assert timings.finished("fig08")
    monkeypatch.setattr("agent.training.learning.VERSION", 2)
    assert not Timings(tmp_path, tiny, seed=0).finished("fig08")


def test_interrupted_stage_is_not_finished_and_its_time_counts(tmp_path, tiny):
    timings = Timings(tmp_path, tiny, seed=0)
    with pytest.raises(KeyboardInterrupt), timings.stage("fig08"):
        raise KeyboardInterrupt
    assert not timings.finished("fig08")
    first_s = timings.seconds("fig08")

    again = Timings(tmp_path, tiny, seed=0)
    assert not again.finished("fig08")
    with again.stage("fig08"):
        pass
    assert again.finished("fig08")
    assert again.seconds("fig08") >= first_s
    content = json.loads((tmp_path / "timings.json").read_text())
    assert content["stages"]["fig08"]["attempts"] == 2


def test_the_seed_is_that_of_everything_random():
    """Training, starts and noise: each command that draws gets the seed as each of its seeds."""
    for result in RESULTS.values():
        options = vars(command_of(result, Path("x"), QUICK, 7, 1))
        options |= vars(options.pop("physics")) if result.maker == "run" else {}
        seeds = {name: value for name, value in options.items() if name.endswith("seed")}
        assert set(seeds.values()) <= {7}, (result.name, seeds)

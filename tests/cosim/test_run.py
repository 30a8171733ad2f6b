"""The main command as its users meet it: results, refusals, interrupts, repeatability."""

import contextlib
import functools
import json
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from agent.training.methods import method_config
from agent.training.policy import Policy
from cosim.base.storage import lock_folder
from cosim.model.scenario_file import find_scenario
from cosim.recording.reader import read_episode
from minirobots.commands.episodes import Run
from tests.alone import rrd

BRIEF = ("--method", "paper", "--train-episodes", "20000", "--time-limit", "4")


@pytest.fixture(scope="session")
def run(command):
    """The command in this process, which starts it once instead of every time."""
    return functools.partial(command, "run")


@pytest.fixture(scope="module")
def runs(run, tmp_path_factory):
    """Two runs of one seed, and one of another."""
    base = tmp_path_factory.mktemp("runs")
    for name, seed in (("a", 3), ("b", 3), ("c", 4)):
        done = run("--out", base / name, "--seed", seed, "--train-seed", seed, *BRIEF)
        assert done.returncode == 0, done.stderr
        assert "timeout" in done.stdout
        assert f"{base / name}" in done.stdout
    return base


def summary_of(folder: Path) -> dict:
    """The summary of a run, without what depends on the clock."""
    summary = json.loads((folder / "summary.json").read_text())
    for episode in summary["episodes"]:
        assert episode.pop("realtime_factor") > 0.0
    return summary


@pytest.mark.ci
def test_summary_says_what_was_run(runs):
    summary = summary_of(runs / "a")
    assert summary["schema_version"] == 1
    assert summary["scenario"] == "2"
    assert summary["seed"] == 3
    assert summary["parameters"]["dt_s"] == 1e-5
    assert summary["versions"]["rerun-sdk"].startswith("0.41")
    (episode,) = summary["episodes"]
    assert episode["outcome"] == "timeout"
    assert episode["sim_time_s"] == 4.0
    assert episode["path_length_cm"] > 0.1
    assert (runs / "a" / episode["recording"]).is_file()
    assert (runs / "a" / "policy.npz").is_file()


def test_equal_seeds_give_equal_results_and_recordings(runs):
    assert summary_of(runs / "a") == summary_of(runs / "b")
    assert summary_of(runs / "a")["episodes"] != summary_of(runs / "c")["episodes"]
    for name in ("episodes/ep_000.rrd", "training.rrd"):
        first, same, other = (runs / run / name for run in "abc")
        assert rrd("verify", first)
        assert rrd("compare", "--unordered", first, same)
        assert not rrd("compare", "--unordered", first, other)


def test_a_replay_is_the_recording_in_every_bit_or_names_what_differs(command, runs, motor_fmu):
    recording = runs / "a" / "episodes" / "ep_000.rrd"
    done = command("replay", recording, "--json")
    assert done.returncode == 0, done.stderr
    report = json.loads(done.stdout.splitlines()[-1])
    assert report["differences"] == []
    assert report["signals"] > 60
    assert report["values"] > 10_000
    done = command("replay", recording, "--policy", runs / "c" / "policy.npz", "--json")
    assert done.returncode == 1
    differences = json.loads(done.stdout.splitlines()[-1])["differences"]
    assert {"signal": "/rl/r1/q_s", "time_s": 0.0} in differences
    assert len(differences) < report["signals"]
    done = command("replay", recording, "--motor-fmu", motor_fmu)
    assert done.returncode == 2
    assert "is not the one that was recorded" in done.stderr


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ("--scenario 7", "unknown scenario '7'"),
        ("--motor-fmu nowhere.fmu", "nowhere.fmu does not exist"),
        (f"--motor-fmu {__file__}", "is broken"),
        ("--dt 3e-5", "not a whole multiple"),
        ("--mu -1", "mu = -1.0 is invalid: expected float >= 0"),
        ("--speed 9", "would make the robot hop; the largest possible is 4."),
        ("--episodes 0", "episodes = 0 is invalid: expected int >= 1"),
        ("--out /proc/none", "/proc/none"),
        ("--policy nowhere.npz", "nowhere.npz"),
        ("--no-record --record full", "--no-record contradicts --record full"),
        ("--no-record --signals 1", "--signals has no effect where nothing is recorded"),
        ("--no-record --live", "show what is recorded; choose another --record"),
        ("--viewer rerun+http://127.0.0.1:1/proxy", "--viewer has no effect without --live or"),
        ("--policy p.npz --method moves", "--method: nothing is trained with --policy"),
        ("--policy p.npz --train-seed 0", "--train-seed: nothing is trained with --policy"),
        ("--policy p.npz --train-episodes 5 --retrain", "--train-episodes and --again: nothing"),
    ],
)
def test_bad_input_gets_one_sentence(run, arguments, sentence, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    done = run(*arguments.split())
    assert done.returncode == 2
    assert done.stderr.startswith("error: ")
    assert done.stderr.count("\n") == 1
    assert sentence in done.stderr
    assert done.stdout == ""
    assert [*tmp_path.glob("runs/*")] == []


def test_a_policy_on_moves_is_of_the_observed_ones(run, tmp_path):
    short = ("--method", "moves", "--train-episodes", 20_000, "--time-limit", 4)
    done = run(*short, "--out", tmp_path, "--record", "none")
    assert done.returncode == 0, done.stderr
    expected = method_config("moves", find_scenario("2")).moves
    assert Policy.load(tmp_path / "policy.npz").config.moves == expected is not None
    assert summary_of(tmp_path)["method"] == "moves"


@pytest.mark.long
def test_motors_of_a_user_drive_a_policy_that_is_trained_on_the_grid(run, motor_fmu, tmp_path):
    motors = ("--motor-fmu", motor_fmu, "--motor-parameter", "J=2.7e-9")
    done = run("--scenario", "1a", *motors, "--out", tmp_path, "--no-record", *BRIEF)
    assert done.returncode == 0, done.stderr
    assert summary_of(tmp_path)["parameters"]["J"] == 2.7e-9


def test_policy_of_another_scenario_is_refused(run, runs, tmp_path):
    policy = runs / "a" / "policy.npz"
    done = run("--scenario", "4", "--policy", policy, "--out", tmp_path / "x")
    assert done.returncode == 2
    assert "was trained on scenario 2" in done.stderr
    again = run("--policy", policy, "--out", tmp_path / "y", "--time-limit", 4, "--no-record")
    assert again.returncode == 0, again.stderr
    assert not list((tmp_path / "y").rglob("*.rrd"))
    summary = summary_of(tmp_path / "y")
    assert (summary["method"], summary["train_seed"]) == ("paper", 3)


@pytest.mark.long
def test_threads_do_not_change_the_results(run, runs, tmp_path):
    policy = ("--policy", runs / "a" / "policy.npz", "--episodes", 2, "--time-limit", 4)
    for name, jobs in (("serial", 1), ("parallel", 2)):
        done = run("--out", tmp_path / name, "--jobs", jobs, *policy)
        assert done.returncode == 0, done.stderr
    assert summary_of(tmp_path / "serial") == summary_of(tmp_path / "parallel")
    for episode in ("ep_000.rrd", "ep_001.rrd"):
        files = [tmp_path / name / "episodes" / episode for name in ("serial", "parallel")]
        assert rrd("compare", "--unordered", *files)


def test_the_compiled_driver_records_the_signals_of_fmpy(run, runs, tmp_path):
    policy = ("--policy", runs / "a" / "policy.npz", "--seed", 3, "--time-limit", 4)
    done = run("--scenario", 2, "--driver", "compiled", "--out", tmp_path, *policy)
    assert done.returncode == 0, done.stderr
    ours, theirs = (read_episode(f / "episodes" / "ep_000.rrd") for f in (tmp_path, runs / "a"))
    assert (ours.facts["driver"], theirs.facts["driver"]) == ("compiled", "fmpy")
    assert ours.signals.keys() == theirs.signals.keys()
    for name, found in ours.signals.items():
        for mine, other in zip(found[:2], theirs.signals[name][:2], strict=True):
            assert mine.tobytes() == other.tobytes(), name


def test_recordings_of_other_runs_do_not_stay_next_to_a_summary(run, tmp_path):
    (tmp_path / "episodes").mkdir()
    for number in range(2):
        (tmp_path / "episodes" / f"ep_{number:03d}.rrd").touch()
    for arguments, first in ((("--episodes", 1), "ep_001.rrd"), (("--no-record",), "ep_000.rrd")):
        done = run("--out", tmp_path, *arguments)
        assert done.returncode == 2
        assert f"{first} is of a run of other episodes" in done.stderr
    assert len([*tmp_path.rglob("*")]) == 3


@pytest.mark.long
def test_results_of_another_run_are_not_replaced(run, runs, tmp_path):
    shutil.copytree(runs / "a", tmp_path / "a")
    same = ("--out", tmp_path / "a", "--seed", 3, "--train-seed", 3, *BRIEF)
    done = run(*same, "--episodes", 2)
    assert done.returncode == 0, done.stderr
    summary = summary_of(tmp_path / "a")
    assert len(summary["episodes"]) == 2
    assert summary["episodes"][:1] == summary_of(runs / "a")["episodes"]
    for other, words in (
        (("--seed", 4), "is of a run with seed = 3; choose another --out, or remove it"),
        (("--train-seed", 4), "is of a run with train_seed = 3, another policy"),
        (("--mu", 0.2), "is of a run with mu = 0.15"),
    ):
        done = run(*same, "--episodes", 2, *other)
        assert (done.returncode, words in done.stderr) == (2, True), done.stderr
    assert summary_of(tmp_path / "a") == summary
    (tmp_path / "a" / "summary.json").write_text("{}")
    assert "not a summary of a run or damaged" in run(*same, "--episodes", 2).stderr


@pytest.mark.parametrize("name", ["run", "train", "experiments", "reproduce"])
def test_a_folder_in_use_is_refused(command, tmp_path, name):
    arguments = ("fig08", "--runs", 1) if name == "experiments" else ()
    with lock_folder(tmp_path / "out"):
        done = command(name, *arguments, "--out", tmp_path / "out")
    said = f"error: {tmp_path / 'out'}: another run writes to it; wait until that ends, or choose"
    assert (done.returncode, done.stderr.count("\n")) == (2, 1), done.stderr
    assert done.stderr.startswith(said)
    assert [*(tmp_path / "out").iterdir()] == []


def test_runs_of_the_same_second_have_folders_of_their_own(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with contextlib.ExitStack() as stack:
        runs = [stack.enter_context(Run(scenario="2").alone()).out or Path() for _ in range(3)]
        assert len(set(runs)) == 3
        (runs[0] / "summary.json").touch()
    assert [run.exists() for run in runs] == [True, False, False]


@pytest.mark.long
def test_interrupt_keeps_the_recording(tmp_path, runs):
    out = tmp_path / "interrupted"
    line = [sys.executable, "-m", "cosim.run", "--out", out, "--policy", runs / "a" / "policy.npz"]
    with subprocess.Popen(line, stderr=subprocess.PIPE, text=True) as running:
        part = out / "episodes" / "ep_000.rrd.part"
        while not (part.is_file() and part.stat().st_size > 300_000):
            assert running.poll() is None
            time.sleep(0.02)
        running.send_signal(signal.SIGINT)
        _, stderr = running.communicate()
    assert running.returncode == 130
    assert "Traceback" not in stderr
    assert rrd("verify", out / "episodes" / "ep_000.rrd")


@pytest.mark.slow
def test_the_best_policy_succeeds_in_scenario_4_for_seeds_0_to_19(run, tmp_path):
    for seed in range(20):
        out = tmp_path / str(seed)
        done = run("--scenario", "4", "--seed", seed, "--out", out, "--record", "none")
        assert done.returncode == 0, done.stderr
        (episode,) = summary_of(out)["episodes"]
        assert episode["outcome"] == "success", seed

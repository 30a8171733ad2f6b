"""The training and evaluation commands: folders, going on after a kill, messages."""

import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace

import msgspec
import numpy as np
import pytest

import agent
from agent.training.loop import TrainingLog
from agent.training.methods import METHODS
from agent.training.policy import Policy
from agent.training.settings import LearningConfig
from cosim.base.errors import UserError
from cosim.model.scenario_file import find_scenario
from minirobots.commands.policies import Train
from minirobots.runner import parse

SHORT = ("--learning.episodes", "4000", "--learning.epsilon-episodes", "10")


def spawn(out, *arguments):
    return subprocess.Popen(
        [sys.executable, "-m", "minirobots", "train", *arguments, "--jobs", "1", "--out", out],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def same_files(a, b):
    for name in ("policy.npz", "training.npz"):
        with np.load(a / name) as left, np.load(b / name) as right:
            assert left.keys() == right.keys()
            for key, array in left.items():
                np.testing.assert_array_equal(array, right[key], f"{name} {key}")


@pytest.mark.ci
def test_train_then_evaluate(command, tmp_path):
    out = tmp_path / "out"
    options = ("--scenario", "2", "--runs", 2, "--out", out, "--jobs", 1, *SHORT)
    status, output, _ = command("train", *options, "--json")
    assert status == 0
    summary = json.loads(output.splitlines()[-1])
    assert summary == json.loads((out / "summary.json").read_text())
    assert {p.name for p in (out / "run_001").iterdir()} == {
        "policy.npz", "policy.json", "training.npz", "training.rrd",
    }  # fmt: skip
    assert TrainingLog.load(out / "run_001" / "training.npz").episode[-1] == 4000
    status, output, _ = command("evaluate", "--grid", out, "--json")
    assert status == 0
    report = json.loads(output.splitlines()[-1])
    for ours, theirs in zip(report["rows"], summary["rows"], strict=True):
        assert ours | {"policy": ""} == theirs | {"policy": ""}
        rates = [ours[k] for k in ("success", "collision", "out_of_board", "timeout")]
        assert sum(rates) == pytest.approx(1.0)
        assert ours["failing_starts"] == round((1 - ours["success"]) * 900)
        assert len(ours["failures"]) == ours["failing_starts"]
    status, _, errors = command("evaluate", "--grid", out, "--starts", 3, "--mu", 0.2)
    assert (status, errors.count("\n")) == (2, 1)
    assert "--mu" in errors and "--starts" in errors and "no effect with --grid" in errors
    means = [p["success"] for p in report["rows"]]
    assert report["over_policies"]["2"]["success"]["mean"] == pytest.approx(np.mean(means))
    status, _, errors = command("train", *options, "--seed", 1)
    assert status == 2
    assert "another configuration" in errors
    before = (out / "run_000" / "policy.npz").stat().st_mtime_ns
    assert command("train", *options)[0] == 0
    assert (out / "run_000" / "policy.npz").stat().st_mtime_ns == before


@pytest.mark.long
def test_runs_of_another_version_are_not_replaced(command, tmp_path):
    options = ("--scenario", "1a", "--out", tmp_path, "--jobs", 1, *SHORT)
    assert command("train", *options)[0] == 0
    path = tmp_path / "run_000" / "policy.npz"
    policy = Policy.load(path)
    config = msgspec.structs.replace(policy.config, kernel_version="older")
    replace(policy, config=config).save(path)
    before = path.read_bytes()
    status, _, errors = command("train", *options)
    assert (status, errors.count("\n")) == (2, 1)
    assert "was trained by another version" in errors
    assert path.read_bytes() == before


@pytest.mark.long
def test_a_killed_command_goes_on_bit_identically(command, tmp_path):
    options = ("--scenario", "1a", "--runs", "3", "--learning.episodes", "300000")
    whole, killed = tmp_path / "whole", tmp_path / "killed"
    assert command("train", *options, "--jobs", 1, "--out", whole)[0] == 0
    process = spawn(killed, *options)
    try:
        while not (killed / "run_000" / "policy.npz").exists():
            assert process.poll() is None, "it ended before it could be killed"
            time.sleep(0.001)
        os.kill(process.pid, signal.SIGKILL)
    finally:
        process.communicate()
    assert not (killed / "summary.json").exists()
    assert command("train", *options, "--jobs", 1, "--out", killed)[0] == 0
    for run in ("run_000", "run_001", "run_002"):
        same_files(whole / run, killed / run)


@pytest.mark.long
def test_interrupt_ends_with_status_130_and_leaves_a_folder_to_go_on_with(tmp_path):
    process = spawn(tmp_path, "--scenario", "4")
    while not (tmp_path / "run_000").exists():
        time.sleep(0.01)
    time.sleep(0.5)
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=300)
    # CPython ends itself by the signal if it came within an exec(); a shell sees 130 for both
    assert process.returncode in {130, -signal.SIGINT}
    assert "Traceback" not in errors
    assert (tmp_path / "experiment.json").exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--scenario", "9"), "unknown scenario"),
        (("--learning.eta", "3"), "eta = 3.0"),
        (("--runs", "0"), "runs = 0 is invalid: expected int >= 1"),
        (("--config", "none.toml"), "no such settings file"),
    ],
)
def test_wrong_options_end_with_one_sentence(command, arguments, message, tmp_path):
    status, _, errors = command("train", "--out", tmp_path / "o", *arguments)
    assert status == 2
    assert message in errors
    assert errors.count("\n") == 1


def test_options_override_the_settings_file(tmp_path):
    path = tmp_path / "s.toml"
    path.write_text("[learning]\neta = 0.5\ngamma = 0.5\n[process]\nstep_limit = 7\n")
    arguments = ["--config", str(path), "--learning.gamma", "0.25"]
    options = parse(Train, "", arguments, Train.defaults(arguments)).options
    assert (options.learning.eta, options.learning.gamma) == (0.5, 0.25)
    assert options.process.step_limit == 7


def test_python_takes_the_settings_of_the_command():
    board, options = find_scenario("1a"), {"step_cost": 3, "features": ["y", "x"], "eta": 0.25}
    process, learning = METHODS["paper"].with_settings(board, options)
    assert (process.step_cost, process.features, learning.eta) == (3.0, ("y", "x"), 0.25)
    assert learning.gamma == LearningConfig.gamma
    with pytest.raises(UserError, match=r"setting gama is unknown.*did you mean gamma"):
        agent.train(board, method="paper", gama=0.5)
    with pytest.raises(UserError, match="gamma has no effect on method shortest"):
        agent.train(board, method="shortest", gamma=0.5)


def test_evaluate_refuses_what_is_no_policy(command, tmp_path):
    (tmp_path / "policy.npz").write_bytes(b"x")
    for path, message in [(tmp_path / "policy.npz", "damaged"), (tmp_path, "no run_")]:
        status, _, errors = command("evaluate", "--grid", path)
        assert status == 2
        assert message in errors

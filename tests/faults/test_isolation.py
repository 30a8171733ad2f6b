"""What a foreign FMU does to its process ends a command in one line, and nothing is lost."""

import gc
import json
import os
import signal
import subprocess
import sys
import time
import zipfile
from pathlib import Path

import numpy as np
import pytest

from cosim.coupling.master import NotFiniteError
from cosim.fmi.isolation import Isolation, same_folder
from cosim.model.config import CoSimConfig
from cosim.model.params import TIMING
from cosim.model.scenario import Scenario
from cosim.simulation.cosimulation import CoSimulation
from cosim.simulation.options import SimulationOptions
from fmus.compiler import FLAGS, compiler_command, fmi_headers, host_target
from minirobots.commands.run import Run
from minirobots.runner import _fixed

SCENARIO = """
columns = 8
rows = 8
[[robots]]
target = [1, 6]
starts = [[6, 1]]
"""


@pytest.fixture(scope="module")
def faulty_fmu(motor_fmu, tmp_path_factory) -> Path:
    """Does what the environment variable FAULT says, from FAULT_FROM s of simulated time on."""
    folder = tmp_path_factory.mktemp("faulty")
    with zipfile.ZipFile(motor_fmu) as archive:
        archive.extractall(folder)
    (library,) = (folder / "binaries" / host_target()).iterdir()
    (unit,) = (folder / "sources").glob("*_fmi3.c")
    subprocess.run(
        [*compiler_command(), *FLAGS, f"-I{fmi_headers()}", f"-I{unit.parent}",
         f'-DSOUND="{unit.name}"', Path(__file__).with_name("fault.c"), "-o", library],
        env=os.environ | {"ZIG_LOCAL_CACHE_DIR": str(folder / "zig")},
        check=True,
    )  # fmt: skip
    path = folder / "Faulty.fmu"
    with zipfile.ZipFile(motor_fmu) as archive, zipfile.ZipFile(path, "w") as copy:
        for name in archive.namelist():
            copy.write(folder / name, name)
    return path


@pytest.fixture(scope="module")
def begin(faulty_fmu, tmp_path_factory):
    """Runs the main command with the faulty FMU."""
    folder = tmp_path_factory.mktemp("drive")
    (folder / "one.toml").write_text(SCENARIO)
    number = 0

    def run(fault, *options, time_limit=4, fault_from=2.5, start=subprocess.run, **keywords):
        nonlocal number
        number += 1
        out = folder / f"run{number}"
        command = [sys.executable, "-m", "cosim.run", "--scenario", folder / "one.toml"]
        command += ["--method", "paper", "--train-episodes", "2000", "--out", out]
        command += ["--motor-fmu", faulty_fmu, "--time-limit", time_limit, *options]
        words = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
        environment = os.environ | {"FAULT": fault, "FAULT_FROM": str(fault_from)}
        return out, start(list(map(str, command)), env=environment, **words | keywords)

    return run


@pytest.fixture(scope="module")
def drive(begin):
    """The same with an FMU that was calibrated while it was sound."""
    _, sound = begin("none", check=False)
    assert sound.returncode == 0, sound.stderr
    return begin


FAULTS = {
    "late": "at 2.50000 s failed (fmi3Status 3)",
    "later": "at 2.50000 s failed (fmi3Status 4)",
    "round": "an FMU changed the rounding",
    "crash": r"crashed (SIGSEGV) in the RL step from 2 s of simulated time",
    "exit": r"ended the process with status 0 in the RL step from 2 s of simulated time",
    "error": "2.5",
    "nan": "omega of motor D of robot 1 is nan at 2.5",
    "inf": "omega of motor D of robot 1 is inf at 2.5",
    "discard": "fmi3Status 2",
    "fatal": "fmi3Status 4",
    "free": r"crashed (SIG",
    "flood": "fmi3Status 3",
}


@pytest.mark.faults
@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_is_named_with_the_time(fault, drive):
    out, ended = drive(fault, check=False)
    assert ended.returncode == 2
    (sentence,) = [line for line in ended.stderr.splitlines() if line.startswith("error: ")]
    assert FAULTS[fault] in sentence
    assert "Faulty.fmu" in sentence or "robot 1" in sentence or fault == "round"
    assert "Traceback" not in ended.stderr
    if "RL step" in FAULTS[fault]:  # nobody was left to complete the recording
        assert not list((out / "episodes").glob("*.rrd"))


@pytest.mark.long
def test_a_crash_in_a_calibration_is_named(begin):
    # with a friction of its own: other tests calibrate this FMU, too
    out, ended = begin("crash", "--mu", 0.17, fault_from=0.005, check=False)
    assert ended.returncode == 2
    assert "FMU Faulty.fmu crashed (SIGSEGV) in what begins at 0 s of a trial" in ended.stderr
    assert not list(out.rglob("*.rrd"))


@pytest.mark.long
def test_a_crash_in_a_motor_test_is_named(faulty_fmu, tmp_path):
    command = [sys.executable, "-m", "analysis.motor_test", "--motor-fmu", faulty_fmu]
    command += ["--out", tmp_path / "test.rrd"]
    environment = os.environ | {"FAULT": "crash", "FAULT_FROM": "0.005"}
    ended = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert ended.returncode == 2
    words = "FMU Faulty.fmu crashed (SIGSEGV) in what begins at 0.005 s of the open loop test"
    assert words in ended.stderr
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("fault", ["nan", "inf"])
def test_the_first_signal_that_is_no_number_is_named(fault, faulty_fmu, monkeypatch):
    monkeypatch.setenv("FAULT", fault)
    monkeypatch.setenv("FAULT_FROM", "0.005")
    scenario = Scenario("one", "", ((5, 5),), (((15, 15),),))
    config = CoSimConfig(timing=TIMING._replace(rl_step_s=0.01))
    system = CoSimulation(scenario, faulty_fmu, config)
    system.reset(((15, 15),), np.random.SeedSequence(0))
    words = rf"omega of motor D of robot 1 is {fault} at 0\.00501 s of simulated time"
    with pytest.raises(NotFiniteError, match=words):
        system.advance(np.array([0]))


@pytest.mark.faults
def test_what_never_returns_is_ended(drive):
    _, ended = drive("hang", "--isolate-limit", "2", check=False)
    assert ended.returncode == 2
    assert "did not return from the RL step from 2 s of simulated time within 2 s" in ended.stderr


@pytest.mark.faults
@pytest.mark.parametrize("fault", ["end", "unload"])
def test_results_of_episodes_are_complete_before_instances_are_freed(drive, fault):
    out, ended = drive(fault, fault_from=0.0, check=False)
    assert ended.returncode == 0, ended.stderr
    (episode,) = json.loads((out / "summary.json").read_text())["episodes"]
    assert (out / episode["recording"]).is_file()


def test_paths_are_absolute_where_foreign_code_runs(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    options = Run(physics=SimulationOptions(motor_fmu=Path("motor.fmu")))
    fixed = _fixed(options)
    assert fixed.folder == options.folder.absolute() == fixed.out
    assert fixed.physics.motor_fmu == tmp_path / "motor.fmu"


def test_a_call_without_an_end_does_not_hold_the_folder(monkeypatch, tmp_path):
    """An interrupt between a call and what it encloses leaves one, kept by the traceback."""
    interrupted = same_folder()
    interrupted.__enter__()
    monkeypatch.chdir(tmp_path)
    with same_folder():
        pass
    assert Path.cwd() == tmp_path
    del interrupted
    gc.collect()
    assert Path.cwd() == tmp_path


@pytest.mark.faults
def test_earlier_episodes_are_whole(drive, monkeypatch):
    monkeypatch.setenv("FAULT_AFTER", "3")  # one read for its parameters, two of the first episode
    options = ("--episodes", "2", "--jobs", "1", "--driver", "reference")
    out, ended = drive("crash", *options, time_limit=2, fault_from=1.5, check=False)
    assert ended.returncode == 2
    assert "crashed (SIGSEGV) in the RL step from 0 s" in ended.stderr
    (episode,) = json.loads((out / "summary.json").read_text())["episodes"]
    assert [path.name for path in (out / "episodes").glob("*.rrd")] == ["ep_000.rrd"]
    assert episode["recording"] == "episodes/ep_000.rrd"


@pytest.mark.parametrize(("sent", "status"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
@pytest.mark.faults
def test_an_interrupt_reaches_the_child(sent, status, drive):
    out, process = drive("none", time_limit=600, start=subprocess.Popen)
    while not list((out / "episodes").glob("*.part")):
        assert process.poll() is None
        time.sleep(0.05)
    process.send_signal(sent)
    _, errors = process.communicate()
    assert process.returncode == status, errors
    assert "Traceback" not in errors
    assert list((out / "episodes").glob("*.rrd"))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"isolate": True, "no_isolate": True}, "contradicts"),
        ({"isolate_limit": 1.0}, "no effect without --isolate"),
        ({"no_isolate": True}, "no effect without --motor-fmu"),
        ({"isolate_limit": -1.0}, "must be positive"),
    ],
)
def test_what_has_no_effect_is_refused(options, message):
    from cosim.model.config import ConfigError

    with pytest.raises(ConfigError, match=message):
        Isolation(**options).enter("cosim.run", None)

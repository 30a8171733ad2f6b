"""What a faulty FMU does ends a command in one line: errors in its process, crashes in a child."""

import json
import os
import re
import signal
import subprocess
import sys
import time
import zipfile
from pathlib import Path

import numpy as np
import pytest

from cosim.coupling.master import NotFiniteError
from cosim.model.config import CoSimConfig
from cosim.model.params import TIMING
from cosim.model.scenario import Scenario
from fmus.compiler import FLAGS, compiler_command, fmi_headers, host_target
from tests.alone import CoSimulation

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
        command = [sys.executable, "-m", "minirobots", "run", "--scenario", folder / "one.toml"]
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


@pytest.fixture
def motor_test(faulty_fmu, tmp_path):
    """Tests the faulty FMU in a process of its own."""

    def run(fault, start, **keywords):
        command = [sys.executable, "-m", "minirobots", "motor-test", "--motor-fmu", faulty_fmu]
        command += ["--isolate", "--out", tmp_path / "test.rrd"]
        environment = os.environ | {"FAULT": fault, "FAULT_FROM": "0.005"}
        return start(command, env=environment, stderr=subprocess.PIPE, text=True, **keywords)

    return run


FAULTS = {
    "error": "at 2.50000 s failed (fmi3Status 3)",
    "nan": "omega of motor D of robot 1 is nan at 2.5",
    "inf": "omega of motor D of robot 1 is inf at 2.5",
    "discard": "fmi3Status 2",
    "fatal": "at 2.50000 s failed (fmi3Status 4)",
    "flood": "fmi3Status 3",
}


@pytest.mark.faults
@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_is_named_with_the_time(fault, drive):
    _, ended = drive(fault, check=False)
    assert ended.returncode == 2
    (sentence,) = [line for line in ended.stderr.splitlines() if line.startswith("error: ")]
    assert FAULTS[fault] in sentence
    assert "Faulty.fmu" in sentence or "robot 1" in sentence
    assert "Traceback" not in ended.stderr


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
        system.step(np.array([0]))


@pytest.mark.long
def test_a_crash_is_named(motor_test, tmp_path):
    ended = motor_test("crash", subprocess.run, check=False)
    assert ended.returncode == 2
    assert re.search(r"error: motor FMU .*Faulty\.fmu crashed \(SIGSEGV\), .*\n$", ended.stderr)
    assert not list(tmp_path.iterdir())


@pytest.mark.faults
def test_interrupts_end_what_never_returns(motor_test):
    process = motor_test("hang", subprocess.Popen)
    while process.poll() is None:
        time.sleep(0.5)
        process.send_signal(signal.SIGINT)
    assert process.returncode in {130, -signal.SIGINT}  # the latter while modules are imported


@pytest.mark.faults
def test_earlier_episodes_are_whole(drive, monkeypatch):
    monkeypatch.setenv("FAULT_AFTER", "3")  # one read for its parameters, two of the first episode
    options = ("--isolate", "--episodes", "2", "--jobs", "1", "--driver", "reference")
    out, ended = drive("crash", *options, time_limit=2, fault_from=1.5, check=False)
    assert ended.returncode == 2
    assert "Faulty.fmu crashed (SIGSEGV)" in ended.stderr
    (episode,) = json.loads((out / "summary.json").read_text())["episodes"]
    assert [path.name for path in (out / "episodes").glob("*.rrd")] == ["ep_000.rrd"]
    assert episode["recording"] == "episodes/ep_000.rrd"


@pytest.mark.parametrize(("sent", "status"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
@pytest.mark.faults
def test_an_interrupt_reaches_the_child(sent, status, drive):
    out, process = drive("none", "--isolate", time_limit=600, start=subprocess.Popen)
    while not list((out / "episodes").glob("*.part")):
        assert process.poll() is None
        time.sleep(0.05)
    process.send_signal(sent)
    _, errors = process.communicate()
    assert process.returncode == status, errors
    assert "Traceback" not in errors
    assert list((out / "episodes").glob("*.rrd"))

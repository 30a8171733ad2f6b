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
from tests.alone import CoSimulation, lives

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


def start(fault: str, from_s: float, *arguments: object) -> subprocess.Popen[str]:
    """Start a command whose FMU has a fault from a simulated time on."""
    return subprocess.Popen(
        [sys.executable, "-m", "minirobots", *map(str, arguments)],
        env=os.environ | {"FAULT": fault, "FAULT_FROM": str(from_s)},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )


@pytest.fixture(scope="module")
def drive(faulty_fmu, tmp_path_factory):
    """Starts the main command with the faulty FMU, which was calibrated while it was sound."""
    folder = tmp_path_factory.mktemp("drive")
    (folder / "one.toml").write_text(SCENARIO)

    def run(fault, *options, time_limit=4, from_s=2.5):
        out = folder / str(len(list(folder.iterdir())))
        line = ["run", "--scenario", folder / "one.toml", "--out", out, "--motor-fmu", faulty_fmu]
        line += ["--method", "paper", "--train-episodes", 2000, "--time-limit", time_limit]
        return out, start(fault, from_s, *line, *options)

    status, errors = ended(run("none")[1])
    assert status == 0, errors
    return run


@pytest.fixture
def motor_test(faulty_fmu, tmp_path):
    """Starts a test of the faulty FMU in a process of its own."""
    line = ("motor-test", "--motor-fmu", faulty_fmu, "--isolate", "--out", tmp_path / "test.rrd")
    return lambda fault: start(fault, 0.005, *line)


def ended(process: subprocess.Popen[str]) -> tuple[int, str]:
    """Status of a command, and what it said on stderr."""
    errors = process.communicate()[1]
    return process.returncode, errors


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
    status, errors = ended(drive(fault)[1])
    assert status == 2
    (sentence,) = [line for line in errors.splitlines() if line.startswith("error: ")]
    assert FAULTS[fault] in sentence
    assert "Faulty.fmu" in sentence or "robot 1" in sentence
    assert "Traceback" not in errors


@pytest.mark.long
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
    status, errors = ended(motor_test("crash"))
    assert status == 2
    assert re.search(r"error: motor FMU .*Faulty\.fmu crashed \(SIGSEGV\), .*\n$", errors)
    assert not list(tmp_path.iterdir())


@pytest.mark.faults
def test_interrupts_end_what_never_returns(motor_test):
    process = motor_test("hang")
    while process.poll() is None:
        time.sleep(0.5)
        process.send_signal(signal.SIGINT)
    assert process.returncode in {130, -signal.SIGINT}  # the latter while modules are imported


@pytest.mark.faults
def test_earlier_episodes_are_whole(drive, monkeypatch):
    monkeypatch.setenv("FAULT_AFTER", "3")  # one read for its parameters, two of the first episode
    options = ("--isolate", "--episodes", "2", "--jobs", "1", "--driver", "reference")
    out, process = drive("crash", *options, time_limit=2, from_s=1.5)
    status, errors = ended(process)
    assert status == 2
    assert "Faulty.fmu crashed (SIGSEGV)" in errors
    (episode,) = json.loads((out / "summary.json").read_text())["episodes"]
    assert [path.name for path in (out / "episodes").glob("*.rrd")] == ["ep_000.rrd"]
    assert episode["recording"] == "episodes/ep_000.rrd"


@pytest.mark.faults
def test_the_child_ends_with_a_command_that_is_killed(drive):
    out, process = drive("none", "--isolate", time_limit=600)
    while not list((out / "episodes").glob("*.part")):
        assert process.poll() is None
        time.sleep(0.05)
    (child,) = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()
    process.kill()
    process.communicate()
    end_s = time.monotonic() + 60.0
    while lives(int(child)):
        assert time.monotonic() < end_s
        time.sleep(0.1)


@pytest.mark.parametrize(("sent", "status"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
@pytest.mark.faults
def test_an_interrupt_reaches_the_child(sent, status, drive):
    out, process = drive("none", "--isolate", time_limit=600)
    while not list((out / "episodes").glob("*.part")):
        assert process.poll() is None
        time.sleep(0.05)
    process.send_signal(sent)
    found, errors = ended(process)
    assert found == status, errors
    assert "Traceback" not in errors
    assert list((out / "episodes").glob("*.rrd"))

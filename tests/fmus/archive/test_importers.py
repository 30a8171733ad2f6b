"""The FMUs before judges not written here, compared with our own loop."""

import json
import stat
import sys
from importlib.metadata import version
from pathlib import Path

import numpy as np
import pytest

from cosim.base.errors import UserError
from cosim.base.jit import kernel
from cosim.coupling.calls import do_step
from cosim.coupling.fmu import MotorFmu
from cosim.fmi.abi import exchange_3
from fmus.build import build_fmus, cached_fmu
from fmus.compiler import host_target
from fmus.models import Fmi
from tests.judge import __main__ as judge
from tests.judge.building import build_fmucheck, build_fmusim, version_in
from tests.judge.experiment import INPUTS, OUTPUTS, STEP_S, STEPS, reference_rows
from tests.judge.tools import (
    Artefact,
    Tool,
    ask,
    package_version,
    simulate_by_fmpy,
    simulate_by_fmucheck,
    simulate_by_fmusim,
    simulate_in_process,
    validate_by_vdmcheck,
)

TOOLS = {
    "fmpy": Tool("fmpy", package_version("fmpy"), simulate_by_fmpy),
    "ecospy": Tool("ecospy", package_version("ecospy"), simulate_in_process("ecospy")),
    "libcosimpy": Tool(
        "libcosimpy", package_version("libcosimpy"), simulate_in_process("libcosimpy"), ("2",)
    ),
}


@pytest.fixture(scope="module")
def artefacts(tmp_path_factory) -> dict[str, Artefact]:
    """The FMU of one motor by its standard."""
    folder = tmp_path_factory.mktemp("fmus")
    paths: dict[Fmi, Path] = {"2": folder / "fmi2.fmu", "3": folder / "fmi3.fmu"}
    build_fmus(paths, [host_target()])
    return {fmi: Artefact("VibrationMotor", fmi, path) for fmi, path in paths.items()}


@kernel
def step_through(instance, step_function, get_function, references, rows, step_s):
    status = 0
    for k in range(rows.shape[0]):
        status = max(status, do_step(step_function, instance, k * step_s, step_s))
        value = rows.ctypes.data + 8 * k * rows.shape[1]
        where, count = references.ctypes.data, rows.shape[1]
        status = max(status, exchange_3(get_function, (instance, where, count, value, count)))
    return status


def test_references_are_what_the_co_simulation_gets():
    motor = MotorFmu(cached_fmu("VibrationMotor")).instantiate("motor", INPUTS)
    rows, functions = np.empty((STEPS, 5)), motor.addresses
    numbers = np.concatenate([motor.fmu.outputs, motor.fmu.electrical]).astype(np.uint32)
    step, get = functions.do_step, functions.get_float64
    assert step_through(motor.instance, step, get, numbers, rows, STEP_S) == 0
    motor.close()
    assert rows[-1, 1] > 650.0
    assert (rows == reference_rows()).all()
    assert (np.ptp(rows, axis=0) > 0.0).all()  # everything moves


@pytest.mark.long
@pytest.mark.parametrize("fmi", ["2", "3"])
@pytest.mark.parametrize("tool", TOOLS.values(), ids=TOOLS)
def test_importers_agree(artefacts, tool, fmi):
    artefact = artefacts[fmi]
    if tool.takes(artefact):
        verdict = ask(tool, artefact)
        assert verdict.agrees, verdict.says
        assert verdict.version == version(tool.name)
    else:
        assert (tool.name, fmi) == ("libcosimpy", "3")  # which it does not know


def program(path: Path, text: str) -> Path:
    path.write_text(f"#!{sys.executable}\n{text}")
    path.chmod(path.stat().st_mode | stat.S_IEXEC)
    return path


@pytest.mark.parametrize("wanted", [simulate_by_fmusim, simulate_by_fmucheck])
def test_programs_are_held_against_the_references(artefacts, wanted, tmp_path):
    """A program that writes the references, one that is wrong, and one that fails."""
    reference = tmp_path / "reference.csv"
    rows = [
        ["time", *OUTPUTS],
        [0.0] * (1 + len(OUTPUTS)),
        *([0.0, *row] for row in reference_rows()),
    ]
    reference.write_text("".join(",".join(map(str, row)) + "\n" for row in rows))
    write = f"""
import sys
out = sys.argv[sys.argv.index("--output-file" if "--output-file" in sys.argv else "-o") + 1]
text = open({str(reference)!r}).read()
open(out, "w").write(text CHANGE)
"""
    motor = artefacts["2"]
    verdicts = [
        ask(Tool("program", lambda: "1", wanted(program(tmp_path / "tool", text))), motor)
        for text in (
            write.replace("CHANGE", ""),
            write.replace("CHANGE", '.replace("omega,omega_dot", "omega_dot,omega")'),
            "print('no such thing'); raise SystemExit(3)",
        )
    ]
    assert [(v.agrees, v.deviation == 0.0) for v in verdicts] == [
        (True, True),
        (False, False),
        (False, False),
    ]
    assert "no such thing" in verdicts[2].says


def test_what_a_validator_says_is_told(artefacts, monkeypatch, tmp_path):
    motor = artefacts["3"]
    monkeypatch.setenv("PATH", str(tmp_path))
    for said, agrees in (("No errors found.", True), ("Rule 2.4.7 is broken", False)):
        program(tmp_path / "java", f"print({said!r})")
        verdict = ask(Tool("VDMCheck", lambda: "1", validate_by_vdmcheck(Path("v.jar"))), motor)
        assert verdict.agrees is agrees
        assert agrees or said in verdict.says


def test_command_writes_the_table_of_a_page(command, artefacts, monkeypatch, tmp_path):
    motor = artefacts["2"]
    monkeypatch.setattr(judge, "artefacts", lambda _folder: [motor])
    page = tmp_path / "page.md"
    page.write_text(f"before\n{judge._BEGIN}old\n{judge._END}after\n")
    run = command(judge, "--out", tmp_path / "out", "--page", page, "--json")
    assert run.returncode == 0, run.stderr
    verdicts = json.loads(run.stdout.splitlines()[-1])["verdicts"]
    told = {v["tool"]: v["agrees"] for v in verdicts}
    assert told == {
        "fmpy, validator": True,
        "fmpy": True,
        "ecospy": True,
        "libcosimpy": True,
        "fmusim": None,
        "FMU Compliance Checker": None,
    }
    text = page.read_text()
    assert text.startswith("before\n")
    assert text.endswith("after\n")
    assert "old" not in text
    assert text.count("not at hand: name it with --fm") == 2
    assert json.loads((tmp_path / "out" / "verdicts.json").read_text())["verdicts"] == verdicts
    page.write_text("no place")
    refused = command(judge, "--out", tmp_path / "out", "--page", page)
    assert (refused.returncode, len(refused.stderr.splitlines())) == (2, 1)


def test_sources_that_are_none_are_refused(monkeypatch, tmp_path):
    with pytest.raises(UserError, match="no fmusim"):
        build_fmusim(tmp_path, tmp_path / "out")
    monkeypatch.setattr("os.defpath", str(tmp_path))
    with pytest.raises(UserError, match="cmake"):
        build_fmucheck(tmp_path, tmp_path / "out")
    assert version_in(Path("Reference-FMUs-0.0.39")) == "0.0.39"


def test_a_missing_package_is_said(artefacts):
    tool = Tool("nothing", package_version("no-such-package"), simulate_by_fmpy)
    verdict = ask(tool, artefacts["3"])
    assert (verdict.agrees, verdict.says) == (None, "not at hand: install no-such-package")

"""The FMUs before judges not written here, and the reference results that they are held against."""

import json
import stat
import sys
import zipfile
from importlib.metadata import version
from pathlib import Path
from xml.etree import ElementTree as ET

import fmpy
import numpy as np
import pytest

from cosim.base.jit import kernel
from cosim.coupling.calls import do_step
from cosim.coupling.fmu import MotorFmu
from cosim.fmi.abi import exchange_3
from fmus import references
from fmus.build import build_fmus, cached_fmu
from fmus.compiler import host_target
from fmus.references import EXPERIMENTS, FOLDER, outputs_of
from tests.judge import __main__ as judge
from tests.judge.building import build_fmucheck, build_fmusim, version_in
from tests.judge.tools import (
    Artefact,
    JudgeError,
    Tool,
    ask,
    package_version,
    reference_rows,
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
def artefacts(tmp_path_factory) -> dict[tuple[str, str], Artefact]:
    """The FMUs that have experiments."""
    folder, found = tmp_path_factory.mktemp("fmus"), {}
    for model in EXPERIMENTS:
        paths = build_fmus(
            {"2": folder / f"{model}2.fmu", "3": folder / f"{model}3.fmu"},
            [host_target()],
            model=model,
        )
        found[model, "2"] = Artefact(model, "2", paths[0])
        found[model, "3"] = Artefact(model, "3", paths[1])
    return found


@kernel
def step_through(instance, step_function, get_function, references, rows, step_s):
    status = 0
    for k in range(rows.shape[0]):
        status = max(status, do_step(step_function, instance, k * step_s, step_s))
        value = rows.ctypes.data + 8 * k * rows.shape[1]
        where, count = references.ctypes.data, rows.shape[1]
        status = max(status, exchange_3(get_function, (instance, where, count, value, count)))
    return status


def test_references_of_the_motor_are_what_the_co_simulation_gets():
    experiment = EXPERIMENTS["VibrationMotor"]
    motor = MotorFmu(cached_fmu("VibrationMotor")).instantiate("motor", experiment.inputs)
    rows, functions = np.empty((experiment.steps, 5)), motor.addresses
    numbers = np.concatenate([motor.fmu.outputs, motor.fmu.electrical]).astype(np.uint32)
    step, get = functions.do_step, functions.get_float64
    assert step_through(motor.instance, step, get, numbers, rows, experiment.step_s) == 0
    motor.close()
    assert rows[-1, 1] > 650.0
    assert (rows == reference_rows("VibrationMotor")).all()


@pytest.mark.parametrize("model", EXPERIMENTS)
def test_references_are_those_of_the_sources(model):
    rows = np.array(references.simulate(cached_fmu(model), model))
    assert (rows[1:, 1:] == reference_rows(model)).all(), "make them anew: fmus.references"
    assert (np.ptp(rows, axis=0) > 0.0).all()  # everything moves


@pytest.mark.long
def test_archives_hold_what_their_manifest_names(artefacts):
    for artefact in artefacts.values():
        with zipfile.ZipFile(artefact.path) as archive:
            root = ET.fromstring(archive.read(f"{FOLDER}/fmi-ls-manifest.xml"))
            names = {f"{{http://fmi-standard.org/fmi-ls-manifest}}fmi-ls-{k}": v
                     for k, v in references._STANDARD.items()}  # fmt: skip
            assert root.tag == "fmiReferences"
            assert root.attrib == names
            roles = {}
            for entry in root:
                assert entry.tag == "Related"
                path = Path(FOLDER, entry.attrib["source"])
                name = path.as_posix().replace("extra/org.fmi-standard.fmi-ls-ref/../../", "")
                assert archive.read(name)
                roles[entry.attrib["role"]] = name
            assert {"testcase", "result", "configuration", "document"} <= roles.keys()
            assert "documentation/fmi-ls-ref.txt" in archive.namelist()
            assert "documentation/licenses/license.txt" in archive.namelist()


@pytest.mark.parametrize("fmi", ["2", "3"])
@pytest.mark.parametrize("model", EXPERIMENTS)
def test_exchange_files_are_enough_for_an_importer(artefacts, model, fmi, tmp_path):
    path = artefacts[model, fmi].path
    fmpy.extract(str(path), str(tmp_path))
    given = tmp_path / FOLDER / model
    lines = Path(f"{given}_ref.opt").read_text().splitlines()
    options = {name: float(value) for name, value in (line.split(",") for line in lines)}
    expected = np.genfromtxt(f"{given}_ref.csv", delimiter=",", names=True)
    result = fmpy.simulate_fmu(
        str(path),
        fmi_type="CoSimulation",
        start_time=options["StartTime"],
        stop_time=options["StopTime"],
        output_interval=options["StepSize"],
        input=np.genfromtxt(f"{given}_in.csv", delimiter=",", names=True),
        output=outputs_of(model),
    )
    for name in outputs_of(model):
        # At the start inputs come after the outputs were read: the acceleration is not yet there.
        assert result[name][1:] == pytest.approx(expected[name][1:], rel=1e-9, abs=1e-12), name


@pytest.mark.long
@pytest.mark.parametrize("fmi", ["2", "3"])
@pytest.mark.parametrize("model", EXPERIMENTS)
@pytest.mark.parametrize("tool", TOOLS.values(), ids=TOOLS)
def test_importers_agree(artefacts, tool, model, fmi):
    artefact = artefacts[model, fmi]
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
    reference = Path(references.__file__).parent / "vibration_motor" / "VibrationMotor_ref.csv"
    write = f"""
import sys
out = sys.argv[sys.argv.index("--output-file" if "--output-file" in sys.argv else "-o") + 1]
text = open({str(reference)!r}).read()
open(out, "w").write(text CHANGE)
"""
    motor = artefacts["VibrationMotor", "2"]
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
    motor = artefacts["VibrationMotor", "3"]
    monkeypatch.setenv("PATH", str(tmp_path))
    for said, agrees in (("No errors found.", True), ("Rule 2.4.7 is broken", False)):
        program(tmp_path / "java", f"print({said!r})")
        verdict = ask(Tool("VDMCheck", lambda: "1", validate_by_vdmcheck(Path("v.jar"))), motor)
        assert verdict.agrees is agrees
        assert agrees or said in verdict.says


def test_command_writes_the_table_of_a_page(command, artefacts, monkeypatch, tmp_path):
    motor = artefacts["VibrationMotor", "2"]
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
    with pytest.raises(JudgeError, match="no fmusim"):
        build_fmusim(tmp_path, tmp_path / "out")
    monkeypatch.setattr("os.defpath", str(tmp_path))
    with pytest.raises(JudgeError, match="cmake"):
        build_fmucheck(tmp_path, tmp_path / "out")
    assert version_in(Path("Reference-FMUs-0.0.39")) == "0.0.39"


def test_a_missing_package_is_said(artefacts):
    tool = Tool("nothing", package_version("no-such-package"), simulate_by_fmpy)
    verdict = ask(tool, artefacts["VibrationMotor", "3"])
    assert (verdict.agrees, verdict.says) == (None, "not at hand: install no-such-package")

"""The archives: valid, complete, reproducible, for every platform."""

import shutil
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest
from fmpy.fmi2 import FMU2Slave
from fmpy.fmi3 import FMU3Slave
from fmpy.validation import validate_fmu

from cosim.base.arguments import ConfigError
from cosim.base.errors import UserError
from cosim.model.config import CoSimConfig
from cosim.model.params import TABLE_II, TIMING, describe
from cosim.model.scenario_file import find_scenario
from cosim.simulation.tasks import Task
from fmus import build, compiler, models
from fmus.description import render_header

MODEL = "VibrationMotor"
LICENSE = Path(__file__).parents[3] / "LICENSE"
SHARED_LIBRARY = {".so": b"\x7fELF", ".dll": b"MZ", ".dylib": b"\xcf\xfa\xed\xfe"}


@pytest.mark.parametrize("which", [2, 3, "array"])
def test_archives_are_valid_and_hold_what_a_user_looks_for(fmus, array_fmu, which):
    path = array_fmu if which == "array" else fmus[which]
    assert validate_fmu(str(path)) == []
    description: Any = fmpy.read_model_description(str(path))
    variables = {v.name: v for v in description.modelVariables}
    # The descriptions are written by hand: their values are those of the parameters.
    given = describe(TABLE_II) | {"step_size": describe(TIMING)["dt_s"]}
    for name, (value, quantity) in given.items():
        starts = {float(start) for start in str(variables[name].start).split()}
        assert starts == {value}, f"{name} in the model description is not that of params.py"
        assert variables[name].unit == quantity.unit
        assert name == "step_size" or variables[name].description == quantity.description
    units = {unit.name for unit in description.unitDefinitions}
    assert all(v.unit in units for v in variables.values() if v.type in {"Real", "Float64"})
    independent = [v.name for v in variables.values() if v.causality == "independent"]
    assert independent == ([] if which == 2 else ["time"])
    project = tomllib.loads(LICENSE.with_name("pyproject.toml").read_text())["project"]
    (line,) = (x for x in LICENSE.read_text().splitlines() if x.startswith("Copyright"))
    assert description.version == project["version"]
    assert description.license == project["license"]
    assert description.copyright == line
    assert description.author and line.endswith(description.author)
    with zipfile.ZipFile(path) as archive:
        page = archive.read("documentation/index.html").decode()
        assert archive.read("documentation/licenses/license.txt") == LICENSE.read_bytes()
    assert "<td>K_T</td>" in page and "$" not in page


def test_variables_of_arrays_are_those_of_one_motor_but_for_their_dimension(array_fmu, fmu):
    arrays, single = (fmpy.read_model_description(str(path)) for path in (array_fmu, fmu))
    # fmusim 0.0.39 crashes on a dimension that stands behind the array.
    assert [v.name for v in arrays.modelVariables][:2] == ["n", "samples"]
    alone: dict[str, Any] = {v.name: v for v in single.modelVariables}
    for v in arrays.modelVariables:
        if v.name.endswith("_samples"):
            assert v.shape == (1, 4)
        if v.name in {"n", "restart", "samples"} or v.name.endswith("_samples"):
            assert v.description
            continue
        own = alone[v.name]
        assert (v.description, v.unit, v.nominal) == (own.description, own.unit, own.nominal)
        tunable = v.name in {*TABLE_II._fields, "theta_start"}
        assert v.variability == ("tunable" if tunable else own.variability)
        scalar = v.name in {"time", "step_size", "closed_loop"}
        assert v.shape == (() if scalar else (4,)) or (scalar and not v.dimensions)
        assert v.start is None or set(str(v.start).split()) == {own.start}


def test_fmpy_drives_three_motors(array_fmu, tmp_path):
    fmpy.extract(str(array_fmu), str(tmp_path))
    description: Any = fmpy.read_model_description(str(tmp_path))
    reference = {v.name: v.valueReference for v in description.modelVariables}
    slave = FMU3Slave(guid=description.guid, unzipDirectory=str(tmp_path), instanceName="three",
                      modelIdentifier=description.coSimulation.modelIdentifier)  # fmt: skip
    slave.instantiate()
    slave.enterConfigurationMode()
    slave.setUInt64([reference["n"]], [3])
    slave.exitConfigurationMode()
    slave.setFloat64([reference["omega_des"]], [700.0, 300.0, -700.0])
    slave.enterInitializationMode()
    slave.exitInitializationMode()
    for k in range(2000):
        slave.doStep(k * 1e-3, 1e-3)
    slave.setInt64([reference["restart"]], [0, 1, 0])
    slave.doStep(2.0, 1e-3)
    first, second, third = slave.getFloat64([reference["omega"]], 3)
    assert [first, third] == pytest.approx([700.0, -700.0], rel=0.02)
    assert 0.0 < second < 100.0
    slave.freeInstance()


def test_fmpy_simulates_the_motors_of_the_start(array_fmu):
    speeds = [0.0, 300.0, 500.0, 700.0]
    start = {"omega_des": speeds}
    result = fmpy.simulate_fmu(str(array_fmu), stop_time=0.2, start_values=start)
    assert result["omega"][-1] == pytest.approx(speeds, rel=0.1)


def test_default_experiment_suits_importers(fmus, fmi):
    experiment: Any = fmpy.read_model_description(str(fmus[fmi])).defaultExperiment
    stop_s, step_s = float(experiment.stopTime), float(experiment.stepSize)
    assert stop_s / step_s < 10_000  # importers write a row for each step
    result = fmpy.simulate_fmu(str(fmus[fmi]), start_values={"omega_des": 700})
    assert result["time"][-1] == stop_s
    assert 100 < len(result) < 10_000


def test_two_builds_are_the_same_bytes(fmus, tmp_path):
    paths = build.build_fmus({"2": tmp_path / "a.fmu", "3": tmp_path / "b.fmu"},
                             [compiler.host_target()])  # fmt: skip
    assert [p.read_bytes() for p in paths] == [p.read_bytes() for p in fmus.values()]


@pytest.mark.long
def test_cache_builds_once_and_again_when_anything_changes(monkeypatch, tmp_path):
    monkeypatch.setenv("MINIROBOTS_CACHE", str(tmp_path))
    first = build.cached_fmu("VibrationMotor")
    stamp = first.stat().st_mtime_ns
    assert build.cached_fmu("VibrationMotor") == first
    assert first.stat().st_mtime_ns == stamp
    monkeypatch.setattr(build, "FLAGS", (*build.FLAGS, "-DOTHER"))
    second = build.cached_fmu("VibrationMotor")
    assert second != first
    monkeypatch.setattr(build, "read_origin", dict)
    assert build.cached_fmu("VibrationMotor") not in {first, second}


@pytest.mark.parametrize(
    "damage",
    ["empty", "cut", "flipped", "text", "removed", "no checksum", "other checksum"],
)
def test_damaged_fmu_of_the_cache_is_built_again(fmu, monkeypatch, tmp_path, caplog, damage):
    monkeypatch.setenv("MINIROBOTS_CACHE", str(tmp_path))
    # The compiler gives the same bytes every time; copying them takes its place.
    monkeypatch.setattr(build, "build_fmu", lambda folder, _: shutil.copy(fmu, folder))
    path = build.cached_fmu("VibrationMotor")
    (checksum,) = path.parent.glob("*.sha256")
    content = path.read_bytes()
    flipped = bytearray(content)
    flipped[12] ^= 1  # in the time stamp of the first entry, which no checksum of zip covers
    contents = {"empty": b"", "cut": content[:-1], "flipped": flipped, "text": b"no archive"}
    if damage in contents:
        path.write_bytes(contents[damage])
    elif damage == "removed":
        path.unlink()
    elif damage == "no checksum":
        checksum.unlink()
    else:
        checksum.write_text("0")
    assert build.cached_fmu("VibrationMotor") == path
    assert path.read_bytes() == content
    said = f"{path} is corrupted: rebuilding it"
    assert caplog.messages == [said] * (damage != "removed")
    stamp = path.stat().st_mtime_ns
    build.cached_fmu("VibrationMotor")
    assert path.stat().st_mtime_ns == stamp


@pytest.mark.parametrize(
    ("name", "old", "new", "behaves_alike"),
    [
        ("vibration_motor/VibrationMotor.xml", 'description="', 'description="Another ', True),
        ("vibration_motor/VibrationMotor.xml", 'nominal="', 'nominal="1', True),
        ("vibration_motor/VibrationMotor.xml", 'max="0.01"', 'max="0.02"', False),
        ("vibration_motor/motor.h", "return", "return 2 *", False),
        ("vibration_motor/motor.h", "/*", "/* Note: ", True),
        ("vibration_motor/motor.h", "return", "return  ", True),
        ("fmi/instance.h", "    return", "    return 2 *", False),
        ("fmi/documentation.html", "<p>", "<p>Also ", True),
        ("build.py", '"""', '"""Note: ', True),
    ],
)
def test_any_change_is_another_build_but_known_by_what_it_computes(
    name, old, new, behaves_alike, monkeypatch, tmp_path
):
    sources = shutil.copytree(models.ROOT, tmp_path / "sources")
    for module in (build, models):
        monkeypatch.setattr(module, "ROOT", sources)
    token, identity = build.instantiation_token, build.digest_of_sources.__wrapped__
    before = token(MODEL), identity(MODEL)
    text = (sources / name).read_text("utf-8")
    assert old in text
    (sources / name).write_text(text.replace(old, new, 1), "utf-8")
    assert token(MODEL) != before[0]
    assert (identity(MODEL) == before[1]) == behaves_alike


def test_a_replay_takes_another_build_of_the_fmu_that_was_recorded(fmu, monkeypatch, tmp_path):
    """Of a relative cache on another machine: other bytes, and the same results."""
    given: Any = CoSimConfig(), None, ((0, 0),), np.random.SeedSequence(0)
    origin = Task(find_scenario("1a"), fmu, *given).origin
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MINIROBOTS_CACHE", "cache")

    def rebuild(folder: Path, _: str) -> Path:
        with zipfile.ZipFile(folder / "VibrationMotor.fmu", "w") as archive:
            archive.writestr("modelDescription.xml", "of another machine")
        return folder

    monkeypatch.setattr(build, "build_fmu", rebuild)
    path = build.cached_fmu("VibrationMotor").absolute()
    other = Path(shutil.copy(path, tmp_path))
    assert build.is_built_in(path) and not build.is_built_in(other)
    policy: Any = None
    assert Task.again(origin, path, policy).origin == origin
    with pytest.raises(ConfigError, match="is not the one that was recorded"):
        Task.again(origin, other, policy)


def test_exports_are_the_two_standards_and_nothing_else(library):
    listing = subprocess.run(
        ["nm", "-D", "--defined-only", str(library)], capture_output=True, text=True, check=True
    ).stdout
    exported = {line.split()[-1] for line in listing.splitlines()}
    promised = {n for n in dir(FMU3Slave) if n.startswith("fmi3")}
    promised |= {n for n in dir(FMU2Slave) if n.startswith("fmi2")}
    assert exported == promised
    assert len(exported) == 75 + 34


@pytest.mark.long
def test_system_compiler_stands_in_for_ziglang(monkeypatch, tmp_path):
    monkeypatch.setattr(compiler, "compiler_command", lambda: [shutil.which("cc") or "cc"])
    path = build.build_fmu(tmp_path)
    assert validate_fmu(str(path)) == []
    result = fmpy.simulate_fmu(str(path), stop_time=0.1, start_values={"omega_des": 700.0})
    assert result["omega"][-1] > 600.0
    with pytest.raises(UserError, match="ziglang"):
        compiler.compile_library(MODEL, render_header(MODEL, ""), "aarch64-darwin")


def test_missing_compiler_is_one_sentence(monkeypatch):
    monkeypatch.setattr(compiler.importlib.util, "find_spec", lambda _name: None)
    monkeypatch.setattr(compiler.shutil, "which", lambda _name: None)
    with pytest.raises(build.UserError, match="install ziglang"):
        compiler.compiler_command()


def test_compiler_errors_are_told(monkeypatch):
    monkeypatch.setattr(compiler, "FLAGS", (*compiler.FLAGS, "-fno-such-flag"))
    with pytest.raises(UserError, match="no-such-flag"):
        compiler.compile_library(MODEL, render_header(MODEL, ""), compiler.host_target())


@pytest.mark.parametrize(
    ("model", "targets"),
    [
        pytest.param(MODEL, list(compiler.TARGETS)[::4], marks=pytest.mark.long),
        pytest.param(MODEL, list(compiler.TARGETS), marks=pytest.mark.slow),
        pytest.param("VibrationMotors", list(compiler.TARGETS), marks=pytest.mark.slow),
    ],
)
def test_platforms_are_built_here_reproducibly(tmp_path, model, targets):
    standards, built = models.STANDARDS[model], []
    for name in ("a", "b"):
        paths: dict[models.Fmi, Path] = {fmi: tmp_path / f"{name}{fmi}.fmu" for fmi in standards}
        built.append(build.build_fmus(paths, targets, model=model))
    assert [p.read_bytes() for p in built[0]] == [p.read_bytes() for p in built[1]]
    with zipfile.ZipFile(built[0][-1]) as archive:
        for target in targets:
            suffix = compiler.TARGETS[target].suffix
            content = archive.read(f"binaries/{target}/{model}{suffix}")
            assert content.startswith(SHARED_LIBRARY[suffix])


@pytest.mark.parametrize(
    ("targets", "places"),
    [
        (["x86_64-linux", "aarch64-linux"], ["linux64", "aarch64-linux"]),
        (["x86_64-windows", "aarch64-windows"], ["win64", "aarch64-windows"]),
        (["x86_64-darwin", "aarch64-darwin"], ["darwin64", "aarch64-darwin"]),
        (["aarch64-linux", "aarch64-windows"], ["linux64", "win64"]),
    ],
)
def test_aarch64_has_a_place_in_fmi_2(targets, places, monkeypatch, tmp_path):
    monkeypatch.setattr(build, "compile_library", lambda _model, _header, target: target.encode())
    (path,) = build.build_fmus({"2": tmp_path / "a.fmu"}, targets)
    with zipfile.ZipFile(path) as archive:
        held = {Path(name).parent.name: archive.read(name).decode() for name in archive.namelist()
                if name.startswith("binaries/")}  # fmt: skip
    assert held == dict(zip(places, targets, strict=True))


@pytest.mark.long
def test_command_writes_the_named_files(command, tmp_path):
    line = [sys.executable, "-m", "minirobots", "fmu", "--out", str(tmp_path), "--fmi", "both"]
    run = subprocess.run(line, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    assert {p.name for p in tmp_path.iterdir()} == {
        "VibrationMotor_fmi2.fmu",
        "VibrationMotor_fmi3.fmu",
        "VibrationMotors_fmi3.fmu",
    }
    assert all(str(path) in run.stdout for path in tmp_path.iterdir())
    assert command("fmu", "--out", tmp_path / "every").returncode == 0
    every = {"VibrationMotor.fmu", "VibrationMotors.fmu"}
    assert {p.name for p in (tmp_path / "every").iterdir()} == every
    assert command("fmu", "motor", "--out", tmp_path / "one").returncode == 0
    assert {p.name for p in (tmp_path / "one").iterdir()} == {"VibrationMotor.fmu"}


def test_command_builds_the_model_that_is_asked_for(command, tmp_path):
    line = ("--out", tmp_path, "--model", "VibrationMotors", "--fmi")
    assert command("fmu", *line, "3").returncode == 0
    assert [p.name for p in tmp_path.iterdir()] == ["VibrationMotors_fmi3.fmu"]
    refused = command("fmu", *line, "2")
    assert refused.returncode == 2
    assert "use --fmi 3" in refused.stderr


def test_options_without_effect_are_refused(command, tmp_path):
    refused = command("fmu", "motors", "--model", "VibrationMotor", "--out", tmp_path)
    assert refused.returncode == 2
    assert "--model has no effect" in refused.stderr
    assert not list(tmp_path.iterdir())


def test_unwritable_folder_is_one_sentence(command, tmp_path):
    blocked = tmp_path / "file"
    blocked.write_text("")
    run = command("fmu", "--out", blocked / "sub")
    assert run.returncode == 2
    # A compiler that takes long makes a line of progress, too.
    (said,) = (line for line in run.stderr.splitlines() if line != "compiling …")
    assert "choose another place" in said

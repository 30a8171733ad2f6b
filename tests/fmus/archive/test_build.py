"""The archives: valid, complete, reproducible, for every platform."""

import shutil
import subprocess
import sys
import tomllib
import zipfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest
from fmpy.fmi2 import FMU2Slave
from fmpy.fmi3 import FMU3Slave
from fmpy.validation import validate_fmu

from cosim.base.arguments import ConfigError
from cosim.model.config import CoSimConfig
from cosim.model.params import TABLE_II, TIMING, describe
from cosim.model.scenario_file import find_scenario
from cosim.simulation.tasks import Task
from fmus import build, compiler, models
from fmus.variables import load_table, render_header

MODEL = "VibrationMotor"
LICENSE = Path(__file__).parents[3] / "LICENSE"
SHARED_LIBRARY = {".so": b"\x7fELF", ".dll": b"MZ", ".dylib": b"\xcf\xfa\xed\xfe"}


@pytest.mark.parametrize("standard", [2, 3])
def test_validator_has_no_complaint(fmus, standard):
    assert validate_fmu(str(fmus[standard])) == []


def test_variables_come_from_the_parameters(fmus):
    for path in fmus.values():
        description = fmpy.read_model_description(str(path))
        variables = {v.name: v for v in description.modelVariables}
        for name, (value, quantity) in describe(TABLE_II).items():
            assert float(variables[name].start or 0) == value
            assert variables[name].unit == quantity.unit
            assert variables[name].description == quantity.description
        assert float(variables["step_size"].start or 0) == TIMING.dt_s
        units = {unit.name for unit in description.unitDefinitions}
        assert all(v.unit in units for v in variables.values() if v.type in {"Real", "Float64"})


def test_archives_hold_what_a_user_looks_for(fmus):
    for path in fmus.values():
        with zipfile.ZipFile(path) as archive:
            page = archive.read("documentation/index.html").decode()
            assert archive.read("documentation/licenses/license.txt") == LICENSE.read_bytes()
        assert "<td>K_T</td>" in page and "$" not in page


def test_model_descriptions_say_whose_work_they_describe(fmus):
    project = tomllib.loads(LICENSE.with_name("pyproject.toml").read_text())["project"]
    (line,) = (x for x in LICENSE.read_text().splitlines() if x.startswith("Copyright"))
    for path in fmus.values():
        description = fmpy.read_model_description(str(path))
        assert description.version == project["version"]
        assert description.license == project["license"]
        assert description.copyright == line
        assert description.author and line.endswith(description.author)


def test_default_experiment_suits_importers(fmus, fmi):
    experiment: Any = fmpy.read_model_description(str(fmus[fmi])).defaultExperiment
    stop_s, step_s = float(experiment.stopTime), float(experiment.stepSize)
    assert stop_s / step_s < 10_000  # importers write a row for each step
    result = fmpy.simulate_fmu(str(fmus[fmi]), start_values={"omega_des": 700})
    assert result["time"][-1] == stop_s
    assert 100 < len(result) < 10_000


def test_time_is_a_variable_where_the_standard_wants_it(fmus):
    for standard, path in fmus.items():
        variables = fmpy.read_model_description(str(path)).modelVariables
        independent = [v.name for v in variables if v.causality == "independent"]
        assert independent == (["time"] if standard == 3 else [])


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
    table = load_table()
    inputs = (replace(table.variables[0], description="other"), *table.variables[1:])
    monkeypatch.setattr(build, "load_table", lambda _: replace(table, variables=inputs))
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
    ("name", "old", "new"),
    [
        ("vibration_motor/variables.toml", 'description = "', 'description = "Another '),
        ("vibration_motor/variables.toml", "nominal = ", "nominal = 1"),
        ("vibration_motor/motor.h", "return", "return 2 *"),
        ("fmi/instance.h", "return", "return 2 *"),
        ("fmi/documentation.html", "<p>", "<p>Also "),
    ],
)
def test_token_is_another_one_when_any_part_of_the_fmu_is(name, old, new, monkeypatch, tmp_path):
    sources = shutil.copytree(models.ROOT, tmp_path / "sources")
    for module in (build, models):
        monkeypatch.setattr(module, "ROOT", sources)
    before = build.instantiation_token(build.load_table())
    text = (sources / name).read_text("utf-8")
    assert old in text
    (sources / name).write_text(text.replace(old, new, 1), "utf-8")
    assert build.instantiation_token(build.load_table()) != before


@pytest.mark.parametrize(
    ("name", "old", "new", "same"),
    [
        ("vibration_motor/motor.h", "return", "return 2 *", False),
        ("vibration_motor/variables.toml", "max = ", "max = 1", False),
        ("vibration_motor/motor.h", "/*", "/* Note: ", True),
        ("vibration_motor/motor.h", "return", "return  ", True),
        ("vibration_motor/variables.toml", 'description = "', 'description = "Another ', True),
        ("build.py", '"""', '"""Note: ', True),
    ],
)
def test_a_built_in_fmu_is_known_by_what_it_computes(name, old, new, same, monkeypatch, tmp_path):
    sources = shutil.copytree(models.ROOT, tmp_path / "sources")
    for module in (build, models):
        monkeypatch.setattr(module, "ROOT", sources)
    before = build.digest_of_sources.__wrapped__("VibrationMotor")
    text = (sources / name).read_text("utf-8")
    assert old in text
    (sources / name).write_text(text.replace(old, new, 1), "utf-8")
    assert (build.digest_of_sources.__wrapped__("VibrationMotor") == before) == same


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
    with pytest.raises(build.UserError, match="ziglang"):
        compiler.compile_library(MODEL, render_header(load_table(), ""), "aarch64-darwin")


def test_missing_compiler_is_one_sentence(monkeypatch):
    monkeypatch.setattr(compiler.importlib.util, "find_spec", lambda _name: None)
    monkeypatch.setattr(compiler.shutil, "which", lambda _name: None)
    with pytest.raises(build.UserError, match="install ziglang"):
        compiler.compiler_command()


def test_compiler_errors_are_told(monkeypatch):
    monkeypatch.setattr(compiler, "FLAGS", (*compiler.FLAGS, "-fno-such-flag"))
    with pytest.raises(build.UserError, match="no-such-flag"):
        compiler.compile_library(MODEL, render_header(load_table(), ""), compiler.host_target())


@pytest.mark.long
def test_other_platforms_are_built_here(tmp_path):
    targets = ["x86_64-linux", "x86_64-darwin", "aarch64-darwin"]
    paths = build.build_fmus({"2": tmp_path / "a.fmu", "3": tmp_path / "b.fmu"}, targets)
    check_libraries(paths, targets)


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


@pytest.mark.slow
def test_every_platform_is_built_here_reproducibly(tmp_path):
    targets = list(compiler.TARGETS)
    paths = build.build_fmus({"2": tmp_path / "a.fmu", "3": tmp_path / "b.fmu"}, targets)
    check_libraries(paths, targets)
    again = build.build_fmus({"2": tmp_path / "c.fmu", "3": tmp_path / "d.fmu"}, targets)
    assert [p.read_bytes() for p in paths] == [p.read_bytes() for p in again]


@pytest.mark.slow
def test_the_array_is_built_for_every_platform_reproducibly(tmp_path):
    paths = [
        build.build_fmus({"3": tmp_path / name}, list(compiler.TARGETS), model="VibrationMotors")[0]
        for name in ("a.fmu", "b.fmu")
    ]
    assert paths[0].read_bytes() == paths[1].read_bytes()
    with zipfile.ZipFile(paths[0]) as archive:
        for target, (_, suffix) in compiler.TARGETS.items():
            content = archive.read(f"binaries/{target}/VibrationMotors{suffix}")
            assert content.startswith(SHARED_LIBRARY[suffix])


def check_libraries(paths: list[Path], targets: list[str]) -> None:
    with zipfile.ZipFile(paths[1]) as archive:
        for target in targets:
            suffix = compiler.TARGETS[target].suffix
            content = archive.read(f"binaries/{target}/VibrationMotor{suffix}")
            assert content.startswith(SHARED_LIBRARY[suffix])
    with zipfile.ZipFile(paths[0]) as archive:
        for place in ("linux64/VibrationMotor.so", "darwin64/VibrationMotor.dylib"):
            content = archive.read(f"binaries/{place}")
            assert content.startswith(SHARED_LIBRARY[Path(place).suffix])


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

"""The archives: valid, complete, reproducible, for every platform."""

import re
import shutil
import subprocess
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
HOST = compiler.host_target()
LICENSE = Path(__file__).parents[3] / "LICENSE"
SHARED_LIBRARY = {".so": b"\x7fELF", ".dll": b"MZ", ".dylib": b"\xcf\xfa\xed\xfe"}


def test_archives_are_valid_and_hold_what_a_user_looks_for(fmus, kind):
    assert validate_fmu(str(fmus[kind])) == []
    description: Any = fmpy.read_model_description(str(fmus[kind]))
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
    assert independent == ([] if kind == 2 else ["time"])
    project = tomllib.loads(LICENSE.with_name("pyproject.toml").read_text())["project"]
    (line,) = (x for x in LICENSE.read_text().splitlines() if x.startswith("Copyright"))
    assert description.version == project["version"]
    assert description.license == project["license"]
    assert description.copyright == line
    assert description.author and line.endswith(description.author)
    with zipfile.ZipFile(fmus[kind]) as archive:
        page = archive.read("documentation/index.html").decode()
        assert archive.read("documentation/licenses/license.txt") == LICENSE.read_bytes()
    columns = re.findall("<th>(.*?)</th>", page)
    rows = [re.findall("<td>(.*?)</td>", row) for row in re.findall("<tr>(.*?)</tr>", page)]
    cells = {row[0]: dict(zip(columns, row, strict=True)) for row in rows if row}
    assert cells.keys() == variables.keys() - {"time"} and "$" not in page
    for v in variables.values():  # fmpy reads no limits of whole numbers
        if v.type in {"Real", "Float64"} and v.name != "time":
            assert (cells[v.name]["min"], cells[v.name]["max"]) == (v.min or "", v.max or "")


def test_variables_of_arrays_are_those_of_one_motor_but_for_their_dimension(fmus):
    arrays, single = (fmpy.read_model_description(str(fmus[kind])) for kind in ("array", 3))
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


def test_importers_simulate_the_default_experiment(fmus, kind):
    experiment: Any = fmpy.read_model_description(str(fmus[kind])).defaultExperiment
    stop_s, step_s = float(experiment.stopTime), float(experiment.stepSize)
    assert stop_s / step_s < 10_000  # importers write a row for each step
    speeds = [0.0, 300.0, 500.0, 700.0] if kind == "array" else 700.0
    result = fmpy.simulate_fmu(str(fmus[kind]), start_values={"omega_des": speeds})
    assert result["time"][-1] == stop_s
    assert 100 < len(result) < 10_000
    assert result["omega"][-1] == pytest.approx(speeds, rel=0.1)


def test_damaged_fmu_of_the_cache_is_built_again(motor_fmu, monkeypatch, tmp_path, caplog):
    """Also where no checksum of zip covers what is damaged: the time stamp of the first entry."""
    monkeypatch.setenv("MINIROBOTS_CACHE", str(tmp_path))
    # The compiler gives the same bytes every time; copying them takes its place.
    monkeypatch.setattr(build, "build_fmu", lambda folder, _: shutil.copy(motor_fmu, folder))
    path = build.cached_fmu(MODEL)
    content = path.read_bytes()
    path.write_bytes(content[:12] + b"~" + content[13:])
    assert build.cached_fmu(MODEL) == path
    assert path.read_bytes() == content
    assert caplog.messages == [f"{path} is corrupted: rebuilding it"]


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
    monkeypatch.setenv("MINIROBOTS_CACHE", str(tmp_path))
    monkeypatch.setattr(build, "build_fmu", lambda folder, _: (folder / f"{MODEL}.fmu").touch())

    def identity() -> str:
        return build.digest_of_sources.__wrapped__(MODEL)

    before = build.instantiation_token(MODEL), build.cached_fmu(MODEL), identity()
    text = (sources / name).read_text("utf-8")
    assert old in text
    (sources / name).write_text(text.replace(old, new, 1), "utf-8")
    assert build.instantiation_token(MODEL) != before[0]
    assert build.cached_fmu(MODEL) != before[1]
    assert (identity() == before[2]) == behaves_alike


@pytest.mark.parametrize(("name", "other"), [("FLAGS", ()), ("read_origin", dict)])
def test_flags_and_origin_are_part_of_a_build(monkeypatch, tmp_path, name, other):
    monkeypatch.setenv("MINIROBOTS_CACHE", str(tmp_path))
    monkeypatch.setattr(build, "build_fmu", lambda folder, _: (folder / f"{MODEL}.fmu").touch())
    before = build.cached_fmu(MODEL)
    monkeypatch.setattr(build, name, other)
    assert build.cached_fmu(MODEL) != before


def test_an_fmu_is_built_in_as_long_as_its_cache_is_the_cache(motor_fmu, monkeypatch, tmp_path):
    with monkeypatch.context() as patch:
        patch.setenv("MINIROBOTS_CACHE", str(tmp_path))
        assert not build.built_in_model(motor_fmu)
    assert build.built_in_model(motor_fmu) == MODEL


def test_a_replay_takes_another_build_of_the_fmu_that_was_recorded(
    motor_fmu, monkeypatch, tmp_path
):
    """Of a relative cache on another machine: other bytes, and the same results."""
    given: Any = CoSimConfig(), None, ((0, 0),), np.random.SeedSequence(0)
    origin = Task(find_scenario("1a"), motor_fmu, *given).origin
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MINIROBOTS_CACHE", "cache")

    def rebuild(folder: Path, _: str) -> Path:
        with zipfile.ZipFile(folder / "VibrationMotor.fmu", "w") as archive:
            archive.writestr("modelDescription.xml", "of another machine")
        return folder

    monkeypatch.setattr(build, "build_fmu", rebuild)
    path = build.cached_fmu(MODEL).absolute()
    other = Path(shutil.copy(path, tmp_path))
    assert build.built_in_model(path) and not build.built_in_model(other)
    policy: Any = None
    assert Task.again(origin, path, policy).origin == origin
    with pytest.raises(ConfigError, match="is not the one that was recorded"):
        Task.again(origin, other, policy)


def test_exports_are_the_two_standards_and_nothing_else(libraries):
    command = ["nm", "-D", "--defined-only", str(libraries[MODEL])]
    listing = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    exported = {line.split()[-1] for line in listing.splitlines()}
    promised = {n for n in dir(FMU3Slave) if n.startswith("fmi3")}
    promised |= {n for n in dir(FMU2Slave) if n.startswith("fmi2")}
    assert exported == promised
    assert len(exported) == 75 + 34


@pytest.mark.long
def test_system_compiler_stands_in_for_ziglang(monkeypatch, tmp_path):
    monkeypatch.setattr(compiler.importlib.util, "find_spec", lambda name: name == "fmpy")
    monkeypatch.setattr(compiler, "fmi_headers", lambda: Path(fmpy.__file__).parent / "c-code")
    path = build.build_fmu(tmp_path)
    assert validate_fmu(str(path)) == []
    result = fmpy.simulate_fmu(str(path), stop_time=0.1, start_values={"omega_des": 700.0})
    assert result["omega"][-1] > 600.0
    with pytest.raises(UserError, match="ziglang"):
        compiler.compile_library(MODEL, render_header(MODEL, ""), "aarch64-darwin")
    monkeypatch.setenv("PATH", "")
    with pytest.raises(UserError, match="install ziglang"):
        compiler.compiler_command()


def test_compiler_errors_are_told(monkeypatch):
    monkeypatch.setattr(compiler, "FLAGS", (*compiler.FLAGS, "-fno-such-flag"))
    with pytest.raises(UserError, match="no-such-flag"):
        compiler.compile_library(MODEL, render_header(MODEL, ""), HOST)


@pytest.mark.long
@pytest.mark.parametrize(
    ("model", "targets"),
    [
        (MODEL, [HOST]),
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
    one, three = "VibrationMotor.fmu", "VibrationMotor_fmi3.fmu"
    lines = {
        ("--fmi", "both"): {"VibrationMotor_fmi2.fmu", three, "VibrationMotors_fmi3.fmu"},
        (): {one, "VibrationMotors.fmu"},
        ("motor",): {one},
        ("motors", "--fmi", "3"): {"VibrationMotors_fmi3.fmu"},
    }
    for number, (arguments, names) in enumerate(lines.items()):
        out = tmp_path / str(number)
        done = command("fmu", *arguments, "--out", out)
        assert done.returncode == 0, done.stderr
        assert {path.name for path in out.iterdir()} == names
        assert all(str(out / name) in done.stdout for name in names)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ("motors --fmi 2 --out OUT", "use --fmi 3"),
        ("--out OUT/file/sub", "choose another place"),
    ],
)
def test_command_refuses_in_one_sentence(command, tmp_path, arguments, words):
    (tmp_path / "file").touch()
    refused = command("fmu", *arguments.replace("OUT", str(tmp_path)).split())
    assert refused.returncode == 2
    # A compiler that takes long makes a line of progress, too.
    (said,) = (line for line in refused.stderr.splitlines() if line != "compiling …")
    assert words in said
    assert [path.name for path in tmp_path.iterdir()] == ["file"]

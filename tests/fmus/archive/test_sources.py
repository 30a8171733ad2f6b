"""The archives' sources, built by others: by what buildDescription.xml says and nothing else."""

import ctypes
import re
import shutil
import subprocess
import sys
import xml.etree.ElementTree as ET
import zipfile
from collections.abc import Callable
from pathlib import Path

import fmpy
import fmpy.build
import lxml.etree
import numpy as np
import pytest
import ziglang

from fmus import compiler
from fmus.build import instantiation_token
from fmus.compiler import fmi_headers
from fmus.description import render_header

ZIG = [sys.executable, "-m", "ziglang"]
# zig builds for the very processor, where a compiler may contract to fused multiply-adds. Without
# optimisation it would add checks at runtime, and functions of its own with them.
GCC = {"gcc": ["gcc"], "gcc -O2": ["gcc", "-O2"]} if shutil.which("gcc") else {}
COMPILERS = {"zig": [*ZIG, "cc", "-O2"], **GCC}
# Functions that the model description does not offer do not use their parameters; the last is zig's
# own, with -S.
WARNINGS = ["-Wall", "-Wextra", "-Wno-unused-parameter", "-Wno-unused-command-line-argument"]
# fmpy's variant of the FMI 2 header leaves the prefix out; these are the standard's lines (2.0.5).
FMPY_NAMES = "#define fmi2FullName(name) name"
STANDARD_NAMES = """
#if !defined(FMI2_OVERRIDE_FUNCTION_PREFIX) && defined(FMI2_FUNCTION_PREFIX)
  #define fmi2Paste(a,b)     a ## b
  #define fmi2PasteB(a,b)    fmi2Paste(a,b)
  #define fmi2FullName(name) fmi2PasteB(FMI2_FUNCTION_PREFIX, name)
#else
  #define fmi2FullName(name) name
#endif
"""


@pytest.fixture(scope="module")
def archive(fmus, tmp_path_factory) -> Callable[[int | str], Path]:
    """A kind's archive, unpacked, with the headers of its standard alone in `headers`."""
    folders = {}
    for kind, path in fmus.items():
        folders[kind] = folder = tmp_path_factory.mktemp(f"fmi{kind}")
        with zipfile.ZipFile(path) as content:
            content.extractall(folder)
        (folder / "headers").mkdir()
        for header in fmi_headers().glob(f"fmi{2 if kind == 2 else 3}*.h"):
            text = header.read_text()
            if header.name == "fmi2Functions.h":
                assert text.count(FMPY_NAMES) == 1
                text = text.replace(FMPY_NAMES, STANDARD_NAMES)
            (folder / "headers" / header.name).write_text(text)
    return folders.__getitem__


def arguments(folder: Path, optional: bool = True) -> list[str]:
    """Arguments of a compiler as the build description gives them; it needs no libraries."""
    root = ET.parse(folder / "sources" / "buildDescription.xml").getroot()
    assert not list(root.iter("Library"))
    (files,) = root.iter("SourceFileSet")
    given = [f"-std={files.attrib['language'].lower()}", f"-I{folder / 'headers'}"]
    given += files.get("compilerOptions", "").split()
    for each in files.iter("PreprocessorDefinition"):
        if optional or each.get("optional") != "true":
            given.append(f"-D{each.attrib['name']}={each.attrib['value']}")
    return given + [str(folder / "sources" / e.attrib["name"]) for e in files.iter("SourceFile")]


def run(*command: str | Path) -> None:
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def trajectory(motor) -> bytes:
    """Outputs through saturation, of an array also sticking, restarts, tuning; the last state."""
    if motor.n == 1:
        columns = motor.start(omega_des=700.0, d=1e-6, solver=1 + motor.fmi % 2).run(0.5, 1e-2)[1]
        assert columns["omega"][-1] > 600.0
        return np.array([*columns.values()]).tobytes() + motor.save()
    motors, n, generator, rows, time_s = motor, motor.n, np.random.default_rng(5), [], 0.0
    motors.start(theta_start=generator.uniform(-3.0, 3.0, n), J=generator.uniform(2e-9, 4e-9, n))
    for k, step_s in enumerate([1e-5] * 100 + [1e-3] * 100 + [2.5e-5] * 100):
        if k % 20 == 0:
            speeds = generator.choice([0.0, 700.0, -300.0, 6000.0], n)
            noise = generator.uniform(-50.0, 50.0, n)
            assert motors.set(omega_des=speeds, omega_noise=noise) == 0
        if k % 70 == 30:
            assert motors.set(restart=generator.integers(0, 2, n)) == 0
            assert motors.set(K_T=generator.uniform(3e-4, 4e-4, n)) == 0
        assert motors.do_step(time_s, step_s) == 0, motors.messages
        time_s += step_s
        rows.append(motors.get("theta", "omega", "omega_dot", "V_s", "i", "integral"))
    return np.array(rows).tobytes() + motors.save()


@pytest.mark.long
@pytest.mark.parametrize("name", COMPILERS)
def test_build_description_is_enough(archive, kind, name, instance, tmp_path):
    folder, built = archive(kind), tmp_path / "built.so"
    shared = [*COMPILERS[name], "-shared", "-fPIC", "-Werror", *WARNINGS]
    run(*shared, *arguments(folder), "-Wl,--no-undefined", "-o", built)
    n = 13 if kind == "array" else 1
    assert trajectory(instance(kind, n, library=built)) == trajectory(instance(kind, n))


@pytest.mark.long
@pytest.mark.parametrize("level", [0, 1, 2])
@pytest.mark.parametrize("n", [3, 13])
def test_every_instruction_set_gives_the_same_bits(array, monkeypatch, tmp_path, n, level):
    """A level that this processor lacks is the best one that it has."""
    monkeypatch.setattr(compiler, "FLAGS", (*compiler.FLAGS, f"-DMOST_LEVEL={level}"))
    model, library = "VibrationMotors", tmp_path / "levels.so"
    header = render_header(model, instantiation_token(model))
    library.write_bytes(compiler.compile_library(model, header, compiler.host_target()))
    assert trajectory(array(n, library=library)) == trajectory(array(n))


def test_vectors_are_as_wide_as_the_instruction_set_has_them(archive, tmp_path):
    assembly, zig = tmp_path / "motors.s", [*COMPILERS["zig"], "-O3"]
    given = [*arguments(archive("array")), "-o", assembly]
    run(*zig, "-fPIC", "-target", "x86_64-linux-gnu", "-S", *given)
    bodies = r"^(baseline|avx2|avx512)_step:[^\n]*\n(.*?)^\.Lfunc_end"
    register = {"baseline": "xmm", "avx2": "ymm", "avx512": "zmm"}
    for level, body in re.findall(bodies, assembly.read_text(), re.MULTILINE | re.DOTALL):
        multiplications = re.findall(r"^\tv?mulpd\s.*%(.mm)", body, re.MULTILINE)
        # Few motors need but half the widest vector.
        assert len(multiplications) > 30
        assert max(multiplications) == register.pop(level)
        assert level == "baseline" or min(multiplications) == "ymm"
        assert not re.search(r"^\tvfn?m(add|sub)", body, re.MULTILINE)
    assert not register


@pytest.mark.long
def test_build_by_fmpy(archive, fmi, instance, tmp_path):
    assert shutil.which("cc") and shutil.which("make"), "the test machine has a compiler and make"
    folder = tmp_path / "fmu"
    shutil.copytree(archive(fmi), folder)
    shutil.rmtree(folder / "binaries")
    fmpy.build.build_platform_binary(folder, all_warnings=True)
    (built,) = (folder / "binaries").rglob("VibrationMotor.so")
    assert trajectory(instance(fmi, library=built)) == trajectory(instance(fmi))
    result = fmpy.simulate_fmu(str(folder), start_values={"omega_des": 700.0})
    assert result["omega"][-1] > 600.0


def functions(folder: Path, fmi: int) -> set[str]:
    """The functions of the standard, from its header; of FMI 2 without those of Model Exchange."""
    text = (folder / "headers" / f"fmi{fmi}Functions.h").read_text()
    text = re.sub("for FMI2 for Model Exchange.*?for FMI2 for Co-Sim", "", text, flags=re.DOTALL)
    return set(re.findall(rf"^#define (fmi{fmi}\w+) +fmi{fmi}FullName\(fmi", text, re.MULTILINE))


def test_only_the_standards_functions_can_clash(archive, fmi, tmp_path):
    folder, assembly = archive(fmi), tmp_path / "motor.s"
    given = [*arguments(folder, optional=False), "-o", assembly]
    run(*COMPILERS["zig"], *WARNINGS, "-Werror", "-target", "x86_64-linux-gnu", "-S", *given)
    shown = set(re.findall(r"^\s*\.(?:globl|weak)\s+(\w+)", assembly.read_text(), re.MULTILINE))
    assert shown == {f"VibrationMotor_{name}" for name in functions(folder, fmi)}
    assert len(shown) == {2: 34, 3: 75}[fmi]


class Prefixed:
    """Functions of a library by their names without a prefix."""

    def __init__(self, library: Path, prefix: str) -> None:
        self.library, self.prefix = ctypes.CDLL(str(library)), prefix

    def __getattr__(self, name: str):
        return getattr(self.library, self.prefix + name)


@pytest.mark.long
def test_motors_of_both_standards_link_into_one_program(archive, instance, tmp_path):
    objects = []
    copies = [(2, "VibrationMotor_"), (3, "VibrationMotor_"), (3, "second_")]
    for fmi, prefix in copies:
        objects.append(tmp_path / f"{prefix}{fmi}.o")
        given = [*arguments(archive(fmi), optional=False), f"-DFMI{fmi}_FUNCTION_PREFIX={prefix}"]
        run(*COMPILERS["zig"], "-c", "-fPIC", *given, "-o", objects[-1])
    program = tmp_path / "program.so"
    run(*COMPILERS["zig"], "-shared", *objects, "-o", program)
    for fmi, prefix in copies:
        copy = instance(fmi, library=Prefixed(program, prefix))
        assert trajectory(copy) == trajectory(instance(fmi))


def test_sources_do_without_the_attributes_of_gcc_for_others(archive, fmi):
    folder, include = archive(fmi), Path(ziglang.__file__).parent / "lib"
    headers = [include / "include", include / "libc" / "include" / "any-windows-any"]
    clang = [*ZIG, "clang", "--target=x86_64-windows-msvc", *(f"-isystem{h}" for h in headers)]
    text = subprocess.run(
        [*clang, "-E", *arguments(folder)], capture_output=True, check=True
    ).stdout
    own, source = "", ""
    for line in text.decode().splitlines():
        if marker := re.match(r'# \d+ "(.*)"', line):
            source = marker[1]
        elif source.startswith(str(folder / "sources")):
            own += line + "\n"
    assert "model_do_step" in own
    assert "__attribute__" not in own


def test_build_descriptions_are_valid(archive, fmi):
    schema = Path(fmpy.__file__).parent / "schema" / "fmi3" / "fmi3BuildDescription.xsd"
    document = lxml.etree.parse(str(archive(fmi) / "sources" / "buildDescription.xml"))
    lxml.etree.XMLSchema(lxml.etree.parse(str(schema))).assertValid(document)
    (files,) = document.iter("SourceFileSet")
    assert files.get("compiler") == "gcc"  # whose options these are

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

from fmus.compiler import fmi_headers

ZIG = [sys.executable, "-m", "ziglang"]
# zig builds for the very processor, where a compiler may contract to fused multiply-adds. Without
# optimisation it would add checks at runtime, and functions of its own with them.
COMPILERS = {"zig": [*ZIG, "cc", "-O2"]} | ({"gcc": ["gcc"]} if shutil.which("gcc") else {})
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
def archive(fmus, tmp_path_factory) -> Callable[[int], Path]:
    """A standard's archive, unpacked, with the headers of that standard alone in `headers`."""
    folders = {}
    for fmi, path in fmus.items():
        folders[fmi] = folder = tmp_path_factory.mktemp(f"fmi{fmi}")
        with zipfile.ZipFile(path) as content:
            content.extractall(folder)
        (folder / "headers").mkdir()
        for header in fmi_headers().glob(f"fmi{fmi}*.h"):
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
    """Outputs in half a second of co-simulation, through saturation, and the state at its end."""
    motor.start(omega_des=700.0, d=1e-6, solver=1 + motor.fmi % 2)
    rows = []
    for k in range(50):
        assert motor.do_step(k * 1e-2, 1e-2) == 0, motor.messages
        rows.append(motor.get("theta", "omega", "omega_dot", "V_s", "i"))
    assert rows[-1][1] > 600.0
    return np.array(rows).tobytes() + motor.save()


@pytest.mark.long
@pytest.mark.parametrize("compiler", COMPILERS)
def test_build_description_is_enough(archive, fmi, compiler, instance, tmp_path):
    folder, built = archive(fmi), tmp_path / "built.so"
    shared = [*COMPILERS[compiler], "-shared", "-fPIC", "-Werror"]
    run(*shared, *arguments(folder), "-Wl,--no-undefined", "-o", built)
    assert trajectory(instance(fmi, library=built)) == trajectory(instance(fmi))


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
    # Functions that the model description does not offer do not use their parameters.
    warnings = ["-Wall", "-Wextra", "-Werror", "-Wno-unused-parameter"]
    warnings.append("-Wno-unused-command-line-argument")  # zig's own, with -S
    given = arguments(folder, optional=False)
    run(*COMPILERS["zig"], *warnings, "-target", "x86_64-linux-gnu", "-S", *given, "-o", assembly)
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

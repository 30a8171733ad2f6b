"""The loops of every instruction set and of other compilers give the same bits."""

import re
import subprocess
import sys
import zipfile
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pytest

from fmus import compiler
from fmus.description import render_header

OK = 0
ZIG = [sys.executable, "-m", "ziglang", "cc", "-O2"]  # for this very processor
COMPILERS = {"zig": ZIG, "gcc": ["gcc", "-O2"], "gcc without optimisation": ["gcc"]}


def trajectory(motors) -> bytes:
    """Outputs through saturation, sticking, reversing, restarts, tuning, steps of all lengths."""
    generator, rows, time_s = np.random.default_rng(5), [], 0.0
    n = motors.n
    motors.start(theta_start=generator.uniform(-3.0, 3.0, n), J=generator.uniform(2e-9, 4e-9, n))
    for k, step_s in enumerate([1e-5] * 100 + [1e-3] * 100 + [2.5e-5] * 100):
        if k % 20 == 0:
            speeds = generator.choice([0.0, 700.0, -300.0, 6000.0], n)
            noise = generator.uniform(-50.0, 50.0, n)
            assert motors.set(omega_des=speeds, omega_noise=noise) == OK
        if k % 70 == 30:
            assert motors.set(restart=generator.integers(0, 2, n)) == OK
            assert motors.set(K_T=generator.uniform(3e-4, 4e-4, n)) == OK
        assert motors.do_step(time_s, step_s) == OK, motors.messages
        time_s += step_s
        rows.append(motors.get("theta", "omega", "omega_dot", "V_s", "i", "integral"))
    return np.array(rows).tobytes() + motors.save()


@pytest.mark.long
@pytest.mark.parametrize("level", [0, 1, 2])
@pytest.mark.parametrize("n", [3, 13])
def test_every_instruction_set_gives_the_same_bits(
    array, array_token, monkeypatch, tmp_path, n, level
):
    """A level that this processor lacks is the best one that it has."""
    monkeypatch.setattr(compiler, "FLAGS", (*compiler.FLAGS, f"-DMOST_LEVEL={level}"))
    header = render_header("VibrationMotors", array_token)
    library = tmp_path / "levels.so"
    library.write_bytes(compiler.compile_library("VibrationMotors", header, compiler.host_target()))
    assert trajectory(array(n, library)) == trajectory(array(n))


@pytest.fixture(scope="module")
def sources(array_fmu, tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("sources")
    with zipfile.ZipFile(array_fmu) as archive:
        archive.extractall(folder)
    return folder / "sources"


def arguments(sources: Path) -> list[str]:
    """Arguments of a compiler as the build description gives them."""
    (files,) = ET.parse(sources / "buildDescription.xml").getroot().iter("SourceFileSet")
    defined = [
        f"-D{e.attrib['name']}={e.attrib['value']}" for e in files.iter("PreprocessorDefinition")
    ]
    names = [str(sources / e.attrib["name"]) for e in files.iter("SourceFile")]
    options = [files.attrib["compilerOptions"], f"-I{compiler.fmi_headers()}", *defined]
    return ["-std=c11", "-fPIC", "-Wall", "-Wextra", "-Wno-unused-parameter", *options, *names]


def run(*command: str | Path) -> None:
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@pytest.mark.long
@pytest.mark.parametrize("name", COMPILERS)
def test_build_description_is_enough(array, sources, name, tmp_path):
    built = tmp_path / "built.so"
    line = [*COMPILERS[name], "-Werror", "-shared", "-Wl,--no-undefined", *arguments(sources)]
    run(*line, "-o", built)
    assert trajectory(array(13, built)) == trajectory(array(13))


def test_vectors_are_as_wide_as_the_instruction_set_has_them(sources, tmp_path):
    assembly = tmp_path / "motors.s"
    line = [*ZIG, "-O3", "-target", "x86_64-linux-gnu", "-S", *arguments(sources)]
    run(*line, "-o", assembly)
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

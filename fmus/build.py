"""Builds `VibrationMotor.fmu`: renders its tables, compiles its C code, packs the archive.

`python -m fmus.build --out DIR` writes the FMU; `cached_fmu` gives the co-simulation one that is
built on first use. Numerical work is in `vibration_motor/motor.h`, not here.
"""

import hashlib
import importlib.metadata
import importlib.util
import platform
import shutil
import subprocess
import sys
import tempfile
import uuid
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import tyro

from cosim.errors import UserError, run_command
from cosim.storage import cache_dir, replacing
from fmus.description import render_fmi3
from fmus.variables import SOURCES, Table, load_table, render_header

FMU_NAME = "VibrationMotor.fmu"
C_FILES = ("instance.c", "fmi3.c")
H_FILES = ("motor.h", "instance.h")
# Without contraction to fused multiply-adds every platform computes the same bits.
FLAGS = ("-std=gnu11", "-O3", "-g0", "-s", "-shared", "-fPIC", "-fvisibility=hidden",
         "-ffp-contract=off", "-Wall", "-Wextra", "-Wno-unused-parameter")  # fmt: skip
# The first time a zip archive can tell; a build says nothing of when it was made.
ZIP_EPOCH = (1980, 1, 1, 0, 0, 0)


class BuildError(UserError):
    """The FMU cannot be built here; the message says what is missing or went wrong."""


class Target(NamedTuple):
    """A platform to build for.

    Attributes:
        triple: what the compiler calls it.
        suffix: file name suffix of its shared libraries.
    """

    triple: str
    suffix: str


# Platform tuples of FMI 3. glibc 2.17 is the oldest that these Linux systems still run.
TARGETS = {
    "x86_64-linux": Target("x86_64-linux-gnu.2.17", ".so"),
    "aarch64-linux": Target("aarch64-linux-gnu.2.17", ".so"),
    "x86_64-windows": Target("x86_64-windows-gnu", ".dll"),
    "aarch64-windows": Target("aarch64-windows-gnu", ".dll"),
    "x86_64-darwin": Target("x86_64-macos", ".dylib"),
    "aarch64-darwin": Target("aarch64-macos", ".dylib"),
}


def host_target() -> str:
    """Platform tuple of this machine.

    Raises:
        BuildError: the FMU has no target for this machine.
    """
    machine = platform.machine().lower()
    architecture = {"amd64": "x86_64", "arm64": "aarch64"}.get(machine, machine)
    system = {"win32": "windows"}.get(sys.platform, sys.platform)
    if (name := f"{architecture}-{system}") not in TARGETS:
        raise BuildError(f"no FMU target for {name}; use a machine of {', '.join(TARGETS)}")
    return name


def build_fmu(out_dir: Path) -> Path:
    """Build the FMU for this machine.

    Args:
        out_dir: folder that receives `VibrationMotor.fmu`; made if missing.

    Returns:
        Path of the FMU; the file appears whole or not at all.

    Raises:
        BuildError: no compiler was found, or it failed.
        OSError: the folder cannot be written.
    """
    table = load_table()
    token = instantiation_token(table)
    target = host_target()
    library = compile_library(render_header(table, token), target)
    path = out_dir / FMU_NAME
    with replacing(path) as temporary, zipfile.ZipFile(temporary, "w") as archive:
        _add(archive, "modelDescription.xml", render_fmi3(table, token))
        _add(archive, f"binaries/{target}/{table.name}{TARGETS[target].suffix}", library)
    return path


def cached_fmu() -> Path:
    """FMU for this machine from the cache, built there on first use.

    The cache's key is a hash of sources, rendered defaults, flags and compiler version.

    Raises:
        BuildError: no compiler was found, or it failed.
        OSError: the cache cannot be written.
    """
    table = load_table()
    key = hashlib.sha256()
    for part in (instantiation_token(table), host_target(), *FLAGS, compiler_version()):
        key.update(part.encode() + b"\0")
    folder = cache_dir("fmus") / key.hexdigest()[:16]
    path = folder / FMU_NAME
    return path if path.is_file() else build_fmu(folder)


def instantiation_token(table: Table) -> str:
    """Token that ties model description and binary: a hash of everything they are made from."""
    digest = hashlib.sha256(render_header(table, "").encode())
    for path in _inputs():
        digest.update(path.name.encode() + path.read_bytes())
    return f"{{{uuid.UUID(bytes=digest.digest()[:16])}}}"


def _inputs() -> Iterator[Path]:
    yield from sorted(path for path in SOURCES.iterdir() if path.is_file())
    yield from sorted(Path(__file__).parent.glob("*.py"))


def compiler_command() -> list[str]:
    """Command of the C compiler: ziglang, or the system's cc where ziglang is missing.

    Raises:
        BuildError: there is neither.
    """
    if importlib.util.find_spec("ziglang"):
        return [sys.executable, "-m", "ziglang", "cc"]
    if cc := shutil.which("cc"):
        return [cc]
    raise BuildError("no C compiler found; install ziglang (pip install ziglang) or a system cc")


def compiler_version() -> str:
    """Name and version of the compiler that `compiler_command` gives."""
    command = compiler_command()
    if "ziglang" in command:
        return f"ziglang {importlib.metadata.version('ziglang')}"
    return subprocess.run(
        [*command, "--version"], capture_output=True, text=True, check=True
    ).stdout


def compile_library(header: str, target: str) -> bytes:
    """Compile the C code into a shared library.

    Args:
        header: content of `variables.h`.
        target: platform tuple, a key of `TARGETS`.

    Returns:
        The library's bytes.

    Raises:
        BuildError: no compiler was found, or it failed.
    """
    command = compiler_command()
    if "ziglang" in command:
        command += ["-target", TARGETS[target].triple]
    elif target != host_target():
        raise BuildError(f"cc builds for this machine only; install ziglang to build for {target}")
    with tempfile.TemporaryDirectory() as folder:
        work = Path(folder)
        (work / "variables.h").write_text(header, "utf-8")
        for name in (*C_FILES, *H_FILES):
            shutil.copy(SOURCES / name, work)
        output = f"motor{TARGETS[target].suffix}"
        run = subprocess.run(
            [*command, *FLAGS, f"-I{fmi_headers()}", *C_FILES, "-lm", "-o", output],
            cwd=work,
            capture_output=True,
            text=True,
            check=False,
        )
        if run.returncode:
            raise BuildError(f"the C compiler failed for {target}: {run.stderr.strip()}")
        return (work / output).read_bytes()


def fmi_headers() -> Path:
    """Folder with the header files of the FMI standards, which fmpy ships.

    Raises:
        BuildError: fmpy is not installed.
    """
    spec = importlib.util.find_spec("fmpy")
    if spec is None or spec.origin is None:
        raise BuildError("the FMI header files are missing; install fmpy (pip install fmpy)")
    return Path(spec.origin).parent / "c-code"


def _add(archive: zipfile.ZipFile, name: str, content: bytes) -> None:
    entry = zipfile.ZipInfo(name, ZIP_EPOCH)
    entry.compress_type = zipfile.ZIP_DEFLATED
    entry.external_attr = 0o644 << 16
    archive.writestr(entry, content)


@dataclass(frozen=True)
class Options:
    """Build the vibration motor FMU (FMI 3.0 Co-Simulation) for this machine."""

    out: Path
    """Folder that receives VibrationMotor.fmu; made if missing."""


def main() -> None:
    """Command line."""
    options = tyro.cli(Options, prog="python -m fmus.build", description=Options.__doc__)
    print(f"wrote {build_fmu(options.out)}")


if __name__ == "__main__":
    run_command(main)

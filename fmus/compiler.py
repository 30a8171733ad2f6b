"""Compiles the FMUs' C code into a shared library, for this machine or another.

ziglang is a C compiler for every platform that installs as an ordinary Python package; the system's
cc stands in for it, for this machine only.
"""

import functools
import importlib.metadata
import importlib.util
import os
import platform
import re
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

from cosim.base.errors import UserError
from fmus.models import STANDARDS, Fmi, Model, find

# Without contraction to fused multiply-adds every platform computes the same bits.
SAME_BITS = "-ffp-contract=off"
# Gives the standards' functions their plain names, under which shared libraries are searched.
PLAIN_NAMES: dict[Fmi, str] = {
    "2": "FMI2_OVERRIDE_FUNCTION_PREFIX",
    "3": "FMI3_OVERRIDE_FUNCTION_PREFIX",
}
# Functions that the model description does not offer have parameters that they do not use.
FLAGS = ("-std=c11", "-O3", "-g0", "-s", "-shared", "-fPIC", "-fvisibility=hidden", SAME_BITS,
         "-Wall", "-Wextra", "-Wno-unused-parameter",
         *(f"-D{name}=1" for name in PLAIN_NAMES.values()))  # fmt: skip


class Target(NamedTuple):
    """A platform to build for."""

    triple: str  # what the compiler calls it
    suffix: str  # of the names of its shared libraries


# Platform tuples of FMI 3. glibc 2.17 (2012) is older than any Linux system in support.
TARGETS = {
    "x86_64-linux": Target("x86_64-linux-gnu.2.17", ".so"),
    "aarch64-linux": Target("aarch64-linux-gnu.2.17", ".so"),
    "x86_64-windows": Target("x86_64-windows-gnu", ".dll"),
    "aarch64-windows": Target("aarch64-windows-gnu", ".dll"),
    "x86_64-darwin": Target("x86_64-macos", ".dylib"),
    "aarch64-darwin": Target("aarch64-macos", ".dylib"),
}


def host_target() -> str:
    """Platform tuple of this machine."""
    machine = platform.machine().lower()
    architecture = {"amd64": "x86_64", "arm64": "aarch64"}.get(machine, machine)
    system = {"win32": "windows"}.get(sys.platform, sys.platform)
    if (name := f"{architecture}-{system}") not in TARGETS:
        raise UserError(f"no FMU target for {name}; use a machine of {', '.join(TARGETS)}")
    return name


def compiler_command() -> list[str]:
    """Command of the C compiler: ziglang, or the system's cc where ziglang is missing."""
    if importlib.util.find_spec("ziglang"):
        return [sys.executable, "-m", "ziglang", "cc"]
    if cc := shutil.which("cc"):
        return [cc]
    raise UserError("no C compiler found; install ziglang (pip install ziglang) or a system cc")


@functools.cache
def compiler_version() -> str:
    """Name and version of the compiler that `compiler_command` gives."""
    command = compiler_command()
    if "ziglang" in command:
        return f"ziglang {importlib.metadata.version('ziglang')}"
    return subprocess.run(
        [*command, "--version"], capture_output=True, text=True, check=True
    ).stdout


def fmi_headers() -> Path:
    """Folder with the header files of the FMI standards, which fmpy ships."""
    spec = importlib.util.find_spec("fmpy")
    if spec is None or spec.origin is None:
        raise UserError("the FMI header files are missing; install fmpy (pip install fmpy)")
    return Path(spec.origin).parent / "c-code"


def unit_file(model: Model, fmi: Fmi) -> str:
    """Name of the one C file to compile for a model and standard; it includes all others."""
    return f"{model}_fmi{fmi}.c"


def source_files(model: Model, fmi: Fmi, header: str) -> dict[str, bytes]:
    """Return all sources of one FMU by their names, but the standard's headers."""
    files, names = {}, [unit_file(model, fmi)]
    for name in names:  # which grow by what the files include
        if name not in files and (path := find(model, name)):
            files[name] = path.read_bytes()
            names += re.findall(r'^#include "(.*)"', files[name].decode(), re.MULTILINE)
    return files | {"variables.h": header.encode()}


def compile_library(model: Model, header: str, target: str) -> bytes:
    """Return a shared library that has the functions of all the model's standards.

    Its bytes are the same at every build with the same compiler.
    """
    command = compiler_command()
    if "ziglang" in command:
        command += ["-target", TARGETS[target].triple]
    elif target != host_target():
        raise UserError(f"cc builds for this machine only; install ziglang to build for {target}")
    with TemporaryDirectory() as folder:
        work = Path(folder)
        for fmi in STANDARDS[model]:
            for name, content in source_files(model, fmi, header).items():
                (work / name).write_bytes(content)
        units = [unit_file(model, fmi) for fmi in STANDARDS[model]]
        output = f"{model}{TARGETS[target].suffix}"
        run_compiler([*command, *FLAGS, f"-I{fmi_headers()}", *units, "-o", output], work, target)
        return (work / output).read_bytes()


def run_compiler(command: Sequence[str], work: Path, purpose: str) -> None:
    """Run a command of the C compiler, for a purpose, in a folder in which zig keeps its cache."""
    run = subprocess.run(
        command,
        cwd=work,
        env=os.environ | {"ZIG_LOCAL_CACHE_DIR": str(work / "cache")},
        capture_output=True,
        text=True,
        check=False,
    )
    if run.returncode:
        raise UserError(f"the C compiler failed for {purpose}: {run.stderr.strip()}")

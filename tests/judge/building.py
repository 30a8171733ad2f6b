"""Builds judges that come as C sources, with the compiler and the libraries of this machine."""

import os
import re
import shutil
import subprocess
from pathlib import Path

from cosim.base.errors import UserError
from tests.judge.tools import run

# Of fmusim, in its folders fmusim/ and src/; what is only for Windows or the tests is left out.
_FMUSIM = ("fmusim/*.c", "src/FMI*.c", "src/structured_variable_name.*.c")
_LIBRARIES = ("xml2", "minizip", "z", "sundials_cvode", "sundials_nvecserial",
              "sundials_sunmatrixdense", "sundials_sunlinsoldense", "dl", "m")  # fmt: skip
_PACKAGES = "libxml2-dev, libminizip-dev, zlib1g-dev and libsundials-dev"
_TIMEOUT_S = 1800.0


def version_in(path: Path) -> str:
    """The version that a file or folder is named by, such as Reference-FMUs-0.0.39."""
    found = re.search(r"\d+(\.\d+)+", path.resolve().name)
    return found[0] if found else "of these sources"


def build_fmusim(sources: Path, folder: Path) -> Path:
    """Compile fmusim from the sources of the Reference FMUs.

    Args:
        sources: their folder.
        folder: that receives the program; made if missing.

    Raises:
        UserError: they are no such sources, or a library is missing.
    """
    files = [str(path) for pattern in _FMUSIM for path in sorted(sources.glob(pattern))]
    if not (sources / "fmusim" / "fmusim.c").is_file():
        raise UserError(f"{sources} has no fmusim/fmusim.c; name sources of the Reference FMUs")
    folder.mkdir(parents=True, exist_ok=True)
    includes = [sources / "fmusim", sources / "include", "/usr/include/libxml2"]
    command = ["cc", "-O1", "-w", f'-DFMUSIM_VERSION="{version_in(sources)}"']
    command += ["-DSUN_COMM_NULL=NULL"]  # which sundials before 7 does not have
    command += [*(f"-I{path}" for path in (*includes, "/usr/include/minizip")), *files]
    try:
        run([*command, "-o", str(folder / "fmusim"), *(f"-l{name}" for name in _LIBRARIES)])
    except (OSError, ValueError, subprocess.TimeoutExpired) as error:
        raise UserError(
            f"fmusim does not compile ({error}); on Debian install {_PACKAGES}"
        ) from error
    return folder / "fmusim"


def build_fmucheck(sources: Path, folder: Path) -> Path:
    """Compile the FMU Compliance Checker by its own build, which fetches the FMI Library with git.

    Args:
        sources: its folder.
        folder: of the build; made if missing.

    Raises:
        UserError: it does not build.
    """
    for tool in ("cmake", "make", "git"):
        if shutil.which(tool, path=os.defpath) is None:
            raise UserError(f"the FMU Compliance Checker is built with {tool}; install it")
    folder.mkdir(parents=True, exist_ok=True)
    # The system's tools: its CMake files are of 2.8, which CMake 4 of an environment is not.
    flags = {"CFLAGS": "-w -fcommon", "CXXFLAGS": "-w", "PATH": os.defpath}
    for command in (["cmake", str(sources.resolve())], ["make", "fmuCheck.linux64"]):
        done = subprocess.run(
            command,
            cwd=folder,
            env=os.environ | flags,
            capture_output=True,
            text=True,
            check=False,
            timeout=_TIMEOUT_S,
            errors="replace",
        )
        if done.returncode:
            said = " ".join(done.stderr.split())[-200:]
            raise UserError(f"the FMU Compliance Checker does not build ({said}); see {folder}")
    return folder / "fmuCheck.linux64"

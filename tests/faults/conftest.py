"""A motor FMU that goes wrong when it is told to."""

import os
import subprocess
import zipfile
from pathlib import Path

import pytest

from fmus.compiler import FLAGS, compiler_command, fmi_headers, host_target


@pytest.fixture(scope="session")
def faulty_fmu(motor_fmu, tmp_path_factory) -> Path:
    """Does what the environment variable FAULT says, from FAULT_FROM s of simulated time on."""
    folder = tmp_path_factory.mktemp("faulty")
    with zipfile.ZipFile(motor_fmu) as archive:
        archive.extractall(folder)
    (library,) = (folder / "binaries" / host_target()).iterdir()
    (unit,) = (folder / "sources").glob("*_fmi3.c")
    subprocess.run(
        [*compiler_command(), *FLAGS, f"-I{fmi_headers()}", f"-I{unit.parent}",
         f'-DSOUND="{unit.name}"', Path(__file__).with_name("fault.c"), "-o", library],
        env=os.environ | {"ZIG_LOCAL_CACHE_DIR": str(folder / "zig")},
        check=True,
    )  # fmt: skip
    path = folder / "Faulty.fmu"
    with zipfile.ZipFile(motor_fmu) as archive, zipfile.ZipFile(path, "w") as copy:
        for name in archive.namelist():
            copy.write(folder / name, name)
    return path

"""An FMU from its sources, perhaps changed by a user."""

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import fmpy

from cosim.base.errors import UserError
from cosim.base.progress import Progress, under_way
from fmus.archive import write_archive
from fmus.compiler import PLAIN_NAMES, SAME_BITS, compiler_command, fmi_headers, run_compiler


def pack_sources(folder: Path, out: Path, progress: Progress) -> Path:
    """Compile the sources of an unpacked FMU for this machine, and return the FMU of them.

    It is written into `out`, with the name of the folder.

    Raises:
        UserError: the folder is no FMU with sources, or they cannot be compiled.
    """
    needed = "modelDescription.xml", "sources/buildDescription.xml"
    if not all((folder / name).is_file() for name in needed):
        raise UserError(
            f"{folder} is not an unpacked FMI 3.0 FMU with sources: it needs {' and '.join(needed)}"
        )
    try:
        configurations = fmpy.model_description.read_build_description(folder)
    except Exception as error:  # fmpy raises plain Exceptions and those of XML
        raise UserError(f"{folder / needed[1]}: {error}; fix it") from error
    files = {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and "binaries" not in path.relative_to(folder).parts[:1]
    }
    with under_way(progress, "compiling"):
        for configuration in configurations:
            files |= _library(folder, configuration)
    fmu = out / f"{folder.resolve().name}.fmu"
    write_archive(fmu, files)
    return fmu


def _library(folder: Path, configuration: Any) -> dict[str, bytes]:
    """Return the library of a build configuration, by its name in the archive."""
    place = folder.absolute() / "sources"
    name = f"{configuration.modelIdentifier}{fmpy.sharedLibraryExtension}"
    command = [*compiler_command(), "-O2", "-shared", "-fPIC", SAME_BITS, f"-I{fmi_headers()}"]
    command += [f"-D{PLAIN_NAMES['3']}=1", f"-I{place}"]
    for group in configuration.sourceFileSets:
        definitions = [d for d in group.preprocessorDefinitions if not d.optional]
        command += [f"-D{d.name}={d.value or ''}" for d in definitions]
        command += [f"-I{place / path}" for path in group.includeDirectories]
        command += [str(place / path) for path in group.sourceFiles]
    with TemporaryDirectory() as work:
        run_compiler([*command, "-o", name, "-lm"], Path(work), str(folder))
        return {f"binaries/{fmpy.platform_tuple}/{name}": (Path(work) / name).read_bytes()}

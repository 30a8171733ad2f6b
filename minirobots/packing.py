"""Compiles the sources of an unpacked FMU and packs it again."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

from cosim.base.errors import UserError
from cosim.base.progress import Progress, under_way

if TYPE_CHECKING:
    from fmpy.model_description import BuildConfiguration


def pack(folder: Path, out: Path, progress: Progress) -> dict[str, Any]:
    """Compile the sources of an unpacked FMU for this machine, and pack it again.

    Args:
        folder: of the unpacked FMU.
        out: FMU to write.
        progress: receives that it is compiled.

    Returns:
        The FMU, and its inputs and outputs.

    Raises:
        UserError: the folder is no unpacked FMI 3.0 FMU with sources, the compiler failed, or the
            result is no valid FMU.
    """
    import fmpy

    from cosim.fmi.fmu import Fmu
    from fmus.archive import write_archive

    try:
        configurations = fmpy.model_description.read_build_description(folder)
    except Exception as error:  # fmpy raises plain Exceptions and those of XML
        raise UserError(f"{folder}/sources/buildDescription.xml: {error}; fix it") from error
    if not configurations or not (folder / "modelDescription.xml").is_file():
        raise UserError(
            f"{folder} is not an unpacked FMI 3.0 FMU with sources: it needs "
            "modelDescription.xml and sources/buildDescription.xml"
        )
    files = {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and "binaries" not in path.relative_to(folder).parts[:1]
    }
    with under_way(progress, "compiling"):
        for configuration in configurations:
            files |= _binary(folder, configuration)
    write_archive(out, files)
    fmu = Fmu(out)
    return {"fmu": str(out), "inputs": _names(fmu, "input"), "outputs": _names(fmu, "output")}


def _names(fmu: Any, causality: str) -> list[str]:
    return [name for name, variable in fmu.variables.items() if variable.causality == causality]


def _binary(folder: Path, configuration: "BuildConfiguration") -> dict[str, bytes]:
    """Return the library of a build configuration, by its name in the archive."""
    import fmpy

    from cosim.base.storage import temporary_folder
    from fmus.compiler import PLAIN_NAMES, SAME_BITS, compiler_command, fmi_headers, run_compiler

    place = folder.absolute() / "sources"
    name = f"{configuration.modelIdentifier}{fmpy.sharedLibraryExtension}"
    command = [*compiler_command(), "-O2", "-shared", "-fPIC", SAME_BITS, f"-I{fmi_headers()}"]
    command += [f"-D{PLAIN_NAMES['3']}=1", f"-I{place}"]
    for group in configuration.sourceFileSets:
        definitions = [d for d in group.preprocessorDefinitions if not d.optional]
        command += [f"-D{d.name}={d.value or ''}" for d in definitions]
        command += [f"-I{place / path}" for path in group.includeDirectories]
        command += [str(place / path) for path in group.sourceFiles]
    with temporary_folder() as work:
        run_compiler([*command, "-o", name, "-lm"], Path(work), str(folder))
        return {f"binaries/{fmpy.platform_tuple}/{name}": (Path(work) / name).read_bytes()}

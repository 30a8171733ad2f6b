"""Build motors as FMUs for other tools, or an FMU from its sources."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from cosim.base.errors import UserError
from cosim.base.progress import Progress, under_way
from fmus.compiler import TARGETS
from fmus.models import MODELS, STANDARDS, Fmi, Model
from minirobots.options import CommandOptions, Folder

if TYPE_CHECKING:
    TargetChoice = str
else:
    TargetChoice = tyro.extras.literal_type_from_choices(("host", "all", *TARGETS))
What = Literal["motor", "motors"]
SHORT_NAMES: dict[What, Model] = {"motor": "VibrationMotor", "motors": "VibrationMotors"}


class Build(CommandOptions):
    """Build FMUs of one vibration motor and of an array of motors, which needs FMI 3.0.

    Without --fmi FMI 3.0 FMUs are written under the models' names, which the co-simulation uses;
    with --fmi the names include the standard, as in VibrationMotor_fmi2.fmu.

    With --sources the sources of an unpacked FMU, perhaps changed, are compiled for this machine,
    and the FMU is packed again: get such a folder by `minirobots fmu motor --out .` and `python -m
    zipfile -e VibrationMotor.fmu my_motor`. docs/own.md is a guide. Binaries of other platforms are
    left out.
    """

    what: Annotated[
        tyro.conf.Positional[tuple[What, ...]], tyro.conf.arg(metavar="{motor,motors}")
    ] = ()
    """What to build: models by their short names."""
    out: Folder
    """Folder that receives the files; made if missing."""
    model: tuple[Model, ...] = MODELS
    """Models to build if no model is named."""
    fmi: Literal["2", "3", "both"] | None = None
    """FMI standard to build for."""
    targets: tuple[TargetChoice, ...] = ("host",)
    """Platforms with binaries in the archive. A first build for Windows takes about a
    minute, every other build seconds."""

    sources: Folder | None = None
    """Folder of an unpacked FMI 3.0 FMU with sources/buildDescription.xml, to compile and pack as
    an FMU of the folder's name."""

    def __post_init__(self) -> None:
        super().__post_init__()
        others = self.what, self.fmi, self.model != MODELS, self.targets != ("host",)
        if self.sources and any(others):
            raise UserError("--sources is compiled for this machine only; leave other options out")
        if self.what and self.model != MODELS:
            raise UserError("--model has no effect where models are named first; leave one out")
        if self.fmi == "2" and self.models == ("VibrationMotors",):
            raise UserError("FMI 2 has no arrays, which VibrationMotors needs; use --fmi 3")

    @property
    def models(self) -> tuple[Model, ...]:
        """Requested models."""
        return tuple(SHORT_NAMES[name] for name in self.what) or self.model


def _paths(options: Build, model: Model) -> dict[Fmi, Path]:
    """File to write for each requested and possible standard."""
    if options.fmi is None:
        return {"3": options.out / f"{model}.fmu"}
    return {
        fmi: options.out / f"{model}_fmi{fmi}.fmu"
        for fmi in STANDARDS[model]
        if options.fmi in (fmi, "both")
    }


def run(options: Build, progress: Progress) -> dict[str, Any]:
    """Build the requested models, or pack the sources."""
    if options.sources:
        name = options.sources.resolve().name
        return _pack(options.sources, options.out / f"{name}.fmu", progress)
    from fmus.build import build_fmus
    from fmus.compiler import host_target

    targets: dict[str, None] = {}
    for choice in options.targets:
        names = TARGETS if choice == "all" else [host_target() if choice == "host" else choice]
        targets |= dict.fromkeys(names)
    files: list[Path] = []
    for model in options.models:
        if paths := _paths(options, model):
            files += build_fmus(paths, list(targets), progress, model)
    return {"files": [str(file) for file in files]}


def _pack(folder: Path, out: Path, progress: Progress) -> dict[str, Any]:
    """Compile the sources of an unpacked FMU for this machine, and pack it again.

    Returns:
        The FMU, and its inputs and outputs.
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
            files |= _library(folder, configuration)
    write_archive(out, files)
    variables = Fmu(out).variables.items()
    found = {kind: [n for n, v in variables if v.causality == kind] for kind in ("input", "output")}
    return {"fmu": str(out), "inputs": found["input"], "outputs": found["output"]}


def _library(folder: Path, configuration: Any) -> dict[str, bytes]:
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

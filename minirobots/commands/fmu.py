"""Build motors as FMUs for other tools, or an FMU from its sources."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from cosim.base.errors import UserError
from cosim.base.progress import Progress
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
        from minirobots.packing import pack

        name = options.sources.resolve().name
        return pack(options.sources, options.out / f"{name}.fmu", progress)
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

"""Builds archives of systems: of SSP 1.0 with FMUs of FMI 2.0, and of SSP 2.0 with FMI 3.0."""

from collections.abc import Sequence
from pathlib import Path

from cosim.base.progress import Progress, silent
from cosim.base.storage import temporary_folder
from fmus.archive import write_archive
from fmus.build import build_fmus
from fmus.compiler import host_target
from fmus.models import MODELS, Fmi, Model
from fmus.ssp.description import FMI, Ssp, render_ssd, render_ssv
from fmus.ssp.system import SspSystem, robots_with_motors

VALUES = "resources/parameters.ssv"


def build_ssp(
    out_dir: Path,
    versions: Sequence[Ssp] = ("1.0", "2.0"),
    system: SspSystem | None = None,
    targets: Sequence[str] = (),
    progress: Progress = silent,
) -> list[Path]:
    """Build a system's archives.

    Args:
        out_dir: folder that receives them; made if missing.
        versions: of SSP.
        system: by default two robots with their motors.
        targets: platforms, by default this one.
        progress: is told of every platform.

    Returns:
        The archives, which have the system's name and the number of the version.

    Raises:
        BuildError: no compiler was found, it failed, or it cannot build for a target.
        OSError: the folder cannot be written.
    """
    system = system or robots_with_motors()
    used = {component.model for component in system.components}
    models: list[Model] = [model for model in MODELS if model in used]
    sources: dict[Model, str] = {model: f"resources/{model}.fmu" for model in models}
    written = []
    with temporary_folder() as folder:
        built: dict[Model, dict[Fmi, Path]] = {}
        for model in models:
            standards: list[Fmi] = [FMI[version] for version in versions]
            built[model] = {fmi: Path(folder) / f"{model}{fmi}.fmu" for fmi in standards}
            build_fmus(built[model], targets or [host_target()], progress, model)
        for version in versions:
            files = {"SystemStructure.ssd": render_ssd(system, version, sources)}
            files[VALUES] = render_ssv(system, version)
            for model, place in sources.items():
                files[place] = built[model][FMI[version]].read_bytes()
            written.append(out_dir / f"{system.name}_ssp{version[0]}.ssp")
            write_archive(written[-1], files)
    return written

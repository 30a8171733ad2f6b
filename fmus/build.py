"""Builds the FMUs: renders their tables, has their C code compiled and packs the archives.

`python -m fmus.build --out DIR` writes the FMUs; `cached_fmu` gives the co-simulation one: that of
the wheel, or one that is built on first use. Numerical work is in C files like
`vibration_motor/motor.h`.
"""

import hashlib
import uuid
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from cosim.base.command import Json, parse, print_json
from cosim.base.errors import run_command
from cosim.base.progress import Progress, progress_bars, silent
from cosim.base.provenance import digest_of
from cosim.base.storage import cache_dir, cached
from fmus.archive import binaries, write_archive
from fmus.companions import render_build_description, render_terminals
from fmus.compiler import (
    FLAGS,
    TARGETS,
    BuildError,
    compile_library,
    compiler_version,
    host_target,
    source_files,
)
from fmus.description import render_fmi2, render_fmi3
from fmus.documentation import render_html
from fmus.models import MODELS, ROOT, STANDARDS, Fmi, Model, folders, read_bytes
from fmus.origin import license_text, read_origin
from fmus.references import reference_files
from fmus.variables import Table, load_table, render_header

__all__ = ["BuildError", "build_fmu", "build_fmus", "cached_fmu"]

SHORT_NAMES: dict[str, Model] = {
    "motor": "VibrationMotor",
    "motors": "VibrationMotors",
    "robot": "MiniRobot",
}


CARRIED = Path("fmus/built")  # folder of FMUs in a wheel


def build_fmu(
    out_dir: Path, model: Model = "VibrationMotor", targets: Sequence[str] | None = None
) -> Path:
    """Build a model's FMI 3.0 FMU.

    Args:
        out_dir: folder that receives the FMU, which has the model's name; made if missing.
        model: what the FMU is of.
        targets: platforms, keys of `fmus.compiler.TARGETS`; by default this machine's.

    Returns:
        Path of the FMU; the file appears whole or not at all.

    Raises:
        BuildError: no compiler was found, or it failed.
        OSError: the folder cannot be written.
    """
    return build_fmus({"3": out_dir / f"{model}.fmu"}, targets or [host_target()], model=model)[0]


def build_fmus(
    paths: Mapping[Fmi, Path],
    targets: Sequence[str],
    progress: Progress = silent,
    model: Model = "VibrationMotor",
) -> list[Path]:
    """Build a model's FMUs from one set of binaries.

    Args:
        paths: file to write for each FMI standard; folders are made if missing.
        targets: platforms, keys of `fmus.compiler.TARGETS`.
        progress: is told of every platform.
        model: what the FMU is of.

    Returns:
        The paths, in the same order; each file appears whole or not at all.

    Raises:
        BuildError: no compiler was found, it failed, or it cannot build for a target.
        OSError: a folder cannot be written.
    """
    table = load_table(model)
    token = instantiation_token(table)
    header = render_header(table, token)
    libraries = {}
    for target in targets:
        progress("compiling", len(libraries), len(targets), target)
        libraries[target] = compile_library(model, header, target)
    progress("compiling", len(libraries), len(targets))
    origin = read_origin()
    documentation = {
        "documentation/index.html": render_html(table),
        "documentation/licenses/license.txt": license_text().encode(),
    }
    icon = read_bytes(model, "icon.png")
    for fmi, path in paths.items():
        if fmi == "2":
            files = {"modelDescription.xml": render_fmi2(table, token, origin), "model.png": icon}
        else:
            files = {
                "modelDescription.xml": render_fmi3(table, token, origin),
                "terminalsAndIcons/terminalsAndIcons.xml": render_terminals(table),
                "terminalsAndIcons/icon.png": icon,
            }
        sources = source_files(model, fmi, header)
        sources["buildDescription.xml"] = render_build_description(table, fmi)
        files |= binaries(fmi, table.name, libraries) | documentation | reference_files(model)
        write_archive(path, files | {f"sources/{name}": sources[name] for name in sources})
    return list(paths.values())


def cached_fmu(model: Model = "VibrationMotors") -> Path:
    """A model's FMI 3.0 FMU: that of the wheel, or one that is built into the cache on first use.

    The cache's key is a hash of sources, rendered defaults, flags and compiler version. The file's
    own hash stands beside it: a file that was damaged is built again.

    Args:
        model: what the FMU is of; the co-simulation uses the array of motors.

    Raises:
        BuildError: no compiler was found, or it failed.
        OSError: the cache cannot be written.
    """
    carried = ROOT.parent / CARRIED / f"{model}.fmu"
    if carried.is_file():
        return carried
    token = instantiation_token(load_table(model))
    key = digest_of(token, host_target(), FLAGS, compiler_version())
    path = cache_dir("fmus") / key / f"{model}.fmu"
    return cached(path, lambda path: path, lambda: path, lambda _, at: build_fmu(at.parent, model))


def is_built_in(path: Path) -> bool:
    """Whether a file is one that `cached_fmu` returns."""
    return path.parent == ROOT.parent / CARRIED or cache_dir("fmus") in path.parents


def instantiation_token(table: Table) -> str:
    """Token that ties model description and binary: a hash of everything they are made from."""
    digest = hashlib.sha256(f"{table!r}{read_origin()}{license_text()}".encode())
    suffixes = {".c", ".csv", ".h", ".html", ".mo", ".png"}
    files = [path for folder in folders(table.name) for path in folder.iterdir()]
    inputs = [path for path in files if path.suffix in suffixes]
    for path in sorted([*inputs, *ROOT.glob("*.py")]):
        digest.update(path.name.encode() + b"\0" + path.read_bytes())
    return f"{{{uuid.UUID(bytes=digest.digest()[:16])}}}"


TargetChoice = Literal[
    "host",
    "all",
    "x86_64-linux",
    "aarch64-linux",
    "x86_64-windows",
    "aarch64-windows",
    "x86_64-darwin",
    "aarch64-darwin",
]


What = Literal["motor", "motors", "robot", "ssp"]


@dataclass(frozen=True, kw_only=True)
class Build:
    """Build FMUs: of one vibration motor, of an array of motors, of a robot; or a system of them.

    VibrationMotor offers co-simulation and Model Exchange, MiniRobot co-simulation, and so does
    VibrationMotors, which needs FMI 3.0. Without --fmi FMI 3.0 FMUs are written under the models'
    names, which the co-simulation uses; with --fmi the names tell the standard, as in
    VibrationMotor_fmi2.fmu.
    """

    what: Annotated[
        tyro.conf.Positional[tuple[What, ...]], tyro.conf.arg(metavar="{motor,motors,robot,ssp}")
    ] = ()
    """What to build: models by their short names, or ssp, two robots with their motors as archives
    of SSP 1.0 (FMI 2.0) and 2.0 (FMI 3.0)."""
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")]
    """Folder that receives the files; made if missing."""
    model: tuple[Model, ...] = MODELS
    """Models to build where nothing is named."""
    fmi: Literal["2", "3", "both"] | None = None
    """FMI standard to build for."""
    targets: tuple[TargetChoice, ...] = ("host",)
    """Platforms whose binaries go into the archive. A first build for Windows takes about a
    minute, every other build seconds."""
    json: Json = False

    @property
    def models(self) -> tuple[Model, ...]:
        """Models that are asked for."""
        if not self.what:
            return self.model
        return tuple(SHORT_NAMES[name] for name in self.what if name != "ssp")


def _paths(options: Build, model: Model) -> dict[Fmi, Path]:
    """File to write for each standard that is asked for and can be had."""
    if options.fmi is None:
        return {"3": options.out / f"{model}.fmu"}
    return {
        fmi: options.out / f"{model}_fmi{fmi}.fmu"
        for fmi in STANDARDS[model]
        if options.fmi in (fmi, "both")
    }


def main() -> None:
    """Command line; see `Build`."""
    options = parse(Build, "fmus.build")
    targets: dict[str, None] = {}
    for choice in options.targets:
        names = TARGETS if choice == "all" else [host_target() if choice == "host" else choice]
        targets |= dict.fromkeys(names)
    if options.what and options.model != MODELS:
        raise BuildError("--model has no effect beside what is named first; leave one of them out")
    if options.what == ("ssp",) and options.fmi is not None:
        raise BuildError("--fmi has no effect on ssp, which has an archive for each; leave it out")
    if options.fmi == "2" and options.models == ("VibrationMotors",):
        raise BuildError("FMI 2 has no arrays, which VibrationMotors needs; use --fmi 3")
    files: list[Path] = []
    with progress_bars() as progress:
        for model in options.models:
            if paths := _paths(options, model):
                files += build_fmus(paths, list(targets), progress, model)
        if "ssp" in options.what:
            from fmus.ssp.archive import build_ssp  # noqa: PLC0415

            files += build_ssp(options.out, targets=list(targets), progress=progress)
    for file in files:
        print(f"wrote {file}")
    if options.json:
        print_json({"files": list(map(str, files))})


if __name__ == "__main__":
    run_command(main)

"""Builds the FMUs: renders their descriptions, has their C code compiled and packs the archives.

The command is `minirobots fmu`; `cached_fmu` gives the co-simulation one:
that of the wheel, or one that is built on first use. Numerical work is in C files like
`vibration_motor/motor.h`.
"""

import functools
import hashlib
import re
import uuid
from collections.abc import Mapping, Sequence
from pathlib import Path

from cosim.base.errors import UserError
from cosim.base.progress import Progress, silent
from cosim.base.provenance import digest_of
from cosim.base.storage import cache_dir, cached
from fmus.archive import binaries, write_archive
from fmus.compiler import FLAGS, compile_library, compiler_version, host_target, source_files
from fmus.description import (
    license_text,
    read_origin,
    render_build_description,
    render_description,
    render_header,
    render_html,
)
from fmus.models import MODELS, ROOT, Fmi, Model, folders

__all__ = ["UserError", "build_fmu", "build_fmus", "cached_fmu"]

CARRIED = Path("fmus/built")  # folder of FMUs in a wheel
_CARRIED = ROOT.parent / CARRIED
_COMMENT = re.compile(r"/\*.*?\*/|//[^\n]*", re.DOTALL)


def build_fmu(out_dir: Path, model: Model = "VibrationMotor") -> Path:
    """Build a model's FMI 3.0 FMU for this machine, in a folder that is made if missing."""
    return build_fmus({"3": out_dir / f"{model}.fmu"}, [host_target()], model=model)[0]


def build_fmus(
    paths: Mapping[Fmi, Path],
    targets: Sequence[str],
    progress: Progress = silent,
    model: Model = "VibrationMotor",
) -> list[Path]:
    """Build a model's FMUs from one set of binaries.

    Args:
        paths: file to write for each FMI standard; folders are made if missing.

    Returns:
        The paths, in the same order; each file appears whole or not at all.

    Raises:
        UserError: no compiler was found, it failed, or it cannot build for a target.
    """
    token = instantiation_token(model)
    header = render_header(model, token)
    libraries = {}
    for target in targets:
        progress("compiling", len(libraries), len(targets), target)
        libraries[target] = compile_library(model, header, target)
    progress("compiling", len(libraries), len(targets))
    for fmi, path in paths.items():
        sources = source_files(model, fmi, header)
        sources["buildDescription.xml"] = render_build_description(model, fmi)
        files = {
            "modelDescription.xml": render_description(model, fmi, token),
            **binaries(fmi, model, libraries),
            "documentation/index.html": render_html(model),
            "documentation/licenses/license.txt": license_text().encode(),
            **{f"sources/{name}": content for name, content in sources.items()},
        }
        write_archive(path, files)
    return list(paths.values())


def cached_fmu(model: Model = "VibrationMotors") -> Path:
    """A model's FMI 3.0 FMU: that of the wheel, or one that is built into the cache on first use.

    The cache's key is a hash of sources, rendered defaults, flags and compiler version. The file's
    own hash is kept next to it: a file that was damaged is built again. The co-simulation uses the
    array of motors.
    """
    path = _place(model)
    if path.parent == _CARRIED:
        return path
    return cached(path, lambda path: path, lambda: path, lambda _, at: build_fmu(at.parent, model))


def _place(model: Model) -> Path:
    """Return where a model's FMU is, or is to be."""
    carried = _CARRIED / f"{model}.fmu"
    if carried.is_file():
        return carried
    token = instantiation_token(model)
    key = digest_of(token, host_target(), FLAGS, compiler_version())
    return cache_dir("fmus") / key / f"{model}.fmu"


def identity_of_fmu(path: Path) -> str:
    """Return the hash (16 hex digits) of what determines an FMU's behaviour.

    Of a built-in FMU these are its C code, the defaults in its header and the compiler's flags:
    they give the same bits on every platform (`SAME_BITS`; `tests/test_packaged.py` compares
    bits), while the bytes of binaries differ. Any other FMU is known by its bytes.
    """
    model = built_in_model(path)
    return digest_of(path) if model is None else digest_of_sources(model)


@functools.cache
def digest_of_sources(model: Model) -> str:
    """Return the hash of a model's C code, without comments and layout."""
    files = source_files(model, "3", render_header(model, "")).items()
    code = {name: _COMMENT.sub("", text.decode()).split() for name, text in files}
    return digest_of(code, FLAGS)


def built_in_model(path: Path) -> Model | None:
    """Return the model of a file that `cached_fmu` returns; None for any other file."""
    return _model_at(path, cache_dir("fmus"))


@functools.cache
def _model_at(path: Path, cache: Path) -> Model | None:
    if path.parent != _CARRIED and path.parent.parent != cache:
        return None
    return next((m for m in MODELS if path.stem == m and path == _place(m)), None)


def instantiation_token(model: Model) -> str:
    """Token that ties model description and binary: a hash of everything they are made from."""
    digest = hashlib.sha256(f"{read_origin()}{license_text()}".encode())
    suffixes = {".c", ".h", ".html", ".xml"}
    files = [path for folder in folders(model) for path in folder.iterdir()]
    inputs = [path for path in files if path.suffix in suffixes]
    for path in sorted([*inputs, *ROOT.glob("*.py")]):
        digest.update(path.name.encode() + b"\0" + path.read_bytes())
    return f"{{{uuid.UUID(bytes=digest.digest()[:16])}}}"

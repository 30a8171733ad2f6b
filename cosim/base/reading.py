"""Files read back: their content, or a one-line error that names the fault.

Whatever a file is (missing, a folder, a device, cut off, bits flipped, made by another program),
reading it ends in a FileError. Memory is taken for what the file holds, not for what it
claimed.
"""

import contextlib
import io
import os
import stat
import tomllib
import zipfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np

from cosim.base.errors import FileError, UserError

# Far above what is written here, far below what fills the memory.
MAX_TEXT_BYTES = 2**26
MAX_ARRAY_BYTES = 2**31  # all that are read of a file together, unpacked
_LFS = b"version https://git-lfs.github.com/"


class Kind(NamedTuple):
    """A kind of file that is read."""

    name: str  # what messages call it, such as "policy file"
    fix: str  # what to do if it cannot be read, such as "train it again"


def require_file(path: Path, kind: Kind) -> None:
    """Refuse a path that is not a file."""
    try:
        mode = path.stat().st_mode
    except (FileNotFoundError, NotADirectoryError, ValueError):  # no name has a NUL
        raise FileError(f"{path}: no such {kind.name}; {kind.fix}") from None
    except OSError as error:
        raise FileError(f"{path}: {error.strerror}; {kind.fix}") from error
    if not stat.S_ISREG(mode):
        what = "folder" if stat.S_ISDIR(mode) else "device or a pipe"
        raise FileError(f"{path}: a {what}, no {kind.name}; {kind.fix}")
    if not os.access(path, os.R_OK):
        raise FileError(f"{path}: you may not read it; change its permissions or {kind.fix}")
    refuse_pointer(path)


def refuse_pointer(path: Path) -> None:
    """Refuse a file that only points to one in Git LFS; raises FileError."""
    with path.open("rb") as file:
        if file.read(len(_LFS)) == _LFS:
            raise FileError(f"{path}: a pointer of Git LFS, not the file; run `git lfs pull`")


@contextlib.contextmanager
def parsing(path: Path, kind: Kind) -> Iterator[None]:
    """Report any failure inside as a fault of the file's content."""
    try:
        yield
    except FileError:
        raise
    except Exception as error:
        reason = f"lacks {error}" if isinstance(error, KeyError) else error or type(error).__name__
        raise FileError(f"{path}: not a {kind.name} or damaged ({reason}); {kind.fix}") from error


@contextlib.contextmanager
def naming(path: Path) -> Iterator[None]:
    """Name the file in messages about what it says."""
    try:
        yield
    except UserError as error:
        raise UserError(f"{path}: {error}") from None


def read_bytes(path: Path, kind: Kind) -> bytes:
    """Content of a file."""
    require_file(path, kind)
    with parsing(path, kind):
        if path.stat().st_size > MAX_TEXT_BYTES:
            raise ValueError(f"it is larger than {MAX_TEXT_BYTES >> 20} MiB")
        return path.read_bytes()


def read_json(path: Path, kind: Kind, form: Any = Any) -> Any:
    """Value of a JSON file."""
    content = read_bytes(path, kind)
    with parsing(path, kind):
        return msgspec.json.decode(content, type=form)


def read_toml(path: Path, kind: Kind) -> dict[str, Any]:
    """Tables of a TOML file, which users write: errors name the line."""
    content = read_bytes(path, kind)
    try:
        return tomllib.loads(content.decode("utf-8-sig"))  # Windows editors begin files with a mark
    except (ValueError, RecursionError) as error:
        raise FileError(f"{path}: not a TOML file ({error}); fix that line") from error


def read_arrays(path: Path, kind: Kind, names: Sequence[str]) -> dict[str, np.ndarray]:
    """Arrays of an `.npz` file by name, writable; their checksums are compared."""
    require_file(path, kind)
    with parsing(path, kind), zipfile.ZipFile(path) as archive:
        members = {info.filename.removesuffix(".npy"): info for info in archive.infolist()}
        if sum(members[name].file_size for name in names) > MAX_ARRAY_BYTES:
            raise ValueError(f"it unpacks to more than {MAX_ARRAY_BYTES >> 20} MiB")
        return {name: _array(archive.read(members[name])) for name in names}


def _array(content: bytes) -> np.ndarray:
    stream = io.BytesIO(content)
    array = np.lib.format.read_array(stream, allow_pickle=False)
    if stream.read(1):
        raise ValueError("an array has another size than it says")
    return array

"""The cache, which repairs itself, and writing that leaves a whole file or none."""

import contextlib
import glob
import hashlib
import logging
import os
import re
import secrets
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import IO, Any, BinaryIO, TypeVar

import msgspec
import numpy as np
from filelock import FileLock

from cosim.base.arguments import validate_argument
from cosim.base.errors import FileError

try:
    import fcntl
except ImportError:  # Windows, where open files cannot be removed
    fcntl = None

_LOGGER = logging.getLogger(__name__)
Value = TypeVar("Value")
CACHE = "MINIROBOTS_CACHE"  # environment variable with another folder of the cache
PACKAGED = Path(__file__).parents[1] / "packaged"  # results of the default configuration, by kind


def cache_dir(kind: str) -> Path:
    """Folder for cached results of one kind ("fmus", "policies"), created if missing.

    `MINIROBOTS_CACHE` overrides the user's cache folder, `minirobots` in `$XDG_CACHE_HOME` or
    `~/.cache`. A folder that cannot be made is named where something is to be written to it.
    """
    users = os.path.expanduser(os.environ.get("XDG_CACHE_HOME") or "~/.cache")  # noqa: PTH111
    # Without a home folder ~ stays as it is, and Path.expanduser fails.
    folder = Path(os.environ.get(CACHE) or Path("/", users, "minirobots")).absolute() / kind
    with contextlib.suppress(OSError):
        folder.mkdir(parents=True, exist_ok=True)
    return folder


def lock_of(path: Path) -> FileLock:
    """Return the lock of a cached file or folder between processes; raises FileError."""
    with contextlib.suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
    require_cache(path.parent)
    return FileLock(path.with_name(f".{path.name}.lock"))


def require_cache(folder: Path) -> None:
    """Refuse a folder of the cache where nothing can be written; raises FileError."""
    if not os.access(folder, os.W_OK):
        raise FileError(
            f"{folder}: the cache cannot be written; set {CACHE} to a folder that can be"
        )


def require_programs(folder: Path) -> None:
    """Refuse a folder of the cache from which no machine code can be loaded; raises FileError."""
    flag = getattr(os, "ST_NOEXEC", 0)  # of Linux
    if flag and os.statvfs(folder).f_flag & flag:
        raise FileError(
            f"{folder}: its file system is mounted with noexec, so that no FMU can be loaded from "
            f"the cache; set {CACHE} to a folder of another file system"
        )


def lock_open(file: int | IO[bytes], *, wait: bool = True) -> None:
    """Lock an open file or folder until it is closed; on Windows do nothing."""
    if fcntl is not None:
        fcntl.flock(file, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))


def lock_alone(file: int | IO[bytes], path: Path) -> None:
    """Lock an open file or folder, where its file system has locks; FileError if another has it."""
    with contextlib.suppress(OSError):
        try:
            lock_open(file, wait=False)
        except BlockingIOError:
            raise FileError(
                f"{path}: another run writes to it; wait until that ends, or choose another --out"
            ) from None


@contextlib.contextmanager
def lock_folder(folder: Path) -> Iterator[None]:
    """Make a folder if it is missing, and keep other runs out of it until the end; or FileError."""
    folder.mkdir(parents=True, exist_ok=True)
    with contextlib.ExitStack() as stack:
        if fcntl is not None:
            handle = os.open(folder, os.O_RDONLY)
            stack.callback(os.close, handle)
            lock_alone(handle, folder)
        yield


def new_folder(path: Path) -> Path:
    """Make a folder of this name, if there is none; else one with -2, -3 and so on after it."""
    made, number = path, 1
    while True:
        with contextlib.suppress(FileExistsError):
            made.mkdir(parents=True)
            return made
        number += 1
        made = path.with_name(f"{path.name}-{number}")


def load_or_create(
    path: Path, load: Callable[[], Value | None], make: Callable[[], Value]
) -> Value:
    """Return what the cache has at `path`, or make it: in one process, while others wait for it.

    `load` returns None if it is missing or damaged.
    """
    if (found := load()) is not None:
        return found
    with lock_of(path):
        found = load()  # another process may have made it meanwhile
        return make() if found is None else found


def cached(
    path: Path,
    load: Callable[[Path], Value | None],
    make: Callable[[], Value],
    save: Callable[[Value, Path], object],
    *,
    again: bool = False,
) -> Value:
    """Return the content of a file of the cache or `PACKAGED`; make it if missing or damaged.

    The file's SHA-256 is kept next to it. `load` returns None of a file that is another one's.
    """
    require_no_folder(path)

    def remake() -> Value:
        if path.exists() and not again:
            _LOGGER.warning("%s is corrupted: rebuilding it", path)
        value = make()
        save(value, path)
        write_checksum(path)
        return value

    places = () if again else (path, PACKAGED / path.parent.name / path.name)

    def find() -> Value | None:
        found = (load(place) for place in places if is_intact(place))
        return next((value for value in found if value is not None), None)

    return load_or_create(path, find, remake)


def write_checksum(path: Path) -> None:
    """Keep the SHA-256 of a file next to it, for `is_intact`."""
    write_whole(path.with_name(f"{path.name}.sha256"), _sha256(path))


def is_intact(path: Path) -> bool:
    """Return whether a file exists and has its checksum."""
    try:
        return path.with_name(f"{path.name}.sha256").read_bytes() == _sha256(path).encode()
    except OSError:
        return False


def _sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def require_no_folder(path: Path) -> None:
    """Refuse a folder where a file is to be; raises FileError."""
    if path.is_dir():
        raise FileError(f"{path}: a folder is where this file goes; move it away")


@contextlib.contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yield a temporary path next to `path`; rename it to `path` on success, remove it on failure.

    Readers see the old file or the whole new one, also when two processes write at once. What a
    killed process left of its temporary file is removed by the next one that writes the same.
    """
    require_no_folder(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    _sweep(path)
    lock, temporary = _temporary(path)
    try:
        yield temporary
        if os.name == "nt":
            lock.close()  # open files cannot be renamed there
        temporary.replace(path)
    except OSError as error:
        if error.filename in {None, str(temporary)}:  # None as of a write
            error.filename, error.filename2 = str(path), None
        raise
    finally:
        lock.close()
        temporary.unlink(missing_ok=True)


PICTURE = ".png", ".pdf", ".svg"  # endings of pictures to write


def require_suffix(path: Path | str, *endings: str) -> Path:
    """Return the path of a file to write; programs find its kind by its ending, one of these."""
    file: Path = validate_argument("path", path, Path)
    if file.suffix not in endings:
        choice = f"its name must end in {' or '.join(endings)}"
        raise FileError(f"{file}: {choice}; choose {file.stem}{endings[0]}")
    return file


def json_text(content: Any) -> bytes:
    """Encode as JSON for people and programs: indented, but lists of numbers on one line."""
    text = msgspec.json.format(msgspec.json.encode(content), indent=1)
    return re.sub(rb"\[\n[-+.\deE,\s\[\]]*\]", lambda found: b"".join(found[0].split()), text)


def write_json(path: Path, content: Any) -> None:
    """Write what `msgspec` can encode as JSON for people and programs, whole or not at all."""
    write_whole(path, json_text(content) + b"\n")


def write_arrays(path: Path, arrays: Mapping[str, Any]) -> None:
    """Write arrays by name as `.npz`, whole or not at all; `read_arrays` reads them."""
    with replacing(path) as temporary, temporary.open("wb") as file:
        np.savez_compressed(file, **arrays)


def write_whole(path: Path, content: str | bytes) -> None:
    """Write a text in UTF-8, or bytes, whole or not at all; see `replacing`."""
    with replacing(path) as temporary:
        temporary.write_bytes(content.encode() if isinstance(content, str) else content)


def _temporary(path: Path) -> tuple[BinaryIO, Path]:
    """A new file next to `path`, locked as long as the process lives or until it is closed."""
    while True:
        name = path.with_name(f"{_beginning(path)}{secrets.token_hex(4)}{path.suffix}")
        try:  # not by tempfile: other users may not read its files under any umask
            handle = os.open(name, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o666)
        except FileExistsError:
            continue
        with contextlib.suppress(OSError):  # of a file system without locks: nothing is swept there
            lock_open(handle)
        if os.fstat(handle).st_nlink:
            return os.fdopen(handle, "rb"), name
        os.close(handle)  # swept before it was locked


def _sweep(path: Path) -> None:
    """Remove temporary files of `path` that no process holds."""
    for name in path.parent.glob(f"{glob.escape(_beginning(path))}*{glob.escape(path.suffix)}"):
        with contextlib.suppress(OSError), name.open("rb") as file:
            lock_open(file, wait=False)
            name.unlink()


def _beginning(path: Path) -> str:
    return f".{path.stem[:40]}.tmp-"  # not longer than what the file system allows for `path`

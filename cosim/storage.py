"""Where files go: the cache folder, what is made there once, and writing whole files or none."""

import contextlib
import os
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TypeVar

import platformdirs
from filelock import FileLock

Found = TypeVar("Found")


def cache_dir(kind: str) -> Path:
    """Folder for cached results of one kind ("fmus", "policies"), created if missing.

    `MINIROBOTS_CACHE` overrides the user's cache folder.
    """
    root = os.environ.get("MINIROBOTS_CACHE") or platformdirs.user_cache_dir("minirobots")
    folder = Path(root) / kind
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def lock_of(path: Path) -> FileLock:
    """Lock of a cached file or folder between processes, to be entered; ends with its process.

    Raises:
        OSError: the folder cannot be written.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    return FileLock(path.with_name(f".{path.name}.lock"))


def found_or_made(path: Path, load: Callable[[], Found | None], make: Callable[[], Found]) -> Found:
    """What the cache has at `path`, or what is made now: by one process, while others wait for it.

    Args:
        path: of the cached file or folder.
        load: reads it; None if it is missing or damaged.
        make: makes and writes it.

    Raises:
        OSError: the cache cannot be written.
    """
    found = load()
    if found is None:
        with lock_of(path):
            found = load()  # another process may have made it meanwhile
            if found is None:
                found = make()
    return found


@contextlib.contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yield a temporary path beside `path`; rename it to `path` on success, remove it on failure.

    Readers see the old file or the whole new one, also when two processes write at once.

    Raises:
        OSError: the folder cannot be written.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(prefix=f".{path.stem}-", suffix=path.suffix, dir=path.parent)
    os.close(handle)
    temporary = Path(name)
    try:
        yield temporary
        # mkstemp makes private files; results are as readable as the user's umask allows.
        umask = os.umask(0)
        os.umask(umask)
        temporary.chmod(0o666 & ~umask)
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)

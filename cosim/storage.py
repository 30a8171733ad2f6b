"""Where files go: the cache folder, and writing that leaves a whole file or none."""

import contextlib
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path

import platformdirs


def cache_dir(kind: str) -> Path:
    """Folder for cached results of one kind ("fmus", "policies"), created if missing.

    `MINIROBOTS_CACHE` overrides the user's cache folder.
    """
    root = os.environ.get("MINIROBOTS_CACHE") or platformdirs.user_cache_dir("minirobots")
    folder = Path(root) / kind
    folder.mkdir(parents=True, exist_ok=True)
    return folder


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

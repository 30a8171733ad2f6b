"""Provenance of results besides code: the hash of its inputs, and versions of libraries."""

import hashlib
import importlib.metadata
import inspect
import json
import pickle
import platform
import sys
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

_PACKAGES = ("minirobots", "fmpy", "numba", "numpy", "rerun-sdk")


def digest_of(*parts: Any) -> str:
    """Hash (16 hex digits) of what a result depends on.

    Args:
        parts: paths stand for the content of their files, arrays for type, shape and values, and
            all else for the JSON that `msgspec` makes of it, keys in order.
    """
    found = hashlib.sha256()
    for number, part in enumerate(parts):
        found.update(b"\0" * (number > 0))
        if isinstance(part, Path):
            found.update(part.read_bytes())
        elif isinstance(part, np.ndarray):
            found.update(f"{part.dtype}{part.shape}".encode() + np.ascontiguousarray(part).data)
        else:
            found.update(json.dumps(msgspec.to_builtins(part), sort_keys=True).encode())
    return found.hexdigest()[:16]


def identity_of(thing: object) -> str | None:
    """Return what an object is known by: its module's source, its class, and its pickled state.

    None if its source is not in a file, or it cannot be pickled.
    """
    kind = type(thing)
    try:
        module = sys.modules[kind.__module__]
        source = Path(inspect.getfile(module)).read_bytes()
        parts = (source, kind.__qualname__.encode(), pickle.dumps(thing))
    except Exception:  # whatever an object does when it is pickled
        return None
    return hashlib.sha256(b"\0".join(parts)).hexdigest()[:16]


def versions() -> dict[str, str]:
    """Versions of this package, of Python and of the libraries that results depend on."""
    packages = {name: importlib.metadata.version(name) for name in _PACKAGES}
    return packages | {"python": platform.python_version()}

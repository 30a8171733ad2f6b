"""Provenance of results except for code: the hash of its inputs, and versions of libraries."""

import hashlib
import importlib.metadata
import json
import platform
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

_PACKAGES = ("minirobots", "fmpy", "numba", "numpy", "rerun-sdk")


def digest_of(*parts: Any) -> str:
    """Return a hash (16 hex digits) of what a result depends on.

    Paths stand for the content of their files, arrays for type, shape and values, and all else for
    the JSON that `msgspec` makes of it, keys in order.
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
    """Return what an object is known by: what the method `digest` of its class returns.

    None if its own class, not only a base of it, has none. No object is known by its code: that can
    be edited while it runs, and depends on modules and files that its source does not name.
    """
    if "digest" not in vars(type(thing)):
        return None
    known: Any = getattr(thing, "digest", None)
    found = known()
    return None if found is None else str(found)


def versions() -> dict[str, str]:
    """Versions of this package, of Python and of the libraries that results depend on."""
    packages = {name: importlib.metadata.version(name) for name in _PACKAGES}
    return packages | {"python": platform.python_version()}

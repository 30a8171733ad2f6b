"""Provenance of results except for code: the hash of its inputs, and versions of libraries."""

import hashlib
import importlib.metadata
import inspect
import io
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
    """Return what an object is known by: its module's source, its class, and its pickled state.

    The sources of the modules count, too, in which its base classes are and those of what its state
    holds. None if its source is not in a file, or it cannot be pickled.
    """
    kind, state = type(thing), io.BytesIO()
    try:
        module = sys.modules[kind.__module__]
        source = Path(inspect.getfile(module)).read_bytes()
        pickler = NotingPickler(state)
        pickler.dump(thing)
        others = (sys.modules.get(name) for name in sorted(pickler.modules - {kind.__module__}))
        files = (getattr(other, "__file__", None) or "" for other in others)
        more = [Path(file).read_bytes() for file in files if file.endswith(".py")]
        parts = (source, kind.__qualname__.encode(), state.getvalue(), *more)
    except Exception:  # whatever an object does when it is pickled
        return None
    return hashlib.sha256(b"\0".join(parts)).hexdigest()[:16]


class NotingPickler(pickle.Pickler):
    """Pickler that notes in `modules` where what it pickles and its base classes are defined."""

    def __init__(self, file: io.BytesIO) -> None:
        super().__init__(file)
        self.modules: set[str] = set()

    def reducer_override(self, obj: Any) -> Any:
        """Note the module of an object, and have it pickled as usual."""
        kind = obj if isinstance(obj, type) else type(obj)
        self.modules |= {base.__module__ for base in kind.__mro__}
        self.modules |= {getattr(obj, "__module__", None) or "builtins"}
        return NotImplemented


def versions() -> dict[str, str]:
    """Versions of this package, of Python and of the libraries that results depend on."""
    packages = {name: importlib.metadata.version(name) for name in _PACKAGES}
    return packages | {"python": platform.python_version()}

"""How kernels are compiled: numba, cached on disk, without the interpreter lock.

The cache folder is named by a hash of every source file that kernels draw on. numba itself
only looks at the file of the outermost kernel, and would run stale code after a change in another.
"""

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar, cast

import numba
from numba.core import config

from cosim.storage import cache_dir

Kernel = TypeVar("Kernel", bound=Callable)

_PACKAGES = ("cosim", "agent")


def _source_digest() -> str:
    root = Path(__file__).parents[1]
    digest = hashlib.sha256(numba.__version__.encode())
    for path in sorted(p for package in _PACKAGES for p in (root / package).rglob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


config.CACHE_DIR = str(cache_dir("kernels") / _source_digest())  # pyright: ignore[reportAttributeAccessIssue]


def kernel(function: Kernel) -> Kernel:
    """Compile a function with numba: IEEE arithmetic, no fastmath, releasing the lock."""
    return cast(Kernel, numba.njit(cache=True, nogil=True, error_model="numpy")(function))


def inlined(function: Kernel) -> Kernel:
    """Compile a function into its callers.

    For inner functions: numba passes a record of arrays field by field, and a call that is not
    inlined costs more than most of the work in it.
    """
    compiled = numba.njit(cache=True, nogil=True, error_model="numpy", forceinline=True)(function)
    return cast(Kernel, compiled)

"""How kernels are compiled: numba, cached on disk, without the interpreter lock.

The cache folder is named by a hash of every source file that kernels draw on: the modules that
import this one, and all that they import. numba itself only looks at the file of the outermost
kernel, and would run stale code after a change in another.
"""

from collections.abc import Callable
from pathlib import Path
from typing import TypeVar, cast

import numba
from numba.core import config

from cosim.sources import ROOT, imported_files, source_digest, with_imports
from cosim.storage import cache_dir

Kernel = TypeVar("Kernel", bound=Callable)

_PACKAGES = ("cosim", "agent")


def _kernel_sources() -> list[Path]:
    """Modules with kernels, and what they import, directly or not."""
    files = [file for package in _PACKAGES for file in (ROOT / package).rglob("*.py")]
    return with_imports(file for file in files if Path(__file__) in imported_files(file))


_DIGEST = source_digest(_kernel_sources(), numba.__version__)
config.CACHE_DIR = str(cache_dir("kernels") / _DIGEST)  # pyright: ignore[reportAttributeAccessIssue]


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

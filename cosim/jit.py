"""How kernels are compiled: numba, cached on disk, without the interpreter lock.

The cache folder is named by a hash of every source file that kernels draw on: the modules that
import this one, and all that they import. numba itself only looks at the file of the outermost
kernel, and would run stale code after a change in another.
"""

import hashlib
import re
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar, cast

import numba
from numba.core import config

from cosim.storage import cache_dir

Kernel = TypeVar("Kernel", bound=Callable)

_PACKAGES = ("cosim", "agent")
_IMPORT = re.compile(r"^ *(?:from|import) +([\w.]+)", re.MULTILINE)


def _imported_files(path: Path, root: Path) -> set[Path]:
    """Files of this project that a module imports directly."""
    # lines instead of a syntax tree, which would take longer than all other imports of a start
    files = (root / f"{name.replace('.', '/')}.py" for name in _IMPORT.findall(path.read_text("utf-8")))
    return {file for file in files if file.is_file()}


def _kernel_sources(root: Path) -> list[Path]:
    """Modules with kernels, and what they import, directly or not."""
    files = [file for package in _PACKAGES for file in (root / package).rglob("*.py")]
    imports = {file: _imported_files(file, root) for file in files}
    waiting = [file for file in files if Path(__file__) in imports[file]]
    found: set[Path] = set()
    while waiting:
        file = waiting.pop()
        if file not in found:
            found.add(file)
            waiting += imports.get(file, ())
    return sorted(found)


def _source_digest() -> str:
    digest = hashlib.sha256(numba.__version__.encode())
    for path in _kernel_sources(Path(__file__).parents[1]):
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

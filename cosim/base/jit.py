"""How kernels are compiled: numba, cached on disk, without the interpreter lock.

The cache folder is named by a hash of every source file that kernels draw on: the modules that
import this one, and all that they import. numba itself only looks at the file of the outermost
kernel, and would run stale code after a change in another. Nor does it expect two processes to
fill the folder at once, which could take one's machine code for the other's: a lock per kernel
lets one compile while the others wait for what it writes. And it takes whatever is in its files for
machine code: they get checksums here, and what is damaged is compiled again. Signals wait while
LLVM makes machine code: it calls Python, out of which an exception would not get, so that an
interrupt would be lost, or machine code.
"""

import contextlib
import functools
import hashlib
import io
import logging
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager as ContextManager
from pathlib import Path
from typing import Any, TypeVar, cast

import numba
from numba import types
from numba.core import config
from numba.core.caching import IndexDataCacheFile
from numba.core.codegen import JitEngine
from numba.core.compiler_lock import global_compiler_lock
from numba.core.targetconfig import ConfigStack

from cosim.base.provenance import ROOT, imported_files, source_digest, with_imports
from cosim.base.storage import cache_dir, lock_of, require_no_folder

Kernel = TypeVar("Kernel", bound=Callable)

_PACKAGES = ("cosim", "agent", "benchmarks")
_LOGGER = logging.getLogger(__name__)


def _kernel_sources() -> list[Path]:
    """Modules with kernels, and what they import, directly or not."""
    files = [file for package in _PACKAGES for file in (ROOT / package).rglob("*.py")]
    return with_imports(file for file in files if Path(__file__) in imported_files(file))


_DIGEST = source_digest(_kernel_sources(), numba.__version__)
_FOLDER = cache_dir("kernels") / _DIGEST
config.CACHE_DIR = str(_FOLDER)  # pyright: ignore[reportAttributeAccessIssue]
_PLAIN: bool = config.DISABLE_JIT  # pyright: ignore[reportAttributeAccessIssue]


def _uninterrupted(function: Kernel) -> Kernel:
    """The function, at whose end SIGINT and SIGTERM arrive that came within it."""

    @functools.wraps(function)
    def call(*arguments: Any) -> Any:
        if threading.current_thread() is not threading.main_thread():
            return function(*arguments)  # Python has signals arrive in the main thread
        came: list[int] = []
        usual = {
            number: signal.signal(number, lambda number, _: came.append(number))
            for number in (signal.SIGINT, signal.SIGTERM)
            if callable(signal.getsignal(number))  # else Python has nothing to do with it
        }
        try:
            return function(*arguments)
        finally:
            for number, handler in usual.items():
                signal.signal(number, handler)
            for number in came[:1]:
                signal.raise_signal(number)

    return cast(Kernel, call)


JitEngine.finalize_object = _uninterrupted(JitEngine.finalize_object)


def _compiled(function: Callable, lock: ContextManager, **options: bool) -> Any:
    """A dispatcher of numba: IEEE arithmetic, no fastmath, releasing the interpreter's lock."""
    dispatcher: Any = numba.njit(error_model="numpy", nogil=True, **cast(Any, options))(function)
    compile_one = dispatcher.compile

    def compile_once(signature: tuple) -> Any:
        # numba would compile a function again for every constant that it is given. The compiler's
        # own lock first: threads hold it while they compile what a kernel calls.
        arguments = tuple(map(types.unliteral, signature))
        with global_compiler_lock, lock:
            entry = compile_one(arguments)
        model, caller = dispatcher.targetctx.data_model_manager, ConfigStack.top_or_none()
        result = dispatcher.overloads[arguments].signature.return_type
        counted = options["_nrt"] and (caller is None or caller.nrt)  # here, and where it is called
        if not counted and model[result].contains_nrt_meminfo():
            raise TypeError(f"{function.__qualname__} returns an array; have it write into one")
        return entry

    dispatcher.compile = compile_once
    return dispatcher


def kernel(function: Kernel) -> Kernel:
    """Compile a function with numba, for Python and for other kernels, and keep it on disk."""
    if _PLAIN:
        return function
    lock = lock_of(_FOLDER / f"{function.__module__}.{function.__qualname__}")
    dispatcher = _compiled(function, lock, cache=True, _nrt=True)  # else it has its caller's
    dispatcher._cache._cache_file.__class__ = _CheckedFiles
    return cast(Kernel, dispatcher)


def inlined(function: Kernel) -> Kernel:
    """Compile a function into its callers.

    For inner functions: numba passes a record of arrays field by field, and a call that is not
    inlined costs more than most of the work in it. Nor does it count references to arrays, which
    would take a sixth of the time of a co-simulation, so that it may neither make nor return one.
    """
    return function if _PLAIN else cast(Kernel, _Inlined(function))


class _Inlined:
    """A function that kernels take in; called from Python it is a kernel, made at the first call.

    Few ever are, and what would unpack their arguments then is a third of the work.

    Attributes:
        py_func: the function.
    """

    def __init__(self, function: Callable) -> None:
        functools.update_wrapper(self, function)
        self.py_func = function
        options = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True, "_nrt": False}
        self._inner = _compiled(function, contextlib.nullcontext(), forceinline=True, **options)
        self._numba_type_ = self._inner._numba_type_  # what numba takes this object for

    @functools.cached_property
    def _kernel(self) -> Callable:
        return kernel(self.py_func)

    def __call__(self, *arguments: Any) -> Any:
        return self._kernel(*arguments)


class _CheckedFiles(IndexDataCacheFile):
    """A kernel's index and code, each file with its SHA-256 behind what numba reads."""

    @contextlib.contextmanager
    def _open_for_write(self, filepath: str) -> Iterator[Any]:
        require_no_folder(Path(filepath))
        content = io.BytesIO()
        yield content
        with super()._open_for_write(filepath) as file:
            file.write(content.getvalue() + hashlib.sha256(content.getvalue()).digest())

    def _load_index(self) -> dict[Any, str]:
        return super()._load_index() if _whole(Path(self._index_path)) else {}

    def _load_data(self, name: str) -> Any:
        if not _whole(Path(self._data_path(name))):
            raise OSError  # as if it were missing
        return super()._load_data(name)


def _whole(path: Path) -> bool:
    """Whether a file of a kernel is there as it was written; a log line says if it is damaged."""
    if not path.exists():
        return False
    with contextlib.suppress(OSError):
        content = path.read_bytes()
        if hashlib.sha256(content[:-32]).digest() == content[-32:]:
            return True
    _LOGGER.warning("%s is not as it was kept: it is compiled again", path)
    return False

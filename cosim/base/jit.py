"""Compilation of kernels: numba, cached on disk, without the interpreter lock.

numba notices changes of a kernel's own file only. Here kernels are kept in a folder that is named
by a hash of the sources that they can depend on: those of their own layer and of the layers below
it. An edit compiles the kernels of its layer and above it again, and leaves those below.
"""

import contextlib
import functools
import logging
import os
import signal
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Self, TypeVar, cast

import numba
from numba import types
from numba.core import config
from numba.core.compiler_lock import global_compiler_lock
from numba.core.targetconfig import ConfigStack
from numba.extending import overload, typeof_impl

from cosim.base.provenance import digest_of
from cosim.base.storage import cache_dir, is_intact, lock_of, require_cache, write_checksum

Kernel = TypeVar("Kernel", bound=Callable)
# Folders in the order of imports, lowest first (a test compares it with the import contracts).
LAYERS = (
    *("cosim/base", "cosim/model", "cosim/physics", "cosim/onboard", "cosim/fmi"),
    *("cosim/coupling", "cosim/calibration", "cosim/recording", "cosim/simulation"),
    *("cosim/machine", "agent/mdp", "agent/moves", "agent/envs", "agent/training"),
    *("agent/evaluation", "agent/study", "agent/experiments", "agent/web"),
)
TRANSIENT = "MINIROBOTS_TRANSIENT"  # in the environment of a process whose kernels are not kept
_SETTINGS: Any = config
# Options of functions that are compiled into their callers
_WITHIN: Any = {"forceinline": True, "nogil": True, "_nrt": False, "error_model": "numpy"}
_WITHIN |= {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}
_LOGGER = logging.getLogger(__name__)


_came: list[int] = []  # signals that wait


def _wait(number: int, _: Any) -> None:
    _came.append(number)


@contextlib.contextmanager
def interrupts_held() -> Iterator[None]:
    """Have SIGINT and SIGTERM wait for the end of this context, or of the one around it.

    For compiled code that calls Python, as LLVM does: an exception would not leave that call.
    """
    usual: dict[int, Any] = {}
    if threading.current_thread() is threading.main_thread():  # in which signals arrive
        for number in (signal.SIGINT, signal.SIGTERM):
            if callable(handler := signal.getsignal(number)) and handler is not _wait:
                usual[number] = handler
                signal.signal(number, _wait)
    try:
        yield
    finally:
        for number, handler in usual.items():
            signal.signal(number, handler)
        if usual and _came:
            number = _came[0]
            _came.clear()
            usual[number](number, None)


class KernelLocator:
    """Place of a kernel's machine code, as numba's setting CACHE_LOCATOR_CLASSES takes it."""

    def __init__(self, function: Callable, file: str) -> None:
        layer = "/".join(function.__module__.split(".")[:2])
        stamp = "" if layer in LAYERS else digest_of(Path(file))
        self.name = digest_of(function.__module__, function.__code__.co_firstlineno, stamp)
        sources = digest_of_sources(Path(__file__).parents[2], layer)
        self.folder = cache_dir(f"kernels/{digest_of(numba.__version__, sources)}")

    @classmethod
    def from_function(cls, function: Callable, file: str) -> Self:
        """Return the place of a function's machine code."""
        return cls(function, file)

    def get_cache_path(self) -> str:
        """Return the folder."""
        return str(self.folder)

    def ensure_cache_path(self) -> None:
        """Refuse a folder that cannot be written."""
        require_cache(self.folder)

    def get_source_stamp(self) -> str:
        """Return what changes with the function: its name does."""
        return ""

    def get_disambiguator(self) -> str:
        """Return how the names of the kernel's files end, after the function's name."""
        return self.name

    def files(self) -> list[Path]:
        """Return the kernel's files, its index first."""
        return sorted(self.folder.glob(f"*-{self.name}.*.nb[ic]"), key=lambda path: path.suffix)


@functools.cache
def digest_of_sources(root: Path, layer: str = LAYERS[-1]) -> str:
    """Return a hash of the sources that kernels of a layer can depend on.

    Args:
        root: the folder that has the layers.
        layer: one of `LAYERS`; all sources count for a folder outside them.
    """
    last = LAYERS.index(layer) if layer in LAYERS else len(LAYERS)
    files = [file for below in LAYERS[: last + 1] for file in sorted(root.glob(f"{below}/**/*.py"))]
    return digest_of([file.relative_to(root).as_posix() for file in files], *files)


def _compiled(function: Callable, *, kept: bool, **options: bool) -> Any:
    """Return a dispatcher: IEEE arithmetic, no fastmath, no interpreter lock; `kept` on disk."""
    options |= {"nogil": True, "_nrt": kept}
    dispatcher: Any = numba.njit(error_model="numpy", **cast(Any, options))(function)
    compile_one = dispatcher.compile

    def compile_once(signature: tuple) -> Any:
        # numba would compile a function again for every constant that it is given. The compiler's
        # own lock first: threads hold it while they compile what a kernel calls. A signal within
        # its Python code would leave it locked.
        arguments = tuple(map(types.unliteral, signature))
        with interrupts_held(), global_compiler_lock:
            if kept and TRANSIENT not in os.environ:
                entry = _kept(dispatcher, lambda: compile_one(arguments))
            else:
                entry = compile_one(arguments)
        model, caller = dispatcher.targetctx.data_model_manager, ConfigStack.top_or_none()
        result = dispatcher.overloads[arguments].signature.return_type
        counted = kept and (caller is None or caller.nrt)  # here, and where it is called
        if not counted and model[result].contains_nrt_meminfo():
            raise TypeError(f"{function.__qualname__} returns an array; have it write into one")
        return entry

    dispatcher.compile = compile_once
    return dispatcher


def _kept(dispatcher: Any, compile_one: Callable[[], Any]) -> Any:
    """Compile a kernel, or find it on disk; in one process, while others wait for it.

    Two processes that fill an index at once could take one's machine code for the other's, and
    numba takes whatever is in its files for machine code: they have checksums here.
    """
    place, misses = _place(dispatcher), sum(dispatcher.stats.cache_misses.values())
    if dispatcher.stats.cache_path is None:
        usual = _SETTINGS.CACHE_LOCATOR_CLASSES
        _SETTINGS.CACHE_LOCATOR_CLASSES = f"{__name__}.KernelLocator"
        try:
            dispatcher.enable_caching()
        finally:
            _SETTINGS.CACHE_LOCATOR_CLASSES = usual
    writable = os.access(place.folder, os.W_OK)  # else only what is there can be used
    with lock_of(place.folder / place.name) if writable else contextlib.nullcontext():
        for file in place.files():
            if not is_intact(file):
                _LOGGER.warning("%s is damaged: compiling it again", file)
                require_cache(place.folder)
                file.unlink()
        try:
            entry = compile_one()
            if sum(dispatcher.stats.cache_misses.values()) > misses:
                for file in place.files():
                    write_checksum(file)
        except OSError:  # a full disk, for example: what has no checksum is not kept
            for file in place.files():
                if not is_intact(file):
                    file.unlink()
            raise
    return entry


def _place(function: Any) -> KernelLocator:
    return KernelLocator(function.py_func, function.py_func.__code__.co_filename)


def kernel(function: Kernel) -> Kernel:
    """Compile a function with numba, for Python and for other kernels, and keep it on disk."""
    return function if _SETTINGS.DISABLE_JIT else cast(Kernel, _compiled(function, kept=True))


def is_compiled(function: Callable) -> bool:
    """Return whether the cache has machine code of a kernel, for any arguments."""
    return not hasattr(function, "py_func") or bool(_place(function).files())


def inlined(function: Kernel) -> Kernel:
    """Compile a function into its callers.

    For inner functions: numba passes a record of arrays field by field, and a call that is not
    inlined costs more than most of the work in it. Nor does it count references to arrays, which
    would take a sixth of the time of a co-simulation, so that it may neither make nor return one.
    """
    return function if _SETTINGS.DISABLE_JIT else cast(Kernel, _Inlined(function))


class _Inlined:
    """A function that kernels take in; called from Python it is a kernel, made at the first call.

    Few ever are: compiling what would unpack their arguments makes the first command 28 % slower.
    """

    def __init__(self, function: Callable) -> None:
        functools.update_wrapper(self, function)
        self.py_func = function
        plain = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}
        self.dispatcher = _compiled(function, kept=False, forceinline=True, **plain)

    @functools.cached_property
    def _kernel(self) -> Callable:
        return kernel(self.py_func)

    def __call__(self, *arguments: Any) -> Any:
        return self._kernel(*arguments)


def unrolled(function: Kernel) -> Kernel:
    """Compile a function of tuples, which calls itself with their rest, into its callers.

    For every length once: numba keeps the branch that the `len` of an argument chooses.
    """
    if _SETTINGS.DISABLE_JIT:
        return function

    @functools.wraps(function)
    def called(*arguments: Any) -> Any:
        return function(*arguments)

    choose: Any = functools.wraps(function)(lambda *_: function)
    overload(called, jit_options=_WITHIN)(choose)
    return cast(Kernel, called)


def by_class(choices: dict[type, Callable]) -> Any:
    """Return a function that is one of some inlined ones, by the class of its first argument.

    That class, of a record, is known when a kernel is compiled: the choice costs nothing.
    """
    if _SETTINGS.DISABLE_JIT:
        return lambda record, *rest: choices[type(record)](record, *rest)
    plain = {record: getattr(function, "py_func", function) for record, function in choices.items()}

    @functools.wraps(next(iter(plain.values())))
    def called(record: Any, *rest: Any) -> Any:
        return plain[type(record)](record, *rest)

    choose: Any = functools.wraps(called)(lambda record, *_: plain[record.instance_class])
    overload(called, jit_options=_WITHIN, strict=False)(choose)
    return called


@typeof_impl.register(_Inlined)
def _type_of(function: _Inlined, _: Any) -> types.Dispatcher:
    return types.Dispatcher(function.dispatcher)

"""Compilation of kernels: numba, cached on disk, without the interpreter lock.

Signals wait while LLVM makes machine code. LLVM calls Python there, and an exception would not
leave that call: either the interrupt or the machine code would be lost.
"""

import contextlib
import functools
import gc
import signal
import threading
from collections.abc import Callable, Iterator
from typing import Any, TypeVar, cast

import numba
from numba import types
from numba.core import config
from numba.core.caching import NullCache
from numba.core.codegen import JITCodeLibrary, JITCPUCodegen, JitEngine
from numba.core.compiler_lock import global_compiler_lock
from numba.core.targetconfig import ConfigStack

from cosim.base.kernel_files import KernelCache

Kernel = TypeVar("Kernel", bound=Callable)

_PLAIN: bool = config.DISABLE_JIT  # pyright: ignore[reportAttributeAccessIssue]


def uninterrupted(function: Kernel) -> Kernel:
    """The function; SIGINT and SIGTERM that came within it arrive at its end."""

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


JitEngine.finalize_object = uninterrupted(JitEngine.finalize_object)

_into_callers = [False]  # of the functions being compiled, the innermost last; under numba's lock


def _left_out_for_inlined(owner: type, step: str) -> None:
    """Skip a step of numba for functions that are compiled into their callers only.

    Optimization and machine code of such functions are a sixth of the time of compiling.
    """
    usual = getattr(owner, step)

    @functools.wraps(usual)
    def unless_inlined(*arguments: Any) -> Any:
        return None if _into_callers[-1] else usual(*arguments)

    setattr(owner, step, unless_inlined)


_left_out_for_inlined(JITCodeLibrary, "_optimize_functions")
_left_out_for_inlined(JITCodeLibrary, "_optimize_final_module")
_left_out_for_inlined(JitEngine, "add_module")
_left_out_for_inlined(JitEngine, "finalize_object")
_left_out_for_inlined(JITCPUCodegen, "set_env")


@contextlib.contextmanager
def _without_collection() -> Iterator[None]:
    """Collect no garbage: of the millions of objects that numba makes, a seventh of its time."""
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()


def _compiled(function: Callable, *, kept: bool, **options: bool) -> Any:
    """Return a dispatcher of numba: IEEE arithmetic, no fastmath, releasing the interpreter's lock.

    Args:
        function: to compile.
        kept: whether its machine code is kept on disk, and references to arrays are counted.
        options: for numba.
    """
    options |= {"nogil": True, "_nrt": kept}
    dispatcher: Any = numba.njit(error_model="numpy", **cast(Any, options))(function)
    compile_one = dispatcher.compile

    def compile_once(signature: tuple) -> Any:
        # numba would compile a function again for every constant that it is given. The compiler's
        # own lock first: threads hold it while they compile what a kernel calls.
        arguments = tuple(map(types.unliteral, signature))
        with contextlib.ExitStack() as locks:
            locks.enter_context(global_compiler_lock)
            if kept:
                if isinstance(dispatcher._cache, NullCache):
                    dispatcher._cache = KernelCache(function)
                locks.enter_context(dispatcher._cache.lock())
            locks.enter_context(_without_collection())
            _into_callers.append(not kept)
            locks.callback(_into_callers.pop)
            entry = compile_one(arguments)
        model, caller = dispatcher.targetctx.data_model_manager, ConfigStack.top_or_none()
        result = dispatcher.overloads[arguments].signature.return_type
        counted = kept and (caller is None or caller.nrt)  # here, and where it is called
        if not counted and model[result].contains_nrt_meminfo():
            raise TypeError(f"{function.__qualname__} returns an array; have it write into one")
        return entry

    dispatcher.compile = compile_once
    return dispatcher


def kernel(function: Kernel) -> Kernel:
    """Compile a function with numba, for Python and for other kernels, and keep it on disk."""
    if _PLAIN:
        return function
    return cast(Kernel, _compiled(function, kept=True))


def is_compiled(function: Callable) -> bool:
    """Return whether the cache has machine code of a kernel, for any arguments."""
    return _PLAIN or KernelCache(getattr(function, "py_func", function)).path.exists()


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
        plain = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}
        self._inner = _compiled(function, kept=False, forceinline=True, **plain)
        self._numba_type_ = self._inner._numba_type_  # what numba takes this object for

    @functools.cached_property
    def _kernel(self) -> Callable:
        return kernel(self.py_func)

    def __call__(self, *arguments: Any) -> Any:
        return self._kernel(*arguments)

"""Files of compiled kernels: found by what a kernel does, checked before they are used.

numba looks for a kernel by its file and line, and notices changes of that one file only. Here a
kernel is found by a hash of its code and of all that it reaches: functions that it calls,
constants, and fields of records. A change in any of these compiles it again; another comment or
message, or a change elsewhere, does not. Two processes may not fill a file at once, which could
take one's machine code for the other's: a lock per kernel lets one compile while the others wait
for what it writes. Files have checksums, because numba takes whatever is in them for machine code.
"""

import contextlib
import hashlib
import inspect
import io
import logging
import os
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from types import CodeType, FunctionType, ModuleType
from typing import Any, ClassVar, Self

import numpy as np
from numba.core.caching import (
    CompileResultCacheImpl,
    FunctionCache,
    IndexDataCacheFile,
    _CacheLocator,  # pyright: ignore[reportPrivateUsage]
)
from numba.core.extending import _Intrinsic  # pyright: ignore[reportPrivateUsage]

from cosim.base.storage import cache_dir, lock_of, require_cache, require_no_folder

FOLDER = cache_dir("kernels")
_LOGGER = logging.getLogger(__name__)


def kernel_digest(function: Callable) -> str:
    """Return the hash (16 hex digits) of a function's code and of all that it reaches."""
    waiting: list[Any] = [function]
    contents: dict[Any, str] = {}
    while waiting:
        reached = waiting.pop()
        if reached not in contents:
            contents[reached], further = _content(reached)
            waiting += further
    return hashlib.sha256("\0".join(sorted(contents.values())).encode()).hexdigest()[:16]


@cache
def _content(function: FunctionType) -> tuple[str, list[FunctionType]]:
    """Return what a function itself consists of, and the functions that it refers to."""
    cells = (cell.cell_contents for cell in function.__closure__ or ())
    known = function.__globals__ | dict(zip(function.__code__.co_freevars, cells, strict=True))
    parts = [function.__module__, function.__qualname__, repr(function.__defaults__)]
    called: list[FunctionType] = []

    def add(value: Any) -> None:
        value = getattr(value, "py_func", value)  # of a kernel or an inlined function
        if isinstance(value, FunctionType):
            called.append(value)
        elif isinstance(value, _Intrinsic):  # its module teaches numba more than the function says
            parts.append(Path(inspect.getfile(value._defn)).read_text("utf-8"))
        elif isinstance(value, ModuleType):
            parts.append(value.__name__)
        elif isinstance(value, type):
            fields = getattr(value, "_fields", ()), getattr(value, "_field_defaults", {})
            parts.append(f"{value.__module__}.{value.__qualname__}{fields}")
        elif isinstance(value, np.ndarray):
            parts.append(f"{value.dtype}{value.shape}{value.tobytes().hex()}")
        else:
            parts.append(repr(value))

    def add_code(code: CodeType) -> None:
        parts.extend((code.co_code.hex(), *code.co_names))
        for constant in code.co_consts:
            if isinstance(constant, CodeType):
                add_code(constant)
            elif constant is not function.__doc__:
                parts.append(repr(constant))
        for name in (*code.co_names, *code.co_freevars):
            if name in known:
                add(known[name])

    add_code(function.__code__)
    return "\n".join(parts), called


class _Locator(_CacheLocator):
    """Place of a kernel: in one folder, under the hash of what it does."""

    def __init__(self, function: Callable, file: str) -> None:
        self._py_file, self._digest = file, kernel_digest(function)

    def get_cache_path(self) -> Any:
        return str(FOLDER)

    def ensure_cache_path(self) -> None:
        require_cache(FOLDER)

    def get_source_stamp(self) -> Any:
        return self._digest

    def get_disambiguator(self) -> Any:
        return self._digest

    @classmethod
    def from_function(cls, py_func: Callable, py_file: str) -> Self:
        return cls(py_func, py_file)


class _Files(IndexDataCacheFile):
    """A kernel's index and code, each file with its SHA-256 behind what numba reads."""

    @contextlib.contextmanager
    def _open_for_write(self, filepath: str) -> Iterator[Any]:
        require_no_folder(Path(filepath))
        content = io.BytesIO()
        yield content
        with super()._open_for_write(filepath) as file:
            file.write(content.getvalue() + hashlib.sha256(content.getvalue()).digest())

    def _load_index(self) -> dict[Any, str]:
        # a record that is named in the index may have another name now
        with contextlib.suppress(AttributeError, ImportError):
            return super()._load_index() if _intact(Path(self._index_path)) else {}
        return {}

    def _load_data(self, name: str) -> Any:
        if not _intact(Path(self._data_path(name))):
            raise OSError  # as if it were missing
        return super()._load_data(name)


class _Implementation(CompileResultCacheImpl):
    _locator_classes: ClassVar[list] = [_Locator]


class KernelCache(FunctionCache):
    """The cache of one kernel, made when first needed: all that it reaches is defined then.

    Attributes:
        path: of its index, by which processes lock it.
    """

    _impl_class = _Implementation

    def __init__(self, function: Callable) -> None:
        super().__init__(function)
        self._cache_file.__class__ = _Files
        self.path = Path(self._cache_file._index_path)

    def lock(self) -> contextlib.AbstractContextManager[object]:
        """Return the kernel's lock; none where only what is in the cache can be used."""
        writable = os.access(self.path.parent, os.W_OK)
        return lock_of(self.path) if writable else contextlib.nullcontext()


def _intact(path: Path) -> bool:
    """Return whether a file has its checksum; a log line says if it is damaged."""
    if not path.exists():
        return False
    with contextlib.suppress(OSError):
        content = path.read_bytes()
        if hashlib.sha256(content[:-32]).digest() == content[-32:]:
            return True
    _LOGGER.warning("%s is damaged: compiling it again", path)
    return False

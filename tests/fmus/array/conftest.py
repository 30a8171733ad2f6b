"""The FMU of n motors, driven by bare C calls, and motors of their own to compare it with."""

import ctypes
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fmus.build import instantiation_token
from fmus.compiler import host_target
from fmus.variables import TIME_REFERENCE, load_table

TABLE = load_table("VibrationMotors")
REFERENCE = {"time": TIME_REFERENCE} | {v.name: v.reference for v in TABLE.variables}
OK = 0


class Array:
    """An instance of VibrationMotors; what is not here is that of the instance of one motor."""

    def __init__(self, instance: Any, n: int) -> None:
        self.instance, self.n = instance, n
        instance.reference = REFERENCE
        if n != TABLE["n"].start:
            assert self.set_sizes(n=n) == OK, self.messages

    def __getattr__(self, name: str) -> Any:
        return getattr(self.instance, name)

    def values(self, function: str, names: tuple[str, ...], values: np.ndarray) -> int:
        """Status of a getter or setter of several variables."""
        references = (ctypes.c_uint32 * len(names))(*self.references(*names))
        size, room = ctypes.c_size_t, ctypes.c_void_p(values.ctypes.data)
        return self.call(function, references, size(len(names)), room, size(values.size))

    def set_sizes(self, **sizes: int) -> int:
        assert self.call("EnterConfigurationMode") == OK
        values = np.array([*sizes.values()], dtype=np.uint64)
        status = self.values("SetUInt64", tuple(sizes), values)
        assert self.call("ExitConfigurationMode") == OK
        return status

    def set(self, **values: Any) -> int:
        """Worst status of setting each variable; a number is every motor's."""
        worst = OK
        for name, value in values.items():
            kind = TABLE[name].type
            c_type = {"Float64": np.float64, "Int64": np.int64, "Boolean": np.bool_}[kind]
            count = self.n if TABLE[name].dimensions else 1
            array = np.ascontiguousarray(np.broadcast_to(value, (count,)), dtype=c_type)
            worst = max(worst, self.values(f"Set{kind}", (name,), array))
        return worst

    def get(self, *names: str) -> np.ndarray:
        """Array (variables, n), or one number for each scalar."""
        scalar = names[0] == "time" or not TABLE[names[0]].dimensions
        room = np.full((len(names), 1 if scalar else self.n), np.nan)
        assert self.values("GetFloat64", names, room) == OK, self.messages
        return room

    def start(self, **values: Any) -> "Array":
        assert self.set(**values) == OK, self.messages
        assert self.enter_initialization() == OK
        assert self.call("ExitInitializationMode") == OK
        return self


@pytest.fixture(scope="session")
def array_library(array_fmu: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    with zipfile.ZipFile(array_fmu) as archive:
        (name,) = (n for n in archive.namelist() if n.startswith(f"binaries/{host_target()}/"))
        return Path(archive.extract(name, tmp_path_factory.mktemp("array")))


@pytest.fixture(scope="session")
def array_token() -> str:
    return instantiation_token(TABLE)


@pytest.fixture
def array(
    instance: Callable[..., Any], array_library: Path, array_token: str
) -> Callable[..., Array]:
    def make(n: int = 4, library: Path = array_library) -> Array:
        return Array(instance(library=library, token=array_token), n)

    return make

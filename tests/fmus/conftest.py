"""The FMUs under test, driven by bare C calls of both standards."""

import ctypes
import struct
import sys
import zipfile
from collections.abc import Callable, Iterator
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fmpy.fmi2 import fmi2CallbackFunctions, fmi2CallbackLoggerTYPE
from fmpy.fmi3 import fmi3LogMessageCallback

from fmus.build import build_fmus, instantiation_token
from fmus.compiler import host_target
from fmus.description import read_description, variables_of
from fmus.models import Model

OUTPUTS = ("theta", "omega", "omega_dot", "V_s", "i")
OK, ERROR = 0, 3
# Places of values in a serialised state of one motor, in bytes from its end, and their formats.
FIELD = {
    "closed_loop": (80, "=i"), "solver": (76, "=i"), "theta": (72, "=d"), "omega": (64, "=d"),
    "integral": (56, "=d"), "time": (40, "=d"), "owed": (32, "=d"), "stop_time": (24, "=d"),
    "life_cycle": (16, "=q"),
}  # fmt: skip
token_of = cache(instantiation_token)


@cache
def variables(model: Model) -> dict[str, Any]:
    """Variables of a model's description, by name."""
    return {v.attrib["name"]: v for v in variables_of(read_description(model))}


class Instance:
    """One instance reached by bare C calls of either standard; calls return the status.

    An array of one motor behaves as a single one.
    """

    def __init__(
        self, library: Any, token: str, fmi: int, logging: bool, name: bytes | None, model: Model
    ) -> None:
        self.fmi, self.token, self.n, self.time_s = fmi, token, 1, 0.0
        self.library = ctypes.CDLL(str(library)) if isinstance(library, Path) else library
        self.messages: list[str] = []
        self.variables = variables(model)
        self.reference = {"time": 0} | {
            name: int(v.attrib["valueReference"]) for name, v in self.variables.items()
        }
        text = token.encode()
        if fmi == 2:
            log = fmi2CallbackLoggerTYPE(lambda *a: self.messages.append(a[4].decode()))
            self._keep = fmi2CallbackFunctions(logger=log), log
            make = self.library.fmi2Instantiate
            arguments = [name, 1, text, b"", ctypes.byref(self._keep[0]), 0, int(logging)]
        else:
            log = fmi3LogMessageCallback(lambda *a: self.messages.append(a[3].decode()))
            self._keep = log, log
            none = ctypes.c_void_p()
            flags = [ctypes.c_bool(flag) for flag in (False, logging, False, False)]
            make = self.library.fmi3InstantiateCoSimulation
            arguments = [name, text, b"", *flags, none, ctypes.c_size_t(0), none, log, none]
        make.restype = ctypes.c_void_p
        self.handle = make(*arguments)

    def call(self, function: str, *arguments: Any) -> int:
        """Status of a function given without its prefix; floats are passed as double."""
        converted = [ctypes.c_double(a) if isinstance(a, float) else a for a in arguments]
        handle = ctypes.c_void_p(self.handle)
        return getattr(self.library, f"fmi{self.fmi}{function}")(handle, *converted)

    def exchange(self, function: str, references: list[int], values: np.ndarray | None) -> int:
        """Status of a getter or setter of several variables."""
        array = (ctypes.c_uint32 * len(references))(*references)
        room = None if values is None else ctypes.c_void_p(values.ctypes.data)
        size = len(references) if values is None else values.size
        sizes = [ctypes.c_size_t(size)] if self.fmi == 3 else []
        return self.call(function, array, ctypes.c_size_t(len(references)), room, *sizes)

    def references(self, *names: str) -> list[int]:
        return [self.reference[name] for name in names]

    def values(self, function: str, names: tuple[str, ...], values: np.ndarray) -> int:
        return self.exchange(function, self.references(*names), values)

    def kind_of(self, name: str, value: Any) -> tuple[str, Any]:
        """Name of a type in functions of the standard, and numpy's; a plain number says its own."""
        plain = {bool: "Boolean", int: "Int64", float: "Float64"}
        kind = plain.get(type(value)) or self.variables[name].tag
        types: dict[str, Any] = {"Boolean": np.bool_, "Int64": np.int64, "Float64": np.float64}
        if self.fmi == 3:
            return kind, types[kind]
        of_fmi2 = {"Boolean": np.int32, "Int64": np.int32, "Float64": np.float64}
        return kind.replace("Int64", "Integer").replace("Float64", "Real"), of_fmi2[kind]

    def set(self, **values: Any) -> int:
        """Worst status of setting each variable; a number is every motor's."""
        worst = OK
        for name, value in values.items():
            kind, number = self.kind_of(name, value)
            count = self.n if self.variables[name].findall("Dimension") else 1
            array = np.ascontiguousarray(np.broadcast_to(value, (count,)), dtype=number)
            worst = max(worst, self.values(f"Set{kind}", (name,), array))
        return worst

    def refused(self, status: int, *words: str) -> None:
        """Assert that a call was refused with these words."""
        assert status == ERROR
        assert all(word in self.messages[-1] for word in words), self.messages[-1]

    def get_status(self, references: list[int], values: np.ndarray | None) -> int:
        return self.exchange("GetFloat64" if self.fmi == 3 else "GetReal", references, values)

    def get(self, *names: str) -> Any:
        """List of values of one motor; array (variables, n) of several, a column for scalars."""
        arrays = self.n > 1 and names[0] != "time" and self.variables[names[0]].findall("Dimension")
        room = np.full((len(names), self.n if arrays else 1), np.nan)
        assert self.get_status(self.references(*names), room) == OK, self.messages
        return room[:, 0].tolist() if self.n == 1 else room

    def set_sizes(self, **sizes: int) -> int:
        """Status of setting `n` or `samples` of an array."""
        assert self.call("EnterConfigurationMode") == OK
        status = self.values("SetUInt64", tuple(sizes), np.array([*sizes.values()], np.uint64))
        assert self.call("ExitConfigurationMode") == OK
        self.n = self.n if status else sizes.get("n", self.n)
        return status

    def enter_initialization(self, start_s: float = 0.0, stop_s: float | None = None) -> int:
        stop = ctypes.c_int(stop_s is not None), float(stop_s or 0.0)
        if self.fmi == 3:
            return self.call("EnterInitializationMode", 0, 0.0, start_s, *stop)
        status = self.call("SetupExperiment", 0, 0.0, start_s, *stop)
        return max(status, self.call("EnterInitializationMode"))

    def start(self, start_s: float = 0.0, stop_s: float | None = None, **values: Any) -> "Instance":
        """Set, initialise and go to Step Mode."""
        assert self.set(**values) == OK, self.messages
        assert self.enter_initialization(start_s, stop_s) == OK
        assert self.call("ExitInitializationMode") == OK
        return self

    def do_step(self, time_s: float, step_s: float, last: ctypes.c_double | None = None) -> int:
        """Status of a step; `last` receives its end in FMI 3."""
        if self.fmi == 2:
            return self.call("DoStep", time_s, step_s, 1)
        flags = [ctypes.byref(ctypes.c_bool()) for _ in range(3)]
        end = ctypes.byref(ctypes.c_double() if last is None else last)
        return self.call("DoStep", time_s, step_s, ctypes.c_bool(True), *flags, end)

    def run(self, duration_s: float, step_s: float = 1e-3, names: tuple[str, ...] = OUTPUTS):
        """Times (n + 1,) and one array (n + 1,) per name, from now on."""
        start, count = self.time_s, round(duration_s / step_s)
        rows = [self.get(*names)]
        for k in range(count):
            assert self.do_step(start + k * step_s, step_s) == OK, self.messages
            rows.append(self.get(*names))
        self.time_s = start + count * step_s
        columns = np.array(rows).T
        return start + np.arange(count + 1) * step_s, dict(zip(names, columns, strict=True))

    def save(self) -> bytes:
        """The serialised state."""
        name = "FMUState" if self.fmi == 3 else "FMUstate"
        state, size = ctypes.c_void_p(), ctypes.c_size_t()
        assert self.call(f"Get{name}", ctypes.byref(state)) == OK
        assert self.call(f"Serialized{name}Size", state, ctypes.byref(size)) == OK
        room = (ctypes.c_ubyte * size.value)()
        assert self.call(f"Serialize{name}", state, room, size) == OK
        assert self.call(f"Free{name}", ctypes.byref(state)) == OK
        assert state.value is None
        return bytes(room)

    @staticmethod
    def sealed(content: bytes) -> bytes:
        """A serialised state with its checksum put right: FNV-1a in the last 8 bytes."""
        checksum = 0xCBF29CE484222325
        for byte in content[:-8]:
            checksum = (checksum ^ byte) * 0x100000001B3 % 2**64
        return content[:-8] + checksum.to_bytes(8, sys.byteorder)

    def with_field(self, saved: bytes, name: str, value: float) -> bytes:
        """A serialised state of one motor with one value replaced and the checksum put right."""
        content, (place, kind) = bytearray(saved), FIELD[name]
        struct.pack_into(kind, content, len(content) - place, value)
        return self.sealed(bytes(content))

    def place(self, **state: float) -> None:
        """Put one motor into a state, by the names of `FIELD`."""
        content = self.save()
        for name, value in state.items():
            content = self.with_field(content, name, value)
        assert self.load(content) == OK, self.messages

    def load(self, content: bytes) -> int:
        """Deserialise and set a state."""
        name = "FMUState" if self.fmi == 3 else "FMUstate"
        state, size = ctypes.c_void_p(), ctypes.c_size_t(len(content))
        room = (ctypes.c_ubyte * len(content))(*content)
        word = "Deserialize" if self.fmi == 3 else "DeSerialize"
        status = self.call(f"{word}{name}", room, size, ctypes.byref(state))
        if status == OK:
            status = self.call(f"Set{name}", state)
        assert self.call(f"Free{name}", ctypes.byref(state)) == OK
        return status

    def free(self) -> None:
        if self.handle:
            getattr(self.library, f"fmi{self.fmi}FreeInstance")(ctypes.c_void_p(self.handle))
            self.handle = None


@pytest.fixture(scope="session")
def fmus(array_fmu: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[int | str, Path]:
    """The FMU of a motor by its standard, and that of the array, for this machine."""
    folder = tmp_path_factory.mktemp("fmus")
    two, three = folder / "fmi2.fmu", folder / "fmi3.fmu"
    build_fmus({"2": two, "3": three}, [host_target()])
    return {2: two, 3: three, "array": array_fmu}


@pytest.fixture(scope="session")
def libraries(motor_fmu, array_fmu, tmp_path_factory) -> dict[str, Path]:
    """The shared library of each model's FMU."""
    found, folder = {}, tmp_path_factory.mktemp("libraries")
    for path in (motor_fmu, array_fmu):
        with zipfile.ZipFile(path) as archive:
            (name,) = (n for n in archive.namelist() if n.startswith(f"binaries/{host_target()}/"))
            found[path.stem] = Path(archive.extract(name, folder))
    return found


@pytest.fixture
def instance(libraries: dict[str, Path]) -> Iterator[Callable[..., Instance]]:
    """Make a motor by its standard, or an "array" of `n` motors."""
    instances: list[Instance] = []

    def make(
        kind: int | str = 3,
        n: int = 1,
        token: str | None = None,
        logging: bool = True,
        library: Any = None,
        name: bytes | None = b"instance",
    ) -> Instance:
        model: Model = "VibrationMotors" if kind == "array" else "VibrationMotor"
        fmi = 2 if kind == 2 else 3
        made = Instance(
            library or libraries[model], token or token_of(model), fmi, logging, name, model
        )
        instances.append(made)
        if kind == "array" and made.handle:
            assert made.set_sizes(n=n) == OK, made.messages
        return made

    yield make
    for each in instances:
        each.free()


@pytest.fixture
def array(instance: Callable[..., Instance]) -> Callable[..., Instance]:
    """Make an array of n motors."""
    return partial(instance, "array")


@pytest.fixture
def rig(instance: Callable[..., Instance]) -> Callable[..., Instance]:
    """Make a motor in Step Mode, from its start values."""
    return lambda **start: instance().start(**start)


@pytest.fixture(params=[2, 3], ids=["fmi2", "fmi3"])
def fmi(request: pytest.FixtureRequest) -> int:
    return request.param


@pytest.fixture(params=[2, 3, "array"], ids=["fmi2", "fmi3", "array"])
def kind(request: pytest.FixtureRequest) -> int | str:
    return request.param

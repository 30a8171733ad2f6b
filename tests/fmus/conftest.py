"""The FMU under test, driven through fmpy's classes (`rig`) or by bare C calls (`instance`)."""

import ctypes
import struct
import sys
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest
from fmpy.fmi2 import fmi2CallbackFunctions, fmi2CallbackLoggerTYPE
from fmpy.fmi3 import FMU3Slave, fmi3LogMessageCallback

from fmus.build import build_fmus, cached_fmu, instantiation_token
from fmus.compiler import host_target
from fmus.description import read_description, variables_of
from fmus.models import MODELS, Model

OUTPUTS = ("theta", "omega", "omega_dot", "V_s", "i")
OK, ERROR = 0, 3
# Places of values in a serialised state of one motor, in bytes from its end, and their formats.
FIELD = {
    "closed_loop": (80, "=i"), "solver": (76, "=i"), "theta": (72, "=d"), "omega": (64, "=d"),
    "integral": (56, "=d"), "time": (40, "=d"), "owed": (32, "=d"), "stop_time": (24, "=d"),
    "life_cycle": (16, "=q"),
}  # fmt: skip
VARIABLES = {
    model: {v.attrib["name"]: v for v in variables_of(read_description(model))} for model in MODELS
}
REFERENCE = {
    model: {"time": 0} | {n: int(v.attrib["valueReference"]) for n, v in variables.items()}
    for model, variables in VARIABLES.items()
}


class Rig:
    """One FMI 3.0 co-simulation instance in Step Mode."""

    def __init__(self, folder: str, description: Any, **start: float | bool) -> None:
        self.reference = {v.name: v.valueReference for v in description.modelVariables}
        self.fmu = FMU3Slave(
            guid=description.guid,
            unzipDirectory=folder,
            modelIdentifier=description.coSimulation.modelIdentifier,
            instanceName="rig",
        )
        self.fmu.instantiate()
        self.set(**start)
        self.fmu.enterInitializationMode()
        self.fmu.exitInitializationMode()
        self.time_s = 0.0

    def set(self, **values: float | bool) -> None:
        for name, value in values.items():
            setter = {bool: self.fmu.setBoolean, int: self.fmu.setInt64, float: self.fmu.setFloat64}
            setter[type(value)]([self.reference[name]], [value])

    def get(self, *names: str) -> list[float]:
        return self.fmu.getFloat64([self.reference[name] for name in names])

    def run(self, duration_s: float, step_s: float = 1e-3, names: tuple[str, ...] = OUTPUTS):
        """Times (n + 1,) and one array (n + 1,) per name, from now on."""
        start, count = self.time_s, round(duration_s / step_s)
        rows = [self.get(*names)]
        for k in range(count):
            self.fmu.doStep(start + k * step_s, step_s)
            rows.append(self.get(*names))
        self.time_s = start + count * step_s
        columns = np.array(rows).T
        return start + np.arange(count + 1) * step_s, dict(zip(names, columns, strict=True))


class Instance:
    """One instance reached by bare C calls of either standard; calls return the status.

    An array of one motor behaves as a single one.
    """

    def __init__(
        self,
        library: Any,
        token: str,
        fmi: int,
        logging: bool,
        name: bytes | None,
        model: Model = "VibrationMotor",
    ) -> None:
        self.fmi, self.token, self.n = fmi, token, 1
        self.library = ctypes.CDLL(str(library)) if isinstance(library, Path) else library
        self.messages: list[str] = []
        self.variables, self.reference = VARIABLES[model], REFERENCE[model]
        text = token.encode()
        if fmi == 2:
            log = fmi2CallbackLoggerTYPE(lambda *a: self.messages.append(a[4].decode()))
            self._keep = fmi2CallbackFunctions(logger=log), log
            make = self.library.fmi2Instantiate
            arguments = [name, 1, text, b"", ctypes.byref(self._keep[0])]
            arguments += [0, int(logging)]
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

    def _kind(self, name: str, value: Any) -> tuple[str, Any]:
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
            kind, number = self._kind(name, value)
            count = self.n if self.variables[name].findall("Dimension") else 1
            array = np.ascontiguousarray(np.broadcast_to(value, (count,)), dtype=number)
            worst = max(worst, self.values(f"Set{kind}", (name,), array))
        return worst

    def refuses_whole(self, refused: int | str, **values: float | bool) -> bool:
        """Whether one call that sets several variables is refused and changes none of them.

        Args:
            refused: value reference, or name, of the last one, which gets the first one's value.
            values: of one type, by name.
        """
        first = next(iter(values.values()))
        kind, number = self._kind("", first)
        before = self.save()
        last = self.reference[refused] if isinstance(refused, str) else refused
        array = np.array([*values.values(), first], dtype=number)
        status = self.exchange(f"Set{kind}", [*self.references(*values), last], array)
        return status == ERROR and self.save() == before

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
        return status

    def enter_initialization(self, start_s: float = 0.0, stop_s: float | None = None) -> int:
        stop = ctypes.c_int(stop_s is not None), float(stop_s or 0.0)
        if self.fmi == 3:
            return self.call("EnterInitializationMode", 0, 0.0, start_s, *stop)
        status = self.call("SetupExperiment", 0, 0.0, start_s, *stop)
        return max(status, self.call("EnterInitializationMode"))

    def start(self, **values: Any) -> "Instance":
        """Set, initialise and go to Step Mode."""
        assert self.set(**values) == OK, self.messages
        assert self.enter_initialization() == OK
        assert self.call("ExitInitializationMode") == OK
        return self

    def do_step(self, time_s: float, step_s: float) -> int:
        if self.fmi == 2:
            return self.call("DoStep", time_s, step_s, 1)
        flags = [ctypes.byref(ctypes.c_bool()) for _ in range(3)]
        last = ctypes.byref(ctypes.c_double())
        return self.call("DoStep", time_s, step_s, ctypes.c_bool(True), *flags, last)

    def set_logging(self, on: bool, *categories: str | None) -> int:
        names = (ctypes.c_char_p * len(categories))(
            *[None if c is None else c.encode() for c in categories]
        )
        flag = ctypes.c_bool(on) if self.fmi == 3 else ctypes.c_int(on)
        return self.call("SetDebugLogging", flag, ctypes.c_size_t(len(categories)), names)

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
def fmu() -> Path:
    """The FMI 3.0 FMU that the co-simulation uses."""
    return cached_fmu("VibrationMotor")


@pytest.fixture(scope="session")
def fmus(tmp_path_factory: pytest.TempPathFactory) -> dict[int, Path]:
    """The FMU of each standard, for this machine."""
    folder = tmp_path_factory.mktemp("fmus")
    paths = build_fmus({"2": folder / "fmi2.fmu", "3": folder / "fmi3.fmu"}, [host_target()])
    return dict(zip((2, 3), paths, strict=True))


@pytest.fixture(scope="session")
def extracted(fmu: Path, tmp_path_factory: pytest.TempPathFactory) -> str:
    folder = str(tmp_path_factory.mktemp("fmu"))
    fmpy.extract(str(fmu), folder)
    return folder


@pytest.fixture(scope="session")
def library(extracted: str) -> Path:
    """The FMU's shared library."""
    (path,) = (Path(extracted) / "binaries" / host_target()).iterdir()
    return path


@pytest.fixture(scope="session")
def rig(extracted: str) -> Iterator[Callable[..., Rig]]:
    description = fmpy.read_model_description(extracted)
    rigs: list[Rig] = []

    def make(**start: float | bool) -> Rig:
        rigs.append(Rig(extracted, description, **start))
        return rigs[-1]

    yield make
    for each in rigs:
        each.fmu.fmi3FreeInstance(each.fmu.component)


@pytest.fixture(scope="session")
def array_library(array_fmu: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    with zipfile.ZipFile(array_fmu) as archive:
        (name,) = (n for n in archive.namelist() if n.startswith(f"binaries/{host_target()}/"))
        return Path(archive.extract(name, tmp_path_factory.mktemp("array")))


@pytest.fixture(scope="session")
def token() -> str:
    return instantiation_token("VibrationMotor")


@pytest.fixture(scope="session")
def array_token() -> str:
    return instantiation_token("VibrationMotors")


@pytest.fixture
def instance(library, token, array_library, array_token) -> Iterator[Callable[..., Instance]]:
    """Make an instance of a motor by its standard; or of an array of one, by "array"."""
    instances: list[Instance] = []

    def make(
        kind: int | str = 3,
        token: str = token,
        logging: bool = True,
        library: Any = library,
        name: bytes | None = b"instance",
    ) -> Instance:
        if isinstance(kind, int):
            made = Instance(library, token, kind, logging, name)
        else:
            given = array_token if token == own else token
            at = array_library if library == one_motor else library
            made = Instance(at, given, 3, logging, name, "VibrationMotors")
        instances.append(made)
        if kind == "array" and made.handle:
            assert made.set_sizes(n=1) == OK
        return made

    own, one_motor = token, library
    yield make
    for each in instances:
        each.free()


@pytest.fixture
def array(instance) -> Callable[..., Instance]:
    """Make an array of n motors."""

    def make(n: int = 4, **options: Any) -> Instance:
        made = instance("array of several", **options)
        if n != int(made.variables["n"].attrib["start"]):
            assert made.set_sizes(n=n) == OK, made.messages
        made.n = n
        return made

    return make


@pytest.fixture(params=[2, 3], ids=["fmi2", "fmi3"])
def fmi(request: pytest.FixtureRequest) -> int:
    return request.param


@pytest.fixture(params=[2, 3, "array"], ids=["fmi2", "fmi3", "array"])
def kind(request: pytest.FixtureRequest) -> int | str:
    return request.param

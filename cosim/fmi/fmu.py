"""FMUs of FMI 2.0 and 3.0: unpacked, checked, and loaded with fmpy."""

import copy
import ctypes
import errno
import functools
import itertools
import logging
import re
import sys
import threading
import weakref
from collections import deque
from pathlib import Path
from typing import Any, Literal
from xml.etree.ElementTree import fromstring

import fmpy
from fmpy.fmi1 import FMICallException
from fmpy.fmi2 import (
    FMU2Model,
    FMU2Slave,
    fmi2CallbackAllocateMemoryTYPE,
    fmi2CallbackFreeMemoryTYPE,
    fmi2CallbackFunctions,
    fmi2CallbackLoggerTYPE,
)
from fmpy.fmi3 import FMU3Model, FMU3Slave
from fmpy.logging import addLoggerProxy
from fmpy.model_description import CoSimulation, ModelDescription, ValidationError
from fmpy.validation import validate_model_description

from cosim.base.errors import UserError
from cosim.base.reading import refuse_pointer
from cosim.fmi.abi import FMI_ERROR, FMI_FATAL, FMI_OK
from cosim.fmi.archive import MAX_DESCRIPTION_BYTES, require_plain, unpack
from cosim.fmi.isolation import note_failure, restored_arithmetic, same_folder
from cosim.model.config import whole_ratio

# fmpy changes the working directory of the process while it loads a binary, and does not change it
# back where that fails.
_LOADING = threading.Lock()
# What is kept of an FMU's messages, which may come in floods.
_LOG_LENGTH, _LOG_BYTES = 100, 2000
LogLevel = Literal["off", "warnings", "all"]
_LOG = logging.getLogger(__name__)
# Violations of the standard in a modelDescription.xml that change no result: what they are about is
# not read, or has one meaning all the same.
_HARMLESS = re.compile(
    r"has no start value|provides a start value|The combination .* is not allowed"
    r"|must have variability != "
    r"|unit \"[^\"]*\" of .* is not defined|VendorAnnotations.*not expected"
    r"|attribute 'stepSize' is not allowed"
)
_KINDS = {2: (FMU2Slave, FMU2Model), 3: (FMU3Slave, FMU3Model)}  # in fmpy, by the standard
_FOLDERS = (fmpy.platform_tuple, fmpy.platform)  # of binaries, of FMI 3.0 and 2.0


class FmuError(UserError):
    """Invalid FMU, or failure of a running one. The message names it."""


class Fmu:
    """An unpacked FMU from which instances are made.

    Attributes:
        path: the .fmu file.
        oddities: how its description violates the standard without a consequence.
        folder: where it is unpacked.
        description: fmpy's model description.
        exchange: whether instances are for Model Exchange.
        interface: fmpy's description of its Co-Simulation capabilities, or those that it has with a
            solver.
        standard: 2 or 3, of FMI.
        variables: fmpy's descriptions of its variables, by name.

    Raises:
        FmuError: the file is missing, is no FMU, or cannot run here.
        OSError: the file cannot be read, or the cache cannot be written.
    """

    # What messages call it, where its path comes from, and how to get another one.
    noun, place, fix = "FMU", "check its path", "export it again"
    leniency = ", or accept it with --lenient (lenient=True in Python)"

    def __init__(
        self,
        path: Path,
        *,
        lenient: bool = False,
        most_bytes: int = MAX_DESCRIPTION_BYTES,
        exchange: bool | None = False,
    ) -> None:
        """Unpack and read an FMU.

        Args:
            path: of the .fmu file.
            lenient: whether to accept every violation of the standard that the description can be
                read with, not only those that change no results.
            most_bytes: of the modelDescription.xml.
            exchange: whether to use its interface for Model Exchange in place of that for
                Co-Simulation; None for that of which there is one, Co-Simulation if there are both.
        """
        self.path = path
        self.oddities: list[str] = []
        if not path.is_file():
            raise FmuError(f"{self.noun} {path} does not exist or is a folder; {self.place}")
        refuse_pointer(path, FmuError)
        needed = (*(f"binaries/{name}/" for name in _FOLDERS), "resources/")
        try:
            self.folder = unpack(path, ("modelDescription.xml", *needed))
            require_plain(self.folder / "modelDescription.xml", most_bytes)
            self.description: ModelDescription = self._read_description(lenient)
        except FmuError:
            raise
        except Exception as error:  # fmpy raises plain Exceptions and those of zip and XML
            # Not the archive's fault, unless it leads to an invalid place in the file.
            if isinstance(error, OSError) and error.errno != errno.EINVAL:
                raise
            reason = " ".join(str(error).split())
            raise FmuError(f"{self.noun} {path} is broken ({reason}); {self.fix}") from error
        self.check_standard()
        self.standard = int(str(self.description.fmiVersion)[0])
        described = self.description
        self.exchange = described.coSimulation is None if exchange is None else exchange
        found = described.modelExchange if self.exchange else described.coSimulation
        if found is None:
            wanted = "Model Exchange" if exchange else "Co-Simulation"
            raise FmuError(f"{self.noun} {path} has no {wanted} interface; export it with one")
        self.interface = found if isinstance(found, CoSimulation) else CoSimulation(
            found.modelIdentifier, found.needsExecutionTool,
            found.canBeInstantiatedOnlyOncePerProcess, found.canGetAndSetFMUstate,
            canHandleVariableCommunicationStepSize=True,
        )  # fmt: skip
        name = str(self.interface.modelIdentifier)
        if not (name.isascii() and name.isidentifier()):  # it could lead out of the folder
            raise FmuError(
                f"{self.noun} {path} has modelIdentifier {name!r}; export it as a C identifier"
            )
        folder = _FOLDERS[0 if self.standard == 3 else 1]
        library = f"{name}{fmpy.sharedLibraryExtension}"
        if not (self.folder / "binaries" / folder / library).is_file():
            raise FmuError(
                f"{self.noun} {path} has no binary for {folder}; export it for this platform"
            )
        self.variables = {v.name: v for v in self.description.modelVariables}
        self._read_differences()
        self._loaded: Any = None  # the binary in fmpy's hands; slaves are copies of it

    def _read_description(self, lenient: bool) -> ModelDescription:
        """Read the modelDescription.xml, and note how it violates the standard."""
        try:
            return fmpy.read_model_description(self.folder)
        except (ValidationError, KeyError) as error:  # KeyError of an undefined unit
            description = fmpy.read_model_description(self.folder, validate=False)
            for each in (v for one in description.modelVariables for v in (one, *one.aliases)):
                each.displayUnit = None  # is used by nothing here
            found = [*getattr(error, "problems", ()), *validate_model_description(description)]
            problems = [" ".join(each.split()) for each in dict.fromkeys(found)]
            serious = [each for each in problems if not _HARMLESS.search(each)]
            if serious and not lenient:
                more = f" and {len(serious) - 1} more" if serious[1:] else ""
                raise FmuError(
                    f"{self.noun} {self.path} violates the standard ({serious[0]}{more}); "
                    f"{self.fix}{self.leniency}"
                ) from error
            self.oddities = problems
            return description

    def warn(self, said: str) -> None:
        """Log one warning that an FMU violates the standard; `said` is what it is called."""
        if self.oddities:
            more = f" (and {len(self.oddities) - 1} more)" if self.oddities[1:] else ""
            _LOG.warning("%s violates the standard: %s%s", said, self.oddities[0], more)

    def _read_differences(self) -> None:
        """Note which variables are relative quantities, which fmpy does not read."""
        content = (self.folder / "modelDescription.xml").read_bytes()
        if b"relativeQuantity" in content:
            for variable in fromstring(content).iterfind("ModelVariables/*"):
                for element in (variable, *variable):  # of FMI 3.0, of FMI 2.0
                    if said := element.get("relativeQuantity"):
                        self.variables[variable.get("name", "")].relativeQuantity = said in (
                            "true", "1",
                        )  # fmt: skip

    def check_standard(self) -> None:
        """Refuse an FMU of a standard that cannot be stepped.

        Raises:
            FmuError: it is neither of FMI 2.0 nor 3.0.
        """
        version = str(self.description.fmiVersion)
        if not version.startswith(("2.", "3.")):
            raise FmuError(
                f"{self.noun} {self.path} is FMI {version}; export it as FMI 2.0 or 3.0 "
                "Co-Simulation"
            )

    def load(self, name: str, log: "Log", *, events: bool = False) -> Any:
        """A new instance, as fmpy's slave, to be freed by `free`.

        Args:
            name: of the instance, as it shall appear in messages.
            log: gets what the FMU reports.
            events: whether it may return early and leave events to the caller (FMI 3.0).

        Raises:
            Exception: the binary does not load, or makes no instance.
        """
        with _LOADING, same_folder():  # fmpy changes it while it loads
            if self._loaded is None:
                with restored_arithmetic():  # which -ffast-math changes where it is loaded
                    self._loaded = _KINDS[self.standard][self.exchange](
                        guid=self.description.guid,
                        modelIdentifier=self.interface.modelIdentifier,
                        unzipDirectory=str(self.folder),
                        instanceName=None,
                    )
                weakref.finalize(self._loaded, fmpy.freeLibrary, self._loaded.dll._handle)
            slave = copy.copy(self._loaded)
            slave.instanceName, slave.loaded = name, self._loaded  # which outlives it so
            # A reference to the slave in the callback would keep both alive.
            if self.standard == 3:
                returning = {"eventModeUsed": events, "earlyReturnAllowed": events}
                slave.instantiate(
                    loggingOn=log.level != "off",
                    logMessage=lambda *told: log.take(told[1], told[3]),
                    **({} if self.exchange else returning),
                )
            else:
                slave.instantiate(callbacks=_callbacks(log), loggingOn=log.level != "off")
        return slave

    def failure(
        self, slave: Any, name: str, log: "Log", time_s: float, what: str, status: int
    ) -> FmuError:
        """Return the error that names the instance that failed, the time, and its last message.

        Args:
            slave: that failed; its end then leaves out calls that the standards forbid; or None.
            name: of the instance.
            log: what the FMU has reported.
            time_s: simulated time in s.
            what: went wrong.
            status: of the call that failed.
        """
        if slave is not None:
            _fail(slave, max(status, FMI_ERROR))
        said = f": {log[-1]}" if log else ""
        message = f"FMU {self.path.name}, instance {name}, at {time_s:.5f} s {what}{said}"
        note_failure(message)
        return FmuError(message)


def check_steps(
    interface: CoSimulation, said: str, step: tuple[str, float], varied: str | None
) -> None:
    """Refuse an FMU that cannot make the steps that a run makes.

    Args:
        interface: its capabilities.
        said: what it is called in messages.
        step: name and duration in s of the communication step, or of the one that all others are
            multiples of.
        varied: None if steps are all equal; where they vary and are rolled back, what needs that
            and how to do without.

    Raises:
        FmuError: it lacks a capability.
        ConfigError: its internal step does not divide the communication step.
    """
    for needed, able in (
        ("save its state (canGetAndSetFMUState)", interface.canGetAndSetFMUstate),
        (
            "vary its step (canHandleVariableCommunicationStepSize)",
            interface.canHandleVariableCommunicationStepSize,
        ),
    ):
        if varied and not able:
            raise FmuError(f"{said} cannot {needed}, {varied}")
    if interface.fixedInternalStepSize is not None:
        internal_s = float(interface.fixedInternalStepSize)  # fmpy leaves the text
        if not internal_s > 0.0:
            raise FmuError(
                f"{said} has fixedInternalStepSize = {internal_s:g}; export it with a positive one"
            )
        whole_ratio(*step, f"fixedInternalStepSize of {said}", internal_s)


class Log(deque[str]):
    """Latest messages of an FMU, oldest first.

    Attributes:
        level: "off" to have it report nothing, "warnings", or "all" to print each message at once.
        name: what messages that are printed begin with.
        warning: the last message that was no mere information.
    """

    def __init__(self, level: LogLevel = "warnings", name: str = "") -> None:
        super().__init__(maxlen=_LOG_LENGTH)
        self.level, self.name, self.warning = level, name, ""

    def take(self, status: int, message: bytes | None) -> None:
        """Keep a message of an FMU."""
        self.append((message or b"")[:_LOG_BYTES].decode("utf-8", "replace"))
        if status != FMI_OK:
            self.warning = self[-1]
        if self.level == "all":
            print(f"{self.name}: {self[-1]}", file=sys.stderr)


_LOGS: weakref.WeakValueDictionary[int, Log] = weakref.WeakValueDictionary()
_numbers = itertools.count(1)  # of logs, as environments of FMI 2.0, of which 0 is none


@fmi2CallbackLoggerTYPE
def _told(environment: int, _name: Any, status: int, _category: Any, text: Any) -> None:
    if (log := _LOGS.get(environment)) is not None:
        log.take(status, text)


@functools.cache
def _formatting_logger() -> Any:
    """Return fmpy's C function that fills in arguments as printf does, then calls `_told`.

    It calls one function for the whole process; its environment identifies the instance.
    """
    callbacks = fmi2CallbackFunctions(logger=_told)
    addLoggerProxy(ctypes.addressof(callbacks))
    return callbacks.logger


def _callbacks(log: Log) -> Any:
    """Return the callbacks of an FMI 2.0 FMU: a logger into `log`, and the C library's memory."""
    number = next(_numbers)
    _LOGS[number] = log
    return fmi2CallbackFunctions(
        logger=_formatting_logger(),
        allocateMemory=ctypes.cast(fmpy.calloc, fmi2CallbackAllocateMemoryTYPE),
        freeMemory=ctypes.cast(fmpy.free, fmi2CallbackFreeMemoryTYPE),
        componentEnvironment=number,
    )


def status_of(error: Exception) -> int:
    """Return the status of a call that failed in fmpy's hands."""
    return error.status if isinstance(error, FMICallException) else FMI_ERROR


def end(slave: Any) -> None:
    """End an instance that was initialised, and free it."""
    if fault_of(slave) < FMI_ERROR:
        try:
            slave.terminate()
        except FMICallException as error:
            _fail(slave, error.status)
    free(slave)


def _fail(slave: Any, status: int) -> None:
    """Note with which status an instance has failed; a fatal error is that of all instances."""
    slave.fault = status
    if status >= FMI_FATAL:
        slave.loaded.fault = status


def fault_of(slave: Any) -> int:
    """Return the status with which an instance has failed, 0 if it has not."""
    return max(getattr(slave, "fault", FMI_OK), getattr(slave.loaded, "fault", FMI_OK))


def free(slave: Any) -> None:
    """Free an instance, unless its last error was fatal: then nothing of it may be called.

    Its binary stays until all instances and the FMU are gone.
    """
    if fault_of(slave) >= FMI_FATAL:
        return
    if isinstance(slave, _KINDS[3]):
        slave.fmi3FreeInstance(slave.component)
    else:
        slave.fmi2FreeInstance(slave.component)


def function_address(function: Any) -> int:
    """Address of a C function for compiled code."""
    address = ctypes.cast(function, ctypes.c_void_p).value
    assert address is not None  # ctypes has resolved the symbol already
    return address

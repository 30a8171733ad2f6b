"""Motor FMUs as files: unpacked, checked, and loaded with fmpy."""

import copy
import errno
import hashlib
import logging
import os
import re
import shutil
import threading
import weakref
import zipfile
from collections import deque
from pathlib import Path
from typing import Any

import fmpy
from fmpy.fmi1 import FMICallException
from fmpy.fmi3 import FMU3Slave
from fmpy.model_description import CoSimulation, ModelDescription, ValidationError
from fmpy.validation import validate_model_description

from cosim.base.errors import UserError
from cosim.base.reading import refuse_pointer
from cosim.base.storage import cache_dir, load_or_create
from cosim.fmi.abi import FMI_FATAL

MAX_BYTES = 2**30  # of all files of an FMU together, unpacked: far more than FMUs hold
_NEEDED = ("modelDescription.xml", f"binaries/{fmpy.platform_tuple}/", "resources/")
# fmpy changes the working directory of the process while it loads a binary, and does not change it
# back where that fails.
_LOADING = threading.Lock()
_MESSAGE_BYTES = 2000  # what is kept of a message of an FMU
_LOG = logging.getLogger(__name__)
# Violations of the standard in a modelDescription.xml that change no result: what they are about is
# not read, or has one meaning all the same.
_HARMLESS = re.compile(
    r"has no start value|provides a start value|The combination .* is not allowed"
    r"|must have variability != "
    r"|unit \"[^\"]*\" of .* is not defined|VendorAnnotations.*not expected"
    r"|attribute 'stepSize' is not allowed"
)


class FmuError(UserError):
    """Invalid FMU, or failure of a running one. The message names it."""


class Fmu:
    """An unpacked FMU of FMI 3.0 from which instances for Co-Simulation are made.

    Attributes:
        path: the .fmu file.
        folder: where it is unpacked.
        description: fmpy's model description.
        interface: fmpy's description of its Co-Simulation capabilities.
        variables: fmpy's descriptions of its variables, by name.

    Raises:
        FmuError: the file is missing, is no FMU, or cannot run here.
        OSError: the file cannot be read, or the cache cannot be written.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        said = f"motor FMU {path}"
        if not path.is_file():
            raise FmuError(
                f"{said} does not exist or is a folder; check the path given by --motor-fmu"
            )
        refuse_pointer(path)
        try:
            self.folder = _unpack(path)
            self.description = _read_description(self.folder, said)
        except FmuError:
            raise
        except Exception as error:  # fmpy raises plain Exceptions and those of zip and XML
            # Not the archive's fault, unless it leads to an invalid place in the file.
            if isinstance(error, OSError) and error.errno != errno.EINVAL:
                raise
            reason = " ".join(str(error).split())
            raise FmuError(
                f"{said} is broken ({reason}); build one with `python -m fmus.build`"
            ) from error
        if not str(self.description.fmiVersion).startswith("3."):
            raise FmuError(
                f"{said} is FMI {self.description.fmiVersion}; export it as FMI 3.0 Co-Simulation"
            )
        found = self.description.coSimulation
        if found is None:
            raise FmuError(f"{said} has no Co-Simulation interface; export it with one")
        self.interface: CoSimulation = found
        library = f"{found.modelIdentifier}{fmpy.sharedLibraryExtension}"
        if not (self.folder / "binaries" / fmpy.platform_tuple / library).is_file():
            raise FmuError(
                f"{said} has no binary for {fmpy.platform_tuple}; export it for this platform"
            )
        self.variables = {v.name: v for v in self.description.modelVariables}
        self._loaded: Any = None  # the binary in fmpy's hands; slaves are copies of it

    def load(self, name: str, log: deque[str]) -> Any:
        """A new instance, as fmpy's slave, to be freed by `end`.

        Args:
            name: of the instance, as it shall appear in messages.
            log: gets what the FMU reports.

        Raises:
            Exception: the binary does not load, or makes no instance.
        """
        with _LOADING:
            if self._loaded is None:
                here = Path.cwd()
                try:
                    self._loaded = FMU3Slave(
                        guid=self.description.guid,
                        modelIdentifier=self.interface.modelIdentifier,
                        unzipDirectory=str(self.folder),
                    )
                finally:
                    os.chdir(here)
                self._loaded.fatal = False
                weakref.finalize(self._loaded, fmpy.freeLibrary, self._loaded.dll._handle)
            slave = copy.copy(self._loaded)
            slave.instanceName, slave.loaded = name, self._loaded  # which outlives it so
            slave.failed = False

            def take(_environment: Any, _status: Any, _category: Any, message: bytes) -> None:
                # A reference to the slave here would keep both alive.
                log.append((message or b"")[:_MESSAGE_BYTES].decode("utf-8", "replace"))

            slave.instantiate(loggingOn=True, logMessage=take)
        return slave


def _unpack(path: Path) -> Path:
    """Return the folder of the cache with what an FMU needs to run, named by the FMU's content."""
    with path.open("rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()[:16]
    folder = (cache_dir("unpacked") / digest).absolute()

    def extract() -> Path:
        part = folder.with_suffix(".part")
        shutil.rmtree(part, ignore_errors=True)  # what a killed process has left
        with zipfile.ZipFile(path) as archive:
            for entry in archive.infolist():  # some exporters write "./name" or backslashes
                entry.filename = entry.filename.replace("\\", "/").removeprefix("./")
            needed = [e for e in archive.infolist() if e.filename.startswith(_NEEDED)]
            if not any(entry.filename == _NEEDED[0] for entry in needed):
                raise zipfile.BadZipFile(f"it has no {_NEEDED[0]}")
            if (size := sum(entry.file_size for entry in needed)) > MAX_BYTES:
                limit = f"more than {MAX_BYTES >> 20} MiB"
                raise zipfile.BadZipFile(f"it unpacks to {size >> 20} MiB, {limit}")
            archive.extractall(part, needed)
        part.rename(folder)
        return folder

    return load_or_create(folder, lambda: folder if folder.is_dir() else None, extract)


def _read_description(folder: Path, said: str) -> ModelDescription:
    """Read the modelDescription.xml; a violation of the standard is logged or refused.

    Args:
        folder: of the FMU.
        said: what it is called in messages.

    Raises:
        FmuError: a violation of the standard may change results.
    """
    try:
        return fmpy.read_model_description(folder)
    except (ValidationError, KeyError) as error:  # KeyError of an undefined unit
        try:
            description = fmpy.read_model_description(folder, validate=False)
        except Exception:
            raise error from None  # which says more
        for each in (v for one in description.modelVariables for v in (one, *one.aliases)):
            each.displayUnit = None  # is used by nothing here
        found = [*getattr(error, "problems", ()), *validate_model_description(description)]
        problems = [" ".join(each.split()) for each in dict.fromkeys(found)]
        serious = [each for each in problems if not _HARMLESS.search(each)]
        named = serious or problems
        more = f" and {len(named) - 1} more" if named[1:] else ""
        if serious:
            raise FmuError(
                f"{said} violates the standard ({serious[0]}{more}); "
                "build one with `python -m fmus.build`"
            ) from error
        if problems:
            _LOG.warning("%s violates the standard: %s%s", said, problems[0], more)
        return description


def end(slave: Any) -> None:
    """End an initialised instance, as far as the standard allows after an error.

    An instance that failed is not terminated. After a fatal error nothing of the FMU is called.
    The binary stays until all instances and the FMU are gone.
    """
    if not (slave.failed or slave.loaded.fatal):
        try:
            slave.terminate()
        except FMICallException as error:
            slave.loaded.fatal = error.status >= FMI_FATAL
    if not slave.loaded.fatal:
        slave.fmi3FreeInstance(slave.component)

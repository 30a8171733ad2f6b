"""FMUs as files: unpacked into the cache, and checked."""

import errno
import hashlib
import logging
import re
import shutil
import zipfile
import zlib
from pathlib import Path

import fmpy
from fmpy.model_description import CoSimulation, ModelDescription, ValidationError
from fmpy.validation import validate_model_description

from cosim.base.errors import UserError
from cosim.base.reading import refuse_pointer
from cosim.base.storage import cache_dir, load_or_create, require_programs

MAX_BYTES = 2**30  # of all files of an FMU together, unpacked: far more than FMUs hold
_PART_BYTES = 2**20  # that are read at once
_NEEDED = ("modelDescription.xml", f"binaries/{fmpy.platform_tuple}/", "resources/")
_BUILD = "export it again, or get one by `minirobots fmu motor --out .`"
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
    """An unpacked FMU of FMI 3.0 for Co-Simulation.

    Making one reads and checks the file, and loads no binary: `cosim.fmi.motor.MotorFmu` does that
    for its first instance. Raises FmuError where the file cannot be used.

    Attributes:
        path, folder: the file, and the folder of the cache with its content.
        description, interface: fmpy's ModelDescription, and its CoSimulation.
        variables: fmpy's ModelVariable by name.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        if not path.is_file():
            raise self.refusal("does not exist or is a folder; check the path given by --motor-fmu")
        refuse_pointer(path)
        try:
            self.folder = _unpack(path)
            self.description = self._read_description()
        except FmuError:
            raise
        except Exception as error:  # fmpy raises plain Exceptions and those of zip and XML
            # Not the archive's fault, unless it leads to an invalid place in the file.
            if isinstance(error, OSError) and error.errno != errno.EINVAL:
                raise
            reason = " ".join(str(error).split())
            raise self.refusal(f"is broken ({reason}); {_BUILD}") from error
        version, found = self.description.fmiVersion, self.description.coSimulation
        if not str(version).startswith("3."):
            raise self.refusal(f"is FMI {version}; export it as FMI 3.0 Co-Simulation")
        if found is None:
            raise self.refusal("has no Co-Simulation interface; export it with one")
        self.interface: CoSimulation = found
        library = f"{found.modelIdentifier}{fmpy.sharedLibraryExtension}"
        if not (self.folder / "binaries" / fmpy.platform_tuple / library).is_file():
            target = fmpy.platform_tuple
            raise self.refusal(f"has no binary for {target}; export it for this platform")
        require_programs(self.folder)
        self.variables = {v.name: v for v in self.description.modelVariables}

    def refusal(self, what: str) -> FmuError:
        """Return the error that names the file, to be raised."""
        return FmuError(f"motor FMU {self.path} {what}")

    def _read_description(self) -> ModelDescription:
        """Read the modelDescription.xml; a violation of the standard is logged or refused."""
        try:
            return fmpy.read_model_description(self.folder)
        except (ValidationError, KeyError) as error:  # KeyError of an undefined unit
            try:
                description = fmpy.read_model_description(self.folder, validate=False)
            except Exception:
                raise error from None  # which says more
            for each in (v for one in description.modelVariables for v in (one, *one.aliases)):
                each.displayUnit = None  # is used by nothing here
            found = [*getattr(error, "problems", ()), *validate_model_description(description)]
            problems = [" ".join(each.split()) for each in dict.fromkeys(found)]
            serious = [each for each in problems if not _HARMLESS.search(each)]
            first, *rest = serious or problems or [""]
            more = f" and {len(rest)} more" if rest else ""
            if serious:
                what = f"violates the standard ({first}{more}); {_BUILD}"
                raise self.refusal(what) from error
            if problems:
                _LOG.warning("motor FMU %s violates the standard: %s%s", self.path, first, more)
            return description


def _unpack(path: Path) -> Path:
    """Return the folder of the cache with what an FMU needs to run, named by the FMU's content.

    A folder with a file that is missing or differs from the FMU's is unpacked again.
    """
    with path.open("rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()[:16]
    folder = (cache_dir("unpacked") / digest).absolute()
    with zipfile.ZipFile(path) as archive:
        for entry in archive.infolist():  # some exporters write "./name" or backslashes
            entry.filename = entry.filename.replace("\\", "/").removeprefix("./")
        needed = {e.filename: e for e in archive.infolist() if e.filename.startswith(_NEEDED)}
        if _NEEDED[0] not in needed:
            raise zipfile.BadZipFile(f"it has no {_NEEDED[0]}")
        if (size := sum(entry.file_size for entry in needed.values())) > MAX_BYTES:
            limit = f"more than {MAX_BYTES >> 20} MiB"
            raise zipfile.BadZipFile(f"it unpacks to {size >> 20} MiB, {limit}")

        def find() -> Path | None:
            return folder if all(_is_unpacked(e, folder) for e in needed.values()) else None

        def extract() -> Path:
            part = folder.with_suffix(".part")
            shutil.rmtree(part, ignore_errors=True)  # what a killed process has left
            archive.extractall(part, needed.values())
            if folder.exists():
                _LOG.warning("%s is damaged: unpacking it again", folder)
                shutil.rmtree(folder)
            part.rename(folder)
            return folder

        return load_or_create(folder, find, extract)


def _is_unpacked(entry: zipfile.ZipInfo, folder: Path) -> bool:
    """Return whether a folder has a file or folder of an archive, with its content."""
    place, checksum = folder / entry.filename, 0
    if entry.is_dir():
        return place.is_dir()
    try:
        with place.open("rb") as file:
            while part := file.read(_PART_BYTES):
                checksum = zlib.crc32(part, checksum)
    except OSError:
        return False
    return checksum == entry.CRC

"""Rows of one case on disk: one line each, appended as it comes, found again by a later run.

The first line says what the case is, for people and as a check.
"""

import contextlib
import errno
import fcntl
import os
from pathlib import Path
from typing import Generic, TypeVar

import msgspec

from agent.evaluation.cases import CaseIdentity
from cosim.base.errors import UserError
from cosim.base.reading import Kind, require_file

SCHEMA_VERSION = 1
Row = TypeVar("Row", bound=msgspec.Struct)


class Header(CaseIdentity, frozen=True, kw_only=True):
    """The first line: whose rows these are."""

    digest: str
    schema_version: int = SCHEMA_VERSION


class ResultFileError(UserError):
    """A file of results that cannot be continued; the message says what to do instead."""


_LONGEST = 2**20  # bytes, far above what is written here
_FILE = Kind("file of results", "move it away or choose another --out", ResultFileError)


class RowFile(Generic[Row]):
    """Rows of one kind. Reading them changes nothing on disk; the first `append` makes the file.

    Attributes:
        path: of the file.
        rows: those that are in the file, in the order in which they came.

    Raises:
        ResultFileError: the file is another's, or damaged other than at its end.
    """

    def __init__(self, path: Path, header: Header, form: type[Row]) -> None:
        self.path, self._header, self._form = path, header, form
        self.rows: list[Row] = []
        self._whole = self._size = 0
        if path.exists():
            self._read()

    def _read(self) -> None:
        """Take the rows of the file, its size and how many bytes of it are whole lines."""
        require_file(self.path, _FILE)
        number = 0
        with self.path.open("rb") as file:
            # A line without its end was being written when the process died.
            while (line := file.readline(_LONGEST)).endswith(b"\n") or len(line) == _LONGEST:
                self._whole += len(line)
                number += 1
                try:
                    if number > 1:
                        self.rows.append(msgspec.json.decode(line, type=self._form))
                        continue
                    header = msgspec.json.decode(line, type=Header)
                except Exception as error:  # whatever a line may be
                    raise ResultFileError(
                        f"{self.path}: line {number} is damaged ({error}); remove that line"
                    ) from error
                if (header.schema_version, header.digest) != (SCHEMA_VERSION, self._header.digest):
                    raise ResultFileError(
                        f"{self.path}: holds results of another configuration; move it away or "
                        "choose another folder with --out"
                    )
            if not number and not _line(self._header).startswith(line):
                raise ResultFileError(f"{self.path}: not a {_FILE.name}; {_FILE.mend}")
            self._size = self._whole + len(line)

    def append(self, row: Row) -> None:
        """Keep a row: in one write, so that a killed process leaves whole lines.

        Raises:
            ResultFileError: another process has written to the file since this one read it.
            OSError: the folder cannot be written.
        """
        self.path.parent.mkdir(parents=True, exist_ok=True)
        with self.path.open("ab", buffering=0) as file:
            with contextlib.suppress(OSError):  # of a file system without locks
                fcntl.flock(file, fcntl.LOCK_EX)
            if self.path.stat().st_size != self._size:
                raise ResultFileError(
                    f"{self.path}: another process writes to this file; wait until it ends and "
                    "run the same command again, or choose another --out"
                )
            if self._whole < self._size:
                file.truncate(self._whole)
            line = _line(row) if self._whole else _line(self._header) + _line(row)
            self._size = self._whole + file.write(line)
            if self._size < self._whole + len(line):
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(self.path))
            self._whole = self._size
        self.rows.append(row)


def _line(row: msgspec.Struct) -> bytes:
    return msgspec.json.encode(row) + b"\n"

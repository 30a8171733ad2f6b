"""Rows of one case on disk: one line each, appended as it comes, found again by a later run.

The first line says what the case is, for people and as a check.
"""

from pathlib import Path
from typing import Generic, TypeVar

import msgspec

from agent.evaluation.cases import CaseIdentity
from cosim.base.errors import UserError
from cosim.base.reading import Kind, require_file
from cosim.base.storage import replacing

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
    """Rows of one kind.

    Attributes:
        path: of the file.
        rows: those that are in the file, in the order in which they came.

    Raises:
        ResultFileError: the file is another's, or damaged other than at its end.
        OSError: the folder cannot be written.
    """

    def __init__(self, path: Path, header: Header, form: type[Row]) -> None:
        self.path, self._form = path, form
        self.rows: list[Row] = []
        path.parent.mkdir(parents=True, exist_ok=True)
        whole = self._read(header.digest) if path.exists() else 0
        if not whole:
            with replacing(path) as temporary:
                temporary.write_bytes(_line(header))
        elif whole < path.stat().st_size:
            with path.open("r+b") as file:
                file.truncate(whole)

    def _read(self, digest: str) -> int:
        """Take the rows of the file; returns how many bytes of it are whole lines."""
        require_file(self.path, _FILE)
        whole = number = 0
        with self.path.open("rb") as file:
            # A line without its end was being written when the process died.
            while (line := file.readline(_LONGEST)).endswith(b"\n") or len(line) == _LONGEST:
                whole += len(line)
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
                if (header.schema_version, header.digest) != (SCHEMA_VERSION, digest):
                    raise ResultFileError(
                        f"{self.path}: holds results of another configuration; move it away or "
                        "choose another folder with --out"
                    )
        return whole

    def append(self, row: Row) -> None:
        """Keep a row: in one write, so that a killed process leaves whole lines."""
        with self.path.open("ab", buffering=0) as file:
            file.write(_line(row))
        self.rows.append(row)


def _line(row: msgspec.Struct) -> bytes:
    return msgspec.json.encode(row) + b"\n"

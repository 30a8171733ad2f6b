"""Rows on disk: one line each, appended as it comes, found again by a later run.

A file belongs to what its digest names, such as a case; its first line says what that is, for
people and as a check.
"""

import contextlib
import errno
import os
from collections.abc import Iterable
from itertools import takewhile
from pathlib import Path
from typing import Any

import msgspec

from agent.evaluation.cases import Case, CaseIdentity, Job
from cosim.base.errors import UserError
from cosim.base.reading import Kind, require_file
from cosim.base.storage import lock_open, temporary_folder
from cosim.base.table import write_parquet
from cosim.simulation.result import EpisodeResult

SCHEMA_VERSION = 1


class Header(CaseIdentity, frozen=True, kw_only=True):
    """The first line, which names the case of the rows."""

    digest: str
    schema_version: int = SCHEMA_VERSION


class IndexedResult(EpisodeResult, frozen=True, kw_only=True):
    """A line: the episode from the start of an index."""

    index: int

    @property
    def result(self) -> EpisodeResult:
        """The episode without its index."""
        row = msgspec.structs.asdict(self)
        del row["index"]
        return EpisodeResult(**row)


_LONGEST = 2**20  # bytes, far above what is written here
_FILE = Kind("file of results", "move it away or choose another --out")


class ResultFile:
    """Episodes of one case. Reading them changes nothing on disk; the first `add` makes the file.

    Args:
        path: of the file.
        header: names the case; None for what the file says, to read it.

    Attributes:
        path: of the file.
        header: names the case.
        results: those that are in the file, by index of the start, in the order in which they came.

    Raises:
        UserError: the file belongs to something else, or is damaged other than at its end.
    """

    def __init__(self, path: Path, header: Header | None = None) -> None:
        # Absolute, as loading an FMU in another thread changes the working directory for a moment.
        self.path, self.header = path.absolute(), header
        self.results: dict[int, EpisodeResult] = {}
        self._whole = self._size = 0
        if path.exists():
            self._read()

    @classmethod
    def of_case(cls, folder: Path, case: Case) -> "ResultFile":
        """Return the file `<scenario>-<digest>.jsonl` of a case in a folder."""
        header = Header(**msgspec.structs.asdict(case.identity), digest=case.digest)
        return cls(folder / f"{header.scenario}-{case.digest}.jsonl", header)

    def _read(self) -> None:
        """Take the results of the file, its size and how many bytes of it are whole lines."""
        require_file(self.path, _FILE)
        number = 0
        with self.path.open("rb") as file:
            # A line without its end was being written when the process died.
            while (line := file.readline(_LONGEST)).endswith(b"\n") or len(line) == _LONGEST:
                self._whole += len(line)
                number += 1
                try:
                    if number > 1:
                        row = msgspec.json.decode(line, type=IndexedResult)
                        self.results[row.index] = row.result
                        continue
                    header = msgspec.json.decode(line, type=Header)
                except Exception as error:  # whatever a line may be
                    raise UserError(
                        f"{self.path}: line {number} is damaged ({error}); remove that line"
                    ) from error
                self.header = self.header or header
                if (header.schema_version, header.digest) != (SCHEMA_VERSION, self.header.digest):
                    raise UserError(
                        f"{self.path}: holds results of another configuration; move it away or "
                        "choose another folder with --out"
                    )
            if not number and not (self.header and _line(self.header).startswith(line)):
                raise UserError(f"{self.path}: not a {_FILE.name}; {_FILE.fix}")
            self._size = self._whole + len(line)

    def add(self, index: int, result: EpisodeResult) -> None:
        """Keep a result: in one write, so that a killed process leaves whole lines.

        Raises:
            UserError: another process has written to the file since this one read it.
        """
        row = IndexedResult(**msgspec.structs.asdict(result), index=index)
        self.path.parent.mkdir(parents=True, exist_ok=True)
        with self.path.open("ab", buffering=0) as file:
            with contextlib.suppress(OSError):  # of a file system without locks
                lock_open(file)
            if self.path.stat().st_size != self._size:
                raise UserError(
                    f"{self.path}: another process writes to this file; wait until it ends and "
                    "run the same command again, or choose another --out"
                )
            if self._whole < self._size:
                file.truncate(self._whole)
            assert self.header is not None
            line = _line(row) if self._whole else _line(self.header) + _line(row)
            self._size = self._whole + file.write(line)
            if self._size < self._whole + len(line):
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(self.path))
            self._whole = self._size
        self.results[index] = result

    def completed_prefix(self, indices: Iterable[int]) -> dict[int, EpisodeResult]:
        """Return the completed prefix of a sample of starts, by index of the start.

        What ends first is no sample: an episode counts when all before it are known.
        """
        return {k: self.results[k] for k in takewhile(self.results.__contains__, indices)}


def _line(row: msgspec.Struct) -> bytes:
    return msgspec.json.encode(row) + b"\n"


class EpisodeStore:
    """Episodes of any cases in a folder, each case in a file of its own.

    Args:
        folder: of the files; by default a temporary one, which lives as long as the store.
    """

    def __init__(self, folder: Path | None = None) -> None:
        self._temporary = temporary_folder() if folder is None else None
        self.folder = folder or Path(self._temporary.name if self._temporary else "")
        self._files: dict[str, ResultFile] = {}

    def file(self, case: Case) -> ResultFile:
        """Return the episodes of a case, read from its file at the first call."""
        if case.digest not in self._files:
            self._files[case.digest] = ResultFile.of_case(self.folder, case)
        return self._files[case.digest]

    def find(self, job: Job) -> EpisodeResult | None:
        """Return the result of an episode, None if it is missing."""
        return self.file(job.case).results.get(job.index)

    def keep(self, job: Job, row: EpisodeResult) -> None:
        """Keep the result of an episode."""
        self.file(job.case).add(job.index, row)


def export(folder: Path, path: Path) -> None:
    """Write all episodes of a folder to one Parquet file, a row each.

    Columns are those of `EpisodeResult`, the index of the start, what identifies the case, and
    every parameter by its name.

    Args:
        folder: with files of results.
        path: of the Parquet file.

    Raises:
        UserError: the folder has no results, or a file is damaged.
    """
    rows: list[dict[str, Any]] = []
    for file in sorted(folder.glob("*.jsonl")):
        found = ResultFile(file)
        of_case = msgspec.structs.asdict(found.header) if found.header else {}
        of_case |= of_case.pop("parameters", {})
        results = found.results.items()
        rows += [of_case | msgspec.structs.asdict(row) | {"index": k} for k, row in results]
    if not rows:
        raise UserError(f"{folder}: has no results of episodes; name a folder that has some")
    write_parquet(path, rows)

"""Results of episodes on disk: one line each, appended as it comes, found again by a later run.

A file belongs to one `agent.evaluation.cases.Case` and is named by its digest; another
configuration has another file. The first line says what the case is, for people and as a check.
"""

from pathlib import Path

import msgspec

from agent.evaluation.cases import Case, CaseIdentity
from cosim.base.errors import UserError
from cosim.base.reading import Kind, read_bytes
from cosim.base.storage import replacing
from cosim.navigation.result import EpisodeResult

SCHEMA_VERSION = 1


class Header(CaseIdentity, frozen=True, kw_only=True):
    """The first line: whose results these are."""

    digest: str
    schema_version: int = SCHEMA_VERSION


class IndexedResult(EpisodeResult, frozen=True, kw_only=True):
    """Every other line: the episode from the start of an index."""

    index: int


class ResultFileError(UserError):
    """A file of results that cannot be continued; the message says what to do instead."""


_FILE = Kind("file of results", "move it away or choose another --out", ResultFileError)


class ResultFile:
    """Episodes of one case.

    Attributes:
        case: whose episodes they are.
        path: of the file, `<scenario>-<digest>.jsonl`.
        results: those that are in the file, by index of the start.

    Raises:
        ResultFileError: the file is another's, or damaged other than at its end.
        OSError: the folder cannot be written.
    """

    def __init__(self, folder: Path, case: Case) -> None:
        self.case = case
        scenario = case.policy.config.scenario.name
        self.path = folder / f"{scenario}-{case.digest}.jsonl"
        self.results: dict[int, EpisodeResult] = {}
        folder.mkdir(parents=True, exist_ok=True)
        header = Header(**msgspec.structs.asdict(case.identity), digest=case.digest)
        content = read_bytes(self.path, _FILE) if self.path.exists() else b""
        # A line without its end was being written when the process died.
        whole = content[: content.rfind(b"\n") + 1]
        if not whole:
            with replacing(self.path) as temporary:
                temporary.write_bytes(_line(header))
            return
        if whole != content:
            with self.path.open("r+b") as file:
                file.truncate(len(whole))
        self._read(whole.splitlines(), case.digest)

    def _read(self, lines: list[bytes], digest: str) -> None:
        for number, line in enumerate(lines, 1):
            try:
                if number > 1:
                    row = msgspec.structs.asdict(msgspec.json.decode(line, type=IndexedResult))
                    index = row.pop("index")
                    self.results[index] = EpisodeResult(**row)
                    continue
                header = msgspec.json.decode(line, type=Header)
                if (header.schema_version, header.digest) != (SCHEMA_VERSION, digest):
                    raise ResultFileError(
                        f"{self.path}: holds results of another configuration; move it away or "
                        "choose another folder with --out"
                    )
            except ResultFileError:
                raise
            except Exception as error:  # whatever a line may be
                raise ResultFileError(
                    f"{self.path}: line {number} is damaged ({error}); remove that line"
                ) from error

    def add(self, index: int, result: EpisodeResult) -> None:
        """Keep a result: in one write, so that a killed process leaves whole lines."""
        with self.path.open("ab", buffering=0) as file:
            file.write(_line(IndexedResult(**msgspec.structs.asdict(result), index=index)))
        self.results[index] = result


def _line(row: msgspec.Struct) -> bytes:
    return msgspec.json.encode(row) + b"\n"

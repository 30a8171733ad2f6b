"""Results of episodes on disk, see `agent.evaluation.row_file`.

A file belongs to one `agent.evaluation.cases.Case` and is named by its digest; another
configuration has another file.
"""

from collections.abc import Iterable, Mapping
from itertools import takewhile
from pathlib import Path

import msgspec

from agent.evaluation.cases import Case, Job
from agent.evaluation.row_file import Header, RowFile
from cosim.navigation.result import EpisodeResult


def beginning(
    results: Mapping[int, EpisodeResult], indices: Iterable[int]
) -> dict[int, EpisodeResult]:
    """The longest beginning of a sample of starts that is known, by index of the start.

    What ends first is no sample: an episode counts when all before it are known.
    """
    return {k: results[k] for k in takewhile(results.__contains__, indices)}


class IndexedResult(EpisodeResult, frozen=True, kw_only=True):
    """A line: the episode from the start of an index."""

    index: int

    @property
    def result(self) -> EpisodeResult:
        """The episode without its index."""
        row = msgspec.structs.asdict(self)
        del row["index"]
        return EpisodeResult(**row)


class ResultFile:
    """Episodes of one case.

    Attributes:
        case: whose episodes they are.
        path: of the file, `<scenario>-<digest>.jsonl`.
        results: those that are in the file, by index of the start.

    Raises:
        ResultFileError: the file is another's, or damaged other than at its end.
    """

    def __init__(self, folder: Path, case: Case) -> None:
        self.case = case
        self.path = folder / f"{case.policy.config.scenario.name}-{case.digest}.jsonl"
        header = Header(**msgspec.structs.asdict(case.identity), digest=case.digest)
        self._file = RowFile(self.path, header, IndexedResult)
        self.results = {row.index: row.result for row in self._file.rows}

    def missing(self, indices: Iterable[int]) -> list[Job]:
        """The episodes of a sample of starts that are not there yet."""
        return [Job(self.case, k) for k in indices if k not in self.results]

    def beginning(self, indices: Iterable[int]) -> dict[int, EpisodeResult]:
        """See `beginning`."""
        return beginning(self.results, indices)

    def add(self, index: int, result: EpisodeResult) -> None:
        """Keep a result."""
        self._file.append(IndexedResult(**msgspec.structs.asdict(result), index=index))
        self.results[index] = result

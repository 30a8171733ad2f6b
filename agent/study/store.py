"""Episodes on disk: rows of one SQLite file in a folder, each added as its episode ends.

Those that are missing are simulated, here or elsewhere. Their results return to the process that
began them, which alone writes the file.
"""

import contextlib
import logging
import sqlite3
from collections.abc import Callable, Hashable, Iterable, Iterator, Sequence
from itertools import takewhile
from pathlib import Path
from typing import Any

import msgspec

from agent.evaluation.cases import Case, Job, run_jobs
from cosim.base.errors import FileError
from cosim.base.jobs import Workers, always
from cosim.base.progress import Progress, silent, under_way
from cosim.base.reading import Kind, parsing, require_file
from cosim.base.table import write_parquet
from cosim.model.outcome import Outcome
from cosim.simulation.result import EpisodeResult
from cosim.simulation.tasks import compile_kernels

FILE = "results.sqlite"
_KIND = Kind("file of results", "move it away or choose another --out")
_TABLES = """
    CREATE TABLE IF NOT EXISTS cases (digest TEXT PRIMARY KEY, identity TEXT) WITHOUT ROWID;
    CREATE TABLE IF NOT EXISTS episodes
        (digest TEXT, start INTEGER, result TEXT, PRIMARY KEY (digest, start)) WITHOUT ROWID;
"""
_GROUP = 32  # episodes, at most, that travel to another process together
_GROUPS = 4  # at least, for each worker, so that none waits long for the last one
_WAIT_S = 60.0  # for another process that writes at the same moment
_LOGGER = logging.getLogger(__name__)


class EpisodeStore:
    """Episodes of any cases in a folder, by default in memory only; reading them writes nothing."""

    def __init__(self, folder: Path | None = None) -> None:
        # Absolute, as loading an FMU in another thread changes the working directory for a moment.
        self.folder = (folder or Path()).absolute()
        self.path = None if folder is None else self.folder / FILE
        self._found: dict[str, dict[int, EpisodeResult]] = {}
        if folder is not None and any(folder.glob("*.jsonl")) and not (folder / FILE).exists():
            _LOGGER.warning(
                "%s: results of an earlier version (*.jsonl) are not read; all is simulated again",
                folder,
            )

    def results(self, case: Case) -> dict[int, EpisodeResult]:
        """Return the episodes of a case by index of the start, read at the first call."""
        if case.digest not in self._found:
            self._found[case.digest] = {}
            if self.path is not None and self.path.exists():
                query = "SELECT start, result FROM episodes WHERE digest = ?"
                with parsing(self.path, _KIND):
                    self._found[case.digest] = {
                        start: msgspec.json.decode(text, type=EpisodeResult)
                        for start, text in _rows(self.path, query, case.digest)
                    }
        return self._found[case.digest]

    def completed_prefix(self, case: Case, indices: Iterable[int]) -> dict[int, EpisodeResult]:
        """Return the completed prefix of a sample of starts, by index of the start.

        What ends first is no sample: an episode counts when all before it are known.
        """
        known = self.results(case)
        return {k: known[k] for k in takewhile(known.__contains__, indices)}

    def find(self, job: Job) -> EpisodeResult | None:
        """Return the result of an episode, None if it is missing."""
        return self.results(job.case).get(job.index)

    def keep(self, job: Job, row: EpisodeResult) -> None:
        """Keep the result of an episode, whole or not at all; on disk if its policy is known."""
        self.results(job.case)[job.index] = row
        if self.path is None or not job.case.known:
            return
        self.path.parent.mkdir(parents=True, exist_ok=True)
        self.path.open("ab").close()  # whose errors say more than those of SQLite
        identity, result = map(msgspec.json.encode, (job.case.identity, row))
        with _opened(self.path) as file, file:
            file.executescript(_TABLES)
            file.execute("INSERT OR IGNORE INTO cases VALUES (?, ?)", (job.key[0], identity))
            file.execute("INSERT OR REPLACE INTO episodes VALUES (?, ?, ?)", (*job.key, result))


def simulate_missing(
    jobs: Iterable[Job],
    store: EpisodeStore,
    where: Workers,
    *,
    may_begin: Callable[[], bool] = always,
    progress: Progress = silent,
) -> Iterator[tuple[Job, EpisodeResult]]:
    """Simulate the episodes that a store lacks, and keep each at once.

    Args:
        jobs: wanted, the most important ones first; those of one `key` are simulated once.

    Yields:
        The jobs that were missing and their results, as they end.
    """
    missing = {job.key: job for job in jobs if store.find(job) is None}
    todo, total, successes = list(missing.values()), len(missing), 0
    if not todo:
        return
    if where.backend != "threads":
        ended = _elsewhere(todo, where, may_begin)
    else:
        if may_begin():
            with under_way(progress, "preparing the kernels"):
                compile_kernels(todo[0].task(), total, where.count)
        ended = run_jobs(todo, where.count, may_begin)
    for count, (job, result) in enumerate(ended, 1):
        store.keep(missing[job.key], result)
        yield missing[job.key], result
        successes += result.outcome == Outcome.SUCCESS
        progress("episodes", count, total, f"{count}/{total}  success {successes / count:.1%}")


def _elsewhere(
    jobs: Sequence[Job], where: Workers, may_begin: Callable[[], bool]
) -> Iterator[tuple[Job, EpisodeResult]]:
    """Simulate groups of episodes that share batches in other processes or on other machines."""
    from cosim.base.backends import sweep  # noqa: PLC0415 - joblib is slow to import

    together: dict[Hashable, list[Job]] = {}
    for job in jobs:
        together.setdefault(job.task().batch_key, []).append(job)
    size = max(1, min(_GROUP, -(-len(jobs) // (_GROUPS * where.count))))
    groups = [
        some[first : first + size]
        for some in together.values()
        for first in range(0, len(some), size)
    ]
    for number, rows in sweep(_simulated, groups, where, may_begin):
        for place, row in rows:
            yield groups[number][place], row


def _simulated(group: list[Job]) -> list[tuple[int, EpisodeResult]]:
    """Results of a group of episodes by their places in it; in a worker."""
    places = {job.key: place for place, job in enumerate(group)}
    return [(places[job.key], result) for job, result in run_jobs(group, 1)]


@contextlib.contextmanager
def _opened(path: Path) -> Iterator[sqlite3.Connection]:
    with parsing(path, _KIND):
        try:
            with contextlib.closing(sqlite3.connect(path, timeout=_WAIT_S)) as file:
                yield file
        except sqlite3.OperationalError as error:
            if error.sqlite_errorcode == sqlite3.SQLITE_ERROR:  # other tables than ours
                raise
            raise FileError(
                f"{path}: cannot be read or written ({error}); free some space, wait until another "
                "process ends, or choose another --out"
            ) from error


def _rows(path: Path, query: str, *values: str) -> list[Any]:
    require_file(path, _KIND)
    with _opened(path) as file:
        tables = file.execute("SELECT count(*) FROM sqlite_master").fetchone()[0]
        return file.execute(query, values).fetchall() if tables else []


def _cell(value: Any) -> Any:
    """Return a parameter for a column of one type: JSON for what has lists in lists."""
    nested = isinstance(value, list) and any(isinstance(inner, list) for inner in value)
    return msgspec.json.encode(value).decode() if nested else value


def export(folder: Path, path: Path) -> None:
    """Write all episodes of a folder to one Parquet file, a row each.

    Columns are those of `EpisodeResult`, the index of the start, what identifies the case, and
    every parameter by its name, lists in lists as JSON.
    """
    rows = list[dict[str, Any]]()
    query = "SELECT identity, start, result FROM episodes JOIN cases USING (digest)"
    for identity, start, text in _rows(folder / FILE, query):
        with parsing(folder / FILE, _KIND):
            case = msgspec.json.decode(identity)
            parameters = case.pop("parameters")
            case |= {name: _cell(value) for name, value in parameters.items()}
            result = msgspec.json.decode(text, type=EpisodeResult)
        rows.append(case | msgspec.structs.asdict(result) | {"index": start})
    write_parquet(path, rows)

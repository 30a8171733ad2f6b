"""A recording as Rerun's chunks: in memory, or one `.rrd` from opening to renaming.

Rerun's file sink writes to `<name>.rrd.part`, which gets its name when it is complete, and its gRPC
sink to a viewer at the same time. What is written of an entity at once becomes one chunk: the
index of chunks, which Rerun keeps in memory for the end of the file, takes kilobytes for each.
Rerun drops bad data without a word and waits for ever after a failed write, so strict mode is on,
free space is checked and every flush has a time limit.
"""

import atexit
import ctypes
import json
import os
import shutil
import sys
import weakref
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cached_property, partial
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Thread
from typing import Any

import numpy as np
import pyarrow as pa
import rerun as rr
import rerun.blueprint as rrb
import rerun_bindings
from rerun.chunk import Chunk

from cosim.base.errors import USER_ERROR_STATUS, UserError
from cosim.base.storage import lock_alone

APPLICATION = "minirobots"
FLUSH_TIMEOUT_S = 30.0
# An RL step of two robots writes under 1 MB; the rest is room for the footer and other writers.
LEAST_FREE_BYTES = 50_000_000
_END, _END_BYTES = b"RRF2FOOT", 12  # of a whole file


class Kept:
    """A recording in memory."""

    def __init__(self, recording_id: str = "", blueprint: rrb.Blueprint | None = None) -> None:
        rr.set_strict_mode(True)
        self.recording_id, self.blueprint = recording_id, blueprint
        self.chunks: list[Chunk] = []
        self._gathered: dict[str, list[Chunk]] = {}  # of each entity, to be one

    def send(self, chunks: Iterable[Chunk]) -> None:
        """Take chunks."""
        self.chunks += chunks

    def static(self, entity: str, *what: rr.AsComponents) -> None:
        """Take data that holds for the whole recording."""
        self.send([_chunk_of_one_row(entity, [], what)])

    def row(self, entity: str, *what: rr.AsComponents, times: Iterable[rr.TimeColumn]) -> None:
        """Take one row of an entity, as `columns` takes many."""
        self._gathered.setdefault(entity, []).append(_chunk_of_one_row(entity, times, what))

    def properties(self, name: str, values: Mapping[str, Any]) -> None:
        """Take a property of the recording: numbers and strings as they are, the rest as JSON."""
        plain: dict[str, Any] = {
            key: value
            if isinstance(value, int | float | str)
            else json.dumps(value, ensure_ascii=False)
            for key, value in values.items()
        }
        # As arrays: of other values Rerun would expect the type that a key had before.
        arrays: dict[str, Any] = {key: pa.array([value]) for key, value in plain.items()}
        self.send([Chunk.from_property(name, rr.AnyValues(**arrays))])

    def columns(
        self, entity: str, times: Iterable[rr.TimeColumn], columns: Iterable[rr.ComponentColumn]
    ) -> None:
        """Take rows of one entity, one per time; `send_rows` makes a chunk of them."""
        self._gathered.setdefault(entity, []).append(Chunk.from_columns(entity, times, columns))

    def states(self, entity: str, times: Iterable[rr.TimeColumn], states: list[str]) -> None:
        """Take the states of an entity from some times on."""
        self.columns(entity, times, rr.StateChange.columns(state=states))

    def send_rows(self, least_rows: int = 0) -> None:
        """Send rows taken so far, of entities that have at least a number of them."""
        for entity, chunks in list(self._gathered.items()):
            if sum(chunk.num_rows for chunk in chunks) >= least_rows:
                del self._gathered[entity]
                rows = pa.concat_batches([chunk.to_record_batch() for chunk in chunks])
                self.send(Chunk.from_record_batch(rows, entity_path=entity))

    def check_space(self) -> None:
        """Raise UserError if there will soon be no room for more."""

    def flush(self) -> None:
        """Write out the data so far."""
        self.send_rows()

    def close(self) -> None:
        """Complete the recording."""
        self.send_rows()

    def write(self, path: Path) -> None:
        """Write a file."""
        with Recording(path, self.recording_id, self.blueprint) as file:
            file.send(self.chunks)

    @cached_property
    def path(self) -> Path:
        """A file with it, written now, in a temporary folder that lives as long as this object."""
        folder = TemporaryDirectory()
        weakref.finalize(self, folder.cleanup)
        path = Path(folder.name) / "episode.rrd"
        self.write(path)
        return path

    def __getstate__(self) -> tuple[str, rrb.Blueprint | None, list[tuple[bool, pa.RecordBatch]]]:
        batches = [(chunk.is_static, chunk.to_record_batch()) for chunk in self.chunks]
        return self.recording_id, self.blueprint, batches

    def __setstate__(self, state: tuple[str, Any, list[tuple[bool, pa.RecordBatch]]]) -> None:
        recording_id, blueprint, batches = state
        Kept.__init__(self, recording_id, blueprint)
        for static, batch in batches:
            self.send(Chunk.from_record_batch(batch, **{"index": None} if static else {}))


class Recording(Kept):
    """A recording in a file; a context manager that completes it, also on errors."""

    def __init__(
        self,
        path: Path,
        recording_id: str,
        blueprint: rrb.Blueprint | None,
        viewer: str | None = None,
    ) -> None:
        super().__init__(recording_id, blueprint)
        self._path, self._part = path, path.with_name(path.name + ".part")
        self._viewer, self._viewer_lost = viewer, False
        path.parent.mkdir(parents=True, exist_ok=True)
        self.check_space()
        self._lock = self._part.open("ab")
        try:
            lock_alone(self._lock, self._part)
        except UserError:
            self._lock.close()
            raise
        self._stream: rr.RecordingStream | None = rr.RecordingStream(
            APPLICATION, recording_id=recording_id, send_properties=False
        )
        sinks = [rr.FileSink(self._part), *([rr.GrpcSink(viewer)] if viewer else [])]
        self._in_time(partial(self._stream.set_sinks, *sinks, default_blueprint=blueprint))

    def __enter__(self) -> "Recording":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def check_space(self) -> None:
        """Raise UserError while the file can still be completed, if the disk fills up."""
        if shutil.disk_usage(self._path.parent).free < LEAST_FREE_BYTES:
            raise UserError(
                f"less than {LEAST_FREE_BYTES / 1e6:.0f} MB are free for the recording "
                f"{self._path}; free some space or choose another --out"
            )

    def send(self, chunks: Iterable[Chunk]) -> None:
        """Write chunks."""
        if self._stream is not None:
            self._in_time(partial(self._stream.send_chunks, chunks))

    def flush(self) -> None:
        """Write out the data so far."""
        super().flush()
        self._write_through()
        # Return to the system what allocators keep of written chunks, ever more of it.
        pa.default_memory_pool().release_unused()
        if sys.platform == "linux":
            getattr(ctypes.CDLL(None), "malloc_trim", int)(0)  # only glibc has it

    def _write_through(self) -> None:
        if self._stream is not None:
            self._in_time(partial(self._stream.flush, timeout_sec=FLUSH_TIMEOUT_S))

    def _in_time(self, work: Callable[[], None]) -> None:
        """Have Rerun do something that never ends if its writer has ended."""
        errors: list[Exception] = []

        def attempt() -> None:
            try:
                work()
            except Exception as error:  # rerun raises RuntimeError whatever the cause
                errors.append(error)

        thread = Thread(target=attempt, daemon=True)
        thread.start()
        thread.join(FLUSH_TIMEOUT_S + 1.0)
        if thread.is_alive():
            errors.append(TimeoutError(f"it takes longer than {FLUSH_TIMEOUT_S:g} s"))
        if not errors:
            return
        if self._viewer and "gRPC" in str(errors[0]):
            if not self._viewer_lost:
                text = f"the viewer at {self._viewer} is gone; {self._path} is written on"
                print(text, file=sys.stderr)
            self._viewer_lost = True
            return
        atexit.register(_leave, self._stream)
        self._stream = None
        if self._viewer:
            raise UserError(
                f"the viewer at {self._viewer} does not accept recorded data ({errors[0]}); start "
                f"it again or leave it out; {self._part} can be read so far"
            )
        raise self._incomplete(str(errors[0]))

    def _incomplete(self, why: str) -> UserError:
        return UserError(
            f"the recording {self._part} could not be written out ({why}); free some disk space; "
            "it and other .part files next to it can be read"
        )

    def close(self) -> None:
        """Complete the file and give it its name."""
        if self._stream is None:
            return
        self.send_rows()
        self._write_through()
        self._stream.disconnect()
        self._stream = None
        # Rerun keeps a recording's threads until it looks for recordings that nothing refers to.
        rerun_bindings.flush_and_cleanup_orphaned_recordings()
        with self._lock, self._part.open("rb") as file:
            file.seek(-min(_END_BYTES, self._part.stat().st_size), os.SEEK_END)
            if not file.read().startswith(_END):  # which says where everything is
                raise self._incomplete("its end is missing")
        self._part.replace(self._path)


def _leave(_: rr.RecordingStream | None) -> None:
    """End the process before Rerun disconnects the stream, which might never return."""
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(USER_ERROR_STATUS)


def _chunk_of_one_row(
    entity: str, times: Iterable[rr.TimeColumn], what: Iterable[rr.AsComponents]
) -> Chunk:
    batches = [batch for part in what for batch in part.as_component_batches()]
    columns = [batch.partition([len(batch.as_arrow_array())]) for batch in batches]
    return Chunk.from_columns(entity, times, columns)


def simulated(time_s: np.ndarray, rl_step: Sequence[int] | None = None) -> list[rr.TimeColumn]:
    """Times of rows in an episode: simulated time in s, and the RL step where it applies."""
    nanoseconds = np.round(time_s * 1e9).astype("timedelta64[ns]")
    columns = [rr.TimeColumn("sim_time", duration=nanoseconds)]
    if rl_step is not None:
        columns.append(rr.TimeColumn("rl_step", sequence=np.array(rl_step)))
    return columns


def scalars(values: np.ndarray) -> Iterable[rr.ComponentColumn]:
    """Rows of a scalar (n,) or vector (n, k) signal."""
    rows = rr.Scalars.columns(scalars=np.asarray(values, dtype=np.float64).reshape(-1))
    return rows if values.ndim == 1 else rows.partition(np.full(len(values), values.shape[1]))

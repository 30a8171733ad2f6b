"""Rerun files, complete or marked as incomplete: one `.rrd` from opening to renaming.

Data goes to `<name>.rrd.part` and gets its name when it is complete, and on request to a viewer at
the same time. What is written of an entity at once becomes one chunk: the index of chunks, which
Rerun keeps in memory for the end of the file, takes kilobytes for each. Rerun drops bad data and
writes on a full disk without a word, so strict mode is on, free space is checked, every flush
has a time limit and writes are ours (`cosim.recording.piped_file`). What is written is decided by
the callers, how a viewer is found by `cosim.recording.live`.
"""

import atexit
import ctypes
import json
import os
import shutil
import sys
import weakref
from collections.abc import Iterable, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import rerun as rr
import rerun.blueprint as rrb
import rerun_bindings
from rerun.chunk import Chunk

from cosim.base.errors import USER_ERROR_STATUS, UserError
from cosim.base.storage import temporary_folder
from cosim.recording.piped_file import PipedFile

APPLICATION = "minirobots"
FLUSH_TIMEOUT_S = 30.0
# An RL step of two robots writes under 1 MB; the rest is room for the footer and other writers.
LEAST_FREE_BYTES = 50_000_000
_END, _END_BYTES = b"RRF2FOOT", 12  # of a whole file


class Sink:
    """Makes chunks of what a recording is to hold; `send` takes them."""

    def __init__(self) -> None:
        rr.set_strict_mode(True)
        self._gathered: dict[str, list[Chunk]] = {}  # of each entity, to be one

    def send(self, chunks: Iterable[Chunk]) -> None:
        """Take chunks."""
        raise NotImplementedError

    def static(self, entity: str, *what: rr.AsComponents) -> None:
        """Take data that holds for the whole recording."""
        batches = [batch for part in what for batch in part.as_component_batches()]
        columns = [batch.partition([len(batch.as_arrow_array())]) for batch in batches]
        self.send([Chunk.from_columns(entity, [], columns)])

    def properties(self, name: str, values: Mapping[str, Any]) -> None:
        """Take a property of the recording."""
        self.send([Chunk.from_property(name, properties(values))])

    def columns(
        self,
        entity: str,
        times: Iterable[rr.TimeColumn],
        columns: Iterable[rr.ComponentColumn],
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

    def flush(self) -> None:
        """Write out the data so far."""
        self.send_rows()

    def check_space(self) -> None:
        """Raise UserError if there will soon be no room for more."""

    def close(self) -> None:
        """Complete the recording."""
        self.flush()


class Kept(Sink):
    """A recording in memory.

    Attributes:
        recording_id: identity of the recording.
        blueprint: what the viewer shows when it is opened.
        chunks: that were sent so far.
    """

    def __init__(self) -> None:
        super().__init__()
        self.recording_id = ""
        self.blueprint: rrb.Blueprint | None = None
        self.chunks: list[Chunk] = []

    def send(self, chunks: Iterable[Chunk]) -> None:
        """See `Sink.send`."""
        self.chunks += chunks

    def write(self, path: Path) -> None:
        """Write a file.

        Raises:
            UserError: the folder cannot be written, or the disk is full.
        """
        with Recording(path, self.recording_id, self.blueprint) as file:
            file.send(self.chunks)

    @cached_property
    def path(self) -> Path:
        """A file with it, written now, in a temporary folder that lives as long as this object."""
        path = self._new_file()
        self.write(path)
        return path

    def __getstate__(self) -> bytes:
        return self.path.read_bytes()

    def __setstate__(self, content: bytes) -> None:
        self.chunks = []
        self.path = self._new_file()
        self.path.write_bytes(content)

    def _new_file(self) -> Path:
        folder = temporary_folder()
        weakref.finalize(self, folder.cleanup)
        return Path(folder.name) / "episode.rrd"


class Recording(Sink):
    """A recording being written; a context manager that completes it, also after an error.

    Args:
        path: of the complete file.
        recording_id: identity of the recording.
        blueprint: what the viewer shows when the file is opened.
        viewer: address of a running viewer that gets the same data, if any.

    Attributes:
        path: of the complete file.
        stream: Rerun's recording stream.

    Raises:
        UserError: the folder cannot be written, or the disk is full.
    """

    def __init__(
        self,
        path: Path,
        recording_id: str,
        blueprint: rrb.Blueprint | None,
        viewer: str | None = None,
    ) -> None:
        super().__init__()
        self.path = path
        self._part = path.with_name(path.name + ".part")
        self._open = True
        self._viewer, self._lost = viewer, False
        path.parent.mkdir(parents=True, exist_ok=True)
        self.check_space()
        self.stream = rr.RecordingStream(
            APPLICATION, recording_id=recording_id, send_properties=False
        )
        self._file = PipedFile(self._part)
        sinks = [rr.FileSink(self._file.address)] + ([rr.GrpcSink(viewer)] if viewer else [])
        try:
            self.stream.set_sinks(*sinks, default_blueprint=blueprint)
        except Exception as error:  # rerun raises RuntimeError whatever the cause
            self._part.unlink()
            raise UserError(
                f"cannot write the recording {path}: {error}; choose another --out"
            ) from error
        finally:
            self._file.opened()
        self.stream.set_log_time_enabled(False)  # equal runs give equal files
        self.stream.set_log_tick_enabled(False)

    def __enter__(self) -> "Recording":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def check_space(self) -> None:
        """Raise UserError while the file can still be completed, if the disk fills up."""
        if shutil.disk_usage(self.path.parent).free < LEAST_FREE_BYTES:
            raise UserError(
                f"less than {LEAST_FREE_BYTES / 1e6:.0f} MB are free for the recording "
                f"{self.path}; free some space or choose another --out"
            )

    def send(self, chunks: Iterable[Chunk]) -> None:
        """Write chunks."""
        self.stream.send_chunks(chunks)

    def flush(self) -> None:
        """Write out the data so far.

        Raises:
            UserError: it did not reach the disk, or not in time.
        """
        super().flush()
        self._write_through()
        try:
            self._file.settle()
        except OSError as error:
            raise self._incomplete(error) from error
        _give_back_memory()

    def _write_through(self) -> None:
        try:
            self.stream.flush(timeout_sec=FLUSH_TIMEOUT_S)
        except Exception as error:
            if self._viewer and "gRPC" in str(error):
                self._lose_viewer()
                return
            self._open = False
            atexit.register(_leave, self.stream)  # disconnecting it might never return
            if self._viewer:
                raise UserError(
                    f"the viewer at {self._viewer} does not accept recorded data ({error}); start "
                    f"it again or leave it out; {self._part} can be read so far"
                ) from error
            raise self._incomplete(error) from error

    def _lose_viewer(self) -> None:
        """Report once that the viewer is gone; later data still goes to the file."""
        if not self._lost:
            print(
                f"the viewer at {self._viewer} is gone; {self.path} is written on", file=sys.stderr
            )
        self._lost = True

    def _incomplete(self, error: Exception) -> UserError:
        why = error.strerror if isinstance(error, OSError) else error
        return UserError(
            f"the recording {self._part} could not be written out ({why}); free some disk space; "
            "it and other .part files next to it can be read"
        )

    def close(self) -> None:
        """Complete the file and give it its name.

        Raises:
            UserError: it is not whole; what there is of it keeps its provisional name.
        """
        if not self._open:
            return
        self.send_rows()
        self._write_through()
        self._open = False
        self.stream.disconnect()
        del self.stream
        # Rerun keeps a recording's threads until it looks for recordings that nothing refers to.
        rerun_bindings.flush_and_cleanup_orphaned_recordings()
        try:
            self._file.close(FLUSH_TIMEOUT_S)
            with self._part.open("rb") as file:  # the end says where everything is
                file.seek(-_END_BYTES, os.SEEK_END)
                if not file.read().startswith(_END):
                    raise OSError("its end is missing")
        except OSError as error:
            raise self._incomplete(error) from error
        self._part.replace(self.path)


def _give_back_memory() -> None:
    """Return to the system what allocators keep of chunks that are written, ever more of it."""
    pa.default_memory_pool().release_unused()
    if sys.platform == "linux":
        getattr(ctypes.CDLL(None), "malloc_trim", int)(0)  # only glibc has it


def _leave(_: rr.RecordingStream) -> None:
    """End the process before Rerun's own exit handler disconnects the stream."""
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(USER_ERROR_STATUS)


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


def properties(values: Mapping[str, Any]) -> rr.AnyValues:
    """Values for a recording's properties: numbers and strings as they are, the rest as JSON."""
    known: dict[str, Any] = {
        key: value
        if isinstance(value, int | float | str)
        else json.dumps(value, ensure_ascii=False)
        for key, value in values.items()
    }
    return rr.AnyValues(**known)

"""A Rerun file of any content as numpy arrays.

Reads whole files, files without a footer (their writer was killed) and files cut in the middle.
What the signals of an episode mean is said in `cosim.recording.reader`.
"""

import subprocess
import sys
import warnings
from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
from rerun.chunk import Chunk, RrdReader

from cosim.base.errors import FileError
from cosim.base.reading import Kind, require_file
from cosim.base.storage import temporary_folder

TIMELINE = "sim_time"
# Columns read as arrays: what is added to the entity's path to name the signal, and its unit; a
# recorder says the unit of scalars.
_NUMBERS = {
    "Scalars:scalars": ("", ""),
    "Transform3D:translation": (":translation", "m"),
    "Transform3D:quaternion": (":quaternion", "1"),
}
_UNIT = "unit"
_TEXTS = ("StateChange:state", "TextLog:text")
_NAMES = "SeriesLines:names"
_PROPERTIES = "/__properties/"


class Signal(NamedTuple):
    """A signal over simulated time, in order of time.

    Attributes:
        time_s: (n,) float64.
        values: (n,) or, for several components, (n, k) float64.
        components: names of the k components, as far as the recording names them.
        unit: of the values; empty if the recording does not say it.
    """

    time_s: np.ndarray
    values: np.ndarray
    components: tuple[str, ...]
    unit: str

    @property
    def names(self) -> tuple[str, ...]:
        """Return the names of all components: those of the recording, or their numbers."""
        count = 1 if self.values.ndim == 1 else self.values.shape[1]
        return self.components if len(self.components) == count else tuple(map(str, range(count)))


class Texts(NamedTuple):
    """States or log lines over simulated time.

    Attributes:
        time_s: (n,) float64, in order.
        texts: n of them.
    """

    time_s: np.ndarray
    texts: tuple[str, ...]


@dataclass(frozen=True)
class RecordingData:
    """Contents of a recording.

    Attributes:
        path: of the file, None in memory.
        recording_id: its identity; equal runs have equal ones.
        complete: whether its writer completed it.
        signals: by entity path, such as "/sim/r1/motors/omega"; a pose is two signals,
            "<path>:translation" in m and "<path>:quaternion" (x, y, z, w).
        texts: states and logs by entity path.
        properties: by their name, such as "episode", then by key.
    """

    path: Path | None
    recording_id: str
    complete: bool
    signals: dict[str, Signal]
    texts: dict[str, Texts]
    properties: dict[str, dict[str, Any]]


def read_rrd(path: Path) -> RecordingData:
    """Read a recording on the timeline `sim_time`.

    Args:
        path: an .rrd file, or the .rrd.part that a killed writer left.

    Raises:
        FileError: there is no such file, or it is no recording.
    """
    part = path.parent / f"{path.name}.part"
    left = not path.exists() and part.is_file()
    fix = f"its writer left {part}, read that" if left else "name an .rrd file"
    require_file(path, Kind("recording", fix))
    try:
        return _read_whole(path)
    except (RuntimeError, ValueError) as error:
        broken = error
    with temporary_folder() as folder:
        repaired = Path(folder) / "repaired.rrd"
        # Only the command line skips a frame that was cut off.
        command = [sys.executable, "-m", "rerun", "rrd", "optimize", str(path), "-o", str(repaired)]
        run = subprocess.run(command, capture_output=True, check=False)
        if run.returncode == 0 and repaired.is_file():
            try:
                return _read_whole(repaired, path)
            except (RuntimeError, ValueError) as error:
                broken = error
    raise FileError(
        f"{path} is not a readable Rerun recording ({broken}); record one with `minirobots run`"
    )


def _read_whole(file: Path, original: Path | None = None) -> RecordingData:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # rerun warns of a missing footer; `complete` says it
        reader = RrdReader(str(file))
        entries = reader.recordings()
        if not entries:
            raise ValueError("it holds no recording")
        if len(entries) > 1:
            raise FileError(
                f"{original or file} holds {len(entries)} recordings; name a file with one"
            )
        complete = original is None and _has_footer(reader)
        chunks = reader.stream().to_chunks()
    return read_chunks(chunks, entries[0].recording_id, original or file, complete)


def read_chunks(
    chunks: Iterable[Chunk], recording_id: str, path: Path | None = None, complete: bool = True
) -> RecordingData:
    """Read the chunks of a recording, as `read_rrd` does those of a file.

    Args:
        chunks: all of them.
        recording_id: its identity.
        path: of the file that they come from, if any.
        complete: whether these are all that there should be.

    Raises:
        FileError: a signal changes its number of components.
    """
    moving: dict[tuple[str, str], list[pa.RecordBatch]] = defaultdict(list)
    names: dict[str, tuple[str, ...]] = {}
    units: dict[str, str] = {}
    properties: dict[str, dict[str, Any]] = {}
    for chunk in chunks:
        batch = chunk.to_record_batch()
        if chunk.is_static:
            if chunk.entity_path.startswith(_PROPERTIES):
                name = chunk.entity_path.removeprefix(_PROPERTIES)
                properties.setdefault(name, {}).update(_values(batch))
                continue
            first = _values(batch)
            if _NAMES in batch.schema.names:
                names[chunk.entity_path] = tuple(batch.column(_NAMES)[0].as_py() or ())
            if _UNIT in first:
                units[chunk.entity_path] = str(first[_UNIT])
        elif TIMELINE in batch.schema.names:
            for column in {*_NUMBERS, *_TEXTS} & {*batch.schema.names}:
                moving[chunk.entity_path, column].append(batch)
    signals, texts = {}, {}
    for (entity, column), batches in sorted(moving.items()):
        if column in _TEXTS:
            texts[entity] = _texts(batches, column)
        else:
            ending, unit = _NUMBERS[column]
            key, unit = entity + ending, unit or units.get(entity, "")
            signals[key] = _signal(key, batches, column, names.get(entity, ()), unit)
    return RecordingData(path, recording_id, complete, signals, texts, properties)


def _has_footer(reader: RrdReader) -> bool:
    try:
        reader.store()
    except (RuntimeError, ValueError):
        return False
    return True


def _values(batch: pa.RecordBatch) -> dict[str, Any]:
    """First value of every column of a static chunk."""
    found = {}
    for name in batch.schema.names:
        if name.startswith("rerun.controls"):
            continue
        row = batch.column(name)[0].as_py()
        if row:
            found[name] = row[0]
    return found


def _in_order(batches: Iterable[pa.RecordBatch], column: str) -> tuple[np.ndarray, pa.Array]:
    """Times in s and the column's non-empty rows in order of time."""
    table = pa.Table.from_batches(
        [batch.select([TIMELINE, column]) for batch in batches]
    ).combine_chunks()
    rows = table.column(column).combine_chunks()
    lengths = rows.value_lengths().fill_null(0).to_numpy(zero_copy_only=False)
    time_s = table.column(TIMELINE).to_numpy() / np.timedelta64(1, "s")
    kept = np.flatnonzero((lengths > 0) & np.isfinite(time_s))
    order = kept[np.argsort(time_s[kept], kind="stable")]
    return time_s[order], rows.take(pa.array(order))


def _signal(
    key: str, batches: list[pa.RecordBatch], column: str, components: tuple[str, ...], unit: str
) -> Signal:
    time_s, rows = _in_order(batches, column)
    flat = rows.flatten()
    if pa.types.is_fixed_size_list(flat.type):
        flat = flat.flatten()
    values = flat.to_numpy(zero_copy_only=False).astype(np.float64)
    if not len(time_s):
        return Signal(time_s, np.zeros(0), components, unit)
    if values.size % len(time_s):
        raise FileError(f"signal {key} changes its number of components; record it again")
    values = values.reshape(len(time_s), -1)
    return Signal(time_s, values[:, 0] if values.shape[1] == 1 else values, components, unit)


def _texts(batches: list[pa.RecordBatch], column: str) -> Texts:
    time_s, rows = _in_order(batches, column)
    return Texts(time_s, tuple(row[0] for row in rows.to_pylist()))

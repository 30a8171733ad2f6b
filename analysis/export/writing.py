"""Writes an episode in a format of other programs.

Tables have a row per value: signal, component, unit, time, value, and text for states; they are
written signal by signal. What was run is metadata of Parquet, and a variable of MATLAB.
"""

import json
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet
import scipy.io

from analysis.export.content import Format, facts_of
from analysis.export.messages import write_messages
from cosim.base.progress import Progress, silent
from cosim.base.storage import replacing
from cosim.recording.reader import Episode

METADATA_KEY = "minirobots"
_NAME = pa.dictionary(pa.int32(), pa.string())
_SCHEMA = pa.schema(
    {
        "signal": _NAME,
        "component": _NAME,
        "unit": _NAME,
        "time_s": pa.float64(),
        "value": pa.float64(),
        "text": pa.string(),
    }
)
_PLAIN = pa.schema({f.name: pa.string() if f.type == _NAME else f.type for f in _SCHEMA})
_LONGEST_NAME = 63  # of a variable of MATLAB


def export(episode: Episode, to: Format, out: Path, progress: Progress = silent) -> None:
    """Write an episode's signals and states, whole or not at all.

    Args:
        episode: to write.
        to: format.
        out: file to write; its folder is made if it is missing.
        progress: receives every signal.

    Raises:
        ExportError: the format needs a package that is not installed.
    """
    writers: dict[Format, Callable[[Episode, Path, Progress], None]] = {
        "parquet": _write_parquet,
        "csv": _write_csv,
        "mcap": write_messages,
        "mat": _write_mat,
    }
    with replacing(out) as temporary:
        writers[to](episode, temporary, progress)


def _tables(episode: Episode, progress: Progress) -> Iterator[pa.Table]:
    """A table per signal, then one per state or log."""
    total = len(episode.signals) + len(episode.texts)
    for done, (path, signal) in enumerate(episode.signals.items()):
        progress("exporting", done, total)
        names = signal.names
        values = np.ascontiguousarray(signal.values, np.float64).reshape(-1)
        rows = len(signal.time_s)
        numbers = np.tile(np.arange(len(names), dtype=np.int32), rows)
        component = pa.DictionaryArray.from_arrays(numbers, list(names))
        times = np.repeat(signal.time_s, len(names))
        yield _table(path, component, signal.unit, times, value=values)
    for path, texts in episode.texts.items():
        yield _table(path, _same("", len(texts.texts)), "", texts.time_s, text=texts.texts)
    progress("exporting", total, total)


def _same(text: str, count: int) -> pa.DictionaryArray:
    return pa.DictionaryArray.from_arrays(np.zeros(count, dtype=np.int32), [text])


def _table(
    path: str, component: pa.DictionaryArray, unit: str, time_s: np.ndarray, **given: Any
) -> pa.Table:
    count = len(time_s)
    columns = {"signal": _same(path, count), "component": component, "unit": _same(unit, count)}
    columns["time_s"] = pa.array(time_s)
    for name in ("value", "text"):
        kind = _SCHEMA.field(name).type
        columns[name] = pa.array(given[name], kind) if name in given else pa.nulls(count, kind)
    return pa.table(columns, schema=_SCHEMA)


def _write_parquet(episode: Episode, out: Path, progress: Progress) -> None:
    schema = _SCHEMA.with_metadata({METADATA_KEY: json.dumps(facts_of(episode))})
    with pyarrow.parquet.ParquetWriter(out, schema, compression="zstd") as writer:
        for table in _tables(episode, progress):
            writer.write_table(table.cast(schema))


def _write_csv(episode: Episode, out: Path, progress: Progress) -> None:
    with pyarrow.csv.CSVWriter(out, _PLAIN) as writer:
        for table in _tables(episode, progress):
            writer.write_table(table.cast(_PLAIN))


def _write_mat(episode: Episode, out: Path, progress: Progress) -> None:
    """A struct per signal, named by its path with underscores, and one with the configuration."""
    variables: dict[str, Any] = {"facts": json.dumps(facts_of(episode))}
    for path, signal in episode.signals.items():
        variables[_identifier(path, variables)] = {
            "path": path,
            "unit": signal.unit,
            "components": np.array(signal.names, dtype=object),
            "time_s": signal.time_s[:, None],
            "values": signal.values.reshape(len(signal.time_s), -1),
        }
    for path, texts in episode.texts.items():
        variables[_identifier(path, variables)] = {
            "path": path,
            "time_s": texts.time_s[:, None],
            "texts": np.array(texts.texts, dtype=object)[:, None],
        }
    progress("exporting", 0, None)
    with out.open("wb") as file:
        scipy.io.savemat(file, variables, long_field_names=True, do_compression=True)
    progress("exporting", 1, 1)


def _identifier(path: str, taken: dict[str, Any]) -> str:
    """A variable's name that is not taken yet."""
    name = re.sub(r"\W+", "_", path.strip("/"))[:_LONGEST_NAME]
    number = 1
    while name in taken:
        number += 1
        name = f"{name[: _LONGEST_NAME - 4]}_{number}"
    return name

"""Writes a recorded episode as a table for programs without Rerun.

The table has a row per value: signal, component, unit, time, value, and text for states. It is
written signal by signal.
"""

import json
from collections.abc import Iterator, Sequence
from dataclasses import replace
from fnmatch import fnmatchcase
from itertools import starmap
from pathlib import Path
from typing import Literal

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet

from cosim.base.errors import UserError
from cosim.base.progress import Progress, silent
from cosim.base.storage import replacing
from cosim.recording.reader import PREFIXES, Episode, Signals

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


def chosen(episode: Episode, names: Sequence[str] = (), rate_hz: float | None = None) -> Episode:
    """Return an episode with some of its signals and states.

    Args:
        names: of signals and states, perhaps without the first part of their path, or patterns with
            `*` and `?`; none for all.
        rate_hz: samples of each signal per second: the first one of every period, as it is; all by
            default. States stay.
    """
    if rate_hz is not None and not 0.0 < rate_hz < 1e9:
        raise UserError(
            f"--rate {rate_hz:g} is invalid; give samples per second above 0 and below 1e9"
        )
    paths = [*episode.signals, *episode.texts]
    kept = set() if names else {*paths}
    for name in names:
        found = {path for path in paths if any(fnmatchcase(path, p + name) for p in PREFIXES)}
        if not found:
            raise UserError(
                f"--signals {name}: {episode.origin} has no such signal or state; "
                "`minirobots inspect` lists them"
            )
        kept |= found
    signals = {path: signal for path, signal in episode.signals.items() if path in kept}
    if rate_hz is not None:
        for path, signal in signals.items():
            _, rows = np.unique(np.floor(signal.time_s * rate_hz + 1e-6), return_index=True)
            signals[path] = signal._replace(time_s=signal.time_s[rows], values=signal.values[rows])
    texts = {path: text for path, text in episode.texts.items() if path in kept}
    return replace(episode, signals=Signals(episode.origin, signals), texts=texts)


def export(
    episode: Episode, to: Literal["parquet", "csv"], out: Path, progress: Progress = silent
) -> None:
    """Write an episode's signals and states, whole or not at all.

    Parquet has the run, its outcome and every parameter as JSON in its metadata.

    The folder of `out` is made if it is missing.
    """
    facts = {
        "facts": dict(episode.facts),
        "outcome": episode.outcome,
        "complete": episode.complete,
        "parameters": {name: p._asdict() for name, p in episode.parameters.items()},
    }
    with replacing(out) as temporary:
        if to == "parquet":
            schema = _SCHEMA.with_metadata({METADATA_KEY: json.dumps(facts)})
            writer = pyarrow.parquet.ParquetWriter(temporary, schema, compression="zstd")
        else:
            schema = _PLAIN
            writer = pyarrow.csv.CSVWriter(temporary, schema)
        with writer:
            for table in _tables(episode, progress):
                writer.write_table(table.cast(schema))


def _tables(episode: Episode, progress: Progress) -> Iterator[pa.Table]:
    """A table per signal, then one per state or log."""
    total = len(episode.signals) + len(episode.texts)
    for done, (path, signal) in enumerate(episode.signals.items()):
        progress("exporting", done, total)
        values = np.ascontiguousarray(signal.values, np.float64).reshape(-1)
        yield _table(path, signal.names, signal.unit, signal.time_s, value=pa.array(values))
    for path, (time_s, texts) in episode.texts.items():
        yield _table(path, ("",), "", time_s, text=pa.array(texts, pa.string()))
    progress("exporting", total, total)


def _table(
    path: str, names: Sequence[str], unit: str, time_s: np.ndarray, **of_rows: pa.Array
) -> pa.Table:
    """Return a row per time (n,) and component, with a value or a text each."""
    count = len(time_s) * len(names)
    same, components = np.zeros(count, np.int32), np.arange(len(names), dtype=np.int32)
    words = (same, [path]), (np.tile(components, len(time_s)), list(names)), (same, [unit])
    columns = [*starmap(pa.DictionaryArray.from_arrays, words), np.repeat(time_s, len(names))]
    columns += [of_rows.get(name, pa.nulls(count)) for name in ("value", "text")]
    return pa.table(columns, schema=_SCHEMA)

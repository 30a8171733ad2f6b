"""Writes an episode as MCAP: a channel of JSON messages per signal, in order of time.

MCAP (mcap.dev) is what Foxglove and other viewers of robots read. A message has its values by
component, null where one is not finite; a channel's metadata say its unit.
"""

import heapq
from collections.abc import Iterator, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from analysis.export.content import ExportError, facts_of
from cosim.base.errors import installing
from cosim.base.progress import Progress
from cosim.recording.reader import Episode

_TOLD_EVERY = 20_000  # messages
_encode = msgspec.json.encode


def write_messages(episode: Episode, out: Path, progress: Progress) -> None:
    """Write an MCAP file.

    Args:
        episode: to write.
        out: file to write.
        progress: receives the messages written.

    Raises:
        ExportError: the package mcap is not installed.
    """
    if find_spec("mcap") is None:
        raise ExportError(f"mcap files need the extra export: `{installing('export')}`")
    from mcap.writer import Writer

    with out.open("wb") as file:
        writer = Writer(file)
        writer.start(profile="", library="minirobots")
        about = {name: _encode(value).decode() for name, value in facts_of(episode).items()}
        writer.add_metadata("minirobots", about)
        streams = []
        for path, signal in episode.signals.items():
            names = signal.names
            channel = _channel(writer, path, dict.fromkeys(names, "number"), signal.unit)
            rows = signal.values.reshape(len(signal.time_s), -1)
            streams.append(_messages(channel, signal.time_s, names, rows))
        for path, texts in episode.texts.items():
            channel = _channel(writer, path, {"text": "string"}, "")
            rows = np.array(texts.texts, dtype=object)[:, None]
            streams.append(_messages(channel, texts.time_s, ("text",), rows))
        times = (*episode.signals.values(), *episode.texts.values())
        total = sum(len(stream.time_s) for stream in times)
        for done, (time_ns, channel, message) in enumerate(
            heapq.merge(*streams, key=lambda m: m[:2])
        ):
            if done % _TOLD_EVERY == 0:
                progress("exporting", done, total)
            writer.add_message(channel, time_ns, _encode(message), time_ns)
        writer.finish()
    progress("exporting", total, total)


def _channel(writer: Any, path: str, kinds: dict[str, str], unit: str) -> int:
    properties = {name: {"type": kind, "description": unit} for name, kind in kinds.items()}
    schema = _encode({"type": "object", "title": path, "properties": properties})
    number = writer.register_schema(name=path, encoding="jsonschema", data=schema)
    metadata = {"unit": unit, "components": _encode(list(kinds)).decode()}
    return writer.register_channel(path, "json", number, metadata)


def _messages(
    channel: int, times_s: np.ndarray, names: Sequence[str], rows: np.ndarray
) -> Iterator[tuple[int, int, dict[str, Any]]]:
    """Times in ns, which recordings count in, the channel, and messages."""
    for time_s, row in zip(times_s.tolist(), rows, strict=True):
        yield round(1e9 * time_s), channel, dict(zip(names, row.tolist(), strict=True))

"""A Rerun file of any content as numpy arrays with units, and what they mean of an episode.

Reads whole files, files without a footer (their writer was killed) and files cut in the middle.
Every signal of a file is there, also what is not in `cosim.recording.series`.
"""

import contextlib
import difflib
import json
import re
import shutil
import subprocess
import sys
import warnings
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np
import pyarrow as pa
from rerun.chunk import Chunk, RrdReader

from cosim.base.errors import FileError
from cosim.base.reading import Kind, parsing, require_file
from cosim.base.storage import replacing, require_suffix, temporary_folder
from cosim.model.scenario import Scenario
from cosim.recording.file import Kept
from cosim.recording.series import ENDED, GIVEN_UP, OUTCOME, STILL_RUNNING

TIMELINE = "sim_time"
# Columns read as arrays: what is added to the entity's path to name the signal, and its unit; a
# recorder says the unit of scalars.
_NUMBERS = {
    "Scalars:scalars": ("", ""),
    "Transform3D:translation": (":translation", "m"),
    "Transform3D:quaternion": (":quaternion", "1"),
}
_TEXTS = ("StateChange:state", "TextLog:text")
_PROPERTIES = "/__properties/"
_ROBOT = re.compile(r"^/(sim|raw|rl)/([^/]+)/")
# What a signal's name may leave out, in the order of being tried.
PREFIXES = ("", "/", "/sim/", "/rl/", "/raw/", "/world/")


EPISODE = Kind("recording of an episode", "record it again")


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
    """States or log lines over simulated time: (n,) times in order, and n texts."""

    time_s: np.ndarray
    texts: tuple[str, ...]


_NOTHING = Texts(np.zeros(0), ())


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
    """Read a recording on the timeline `sim_time`."""
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
    path = original or file
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # rerun warns of a missing footer; `complete` says it
        reader = RrdReader(str(file))
        entries = reader.recordings()
        if not entries:
            raise ValueError("it holds no recording")
        if len(entries) > 1:
            raise FileError(f"{path} holds {len(entries)} recordings; name a file with one")
        try:
            reader.store()
            complete = original is None
        except (RuntimeError, ValueError):  # it has no footer
            complete = False
        chunks = reader.stream().to_chunks()
    return read_chunks(chunks, entries[0].recording_id, path, complete)


def read_chunks(
    chunks: Iterable[Chunk], recording_id: str, path: Path | None = None, complete: bool = True
) -> RecordingData:
    """Read all chunks of a recording, as `read_rrd` does those of a file."""
    moving: dict[tuple[str, str], list[pa.RecordBatch]] = defaultdict(list)
    fixed: dict[str, dict[str, list[Any]]] = defaultdict(dict)
    for chunk in chunks:
        batch = chunk.to_record_batch()
        if chunk.is_static:
            values = {name: batch.column(name)[0].as_py() for name in batch.schema.names}
            fixed[chunk.entity_path] |= {name: row for name, row in values.items() if row}
        elif TIMELINE in batch.schema.names:
            for column in {*_NUMBERS, *_TEXTS} & {*batch.schema.names}:
                moving[chunk.entity_path, column].append(batch)
    signals, texts = {}, {}
    for (entity, column), batches in sorted(moving.items()):
        time_s, rows = _in_order(batches, column)
        if column in _TEXTS:
            texts[entity] = Texts(time_s, tuple(row[0] for row in rows.to_pylist()))
        else:
            (ending, unit), style = _NUMBERS[column], fixed[entity]
            values = _values(entity + ending, rows)
            components = tuple(style.get("SeriesLines:names", ()))
            unit = unit or str(*style.get("unit", ()))
            signals[entity + ending] = Signal(time_s, values, components, unit)
    properties = {
        entity.removeprefix(_PROPERTIES): {
            name: row[0] for name, row in values.items() if not name.startswith("rerun.controls")
        }
        for entity, values in fixed.items()
        if entity.startswith(_PROPERTIES)
    }
    return RecordingData(path, recording_id, complete, signals, texts, properties)


def _in_order(batches: Iterable[pa.RecordBatch], column: str) -> tuple[np.ndarray, pa.Array]:
    """Times in s and the column's non-empty rows in order of time."""
    table = pa.Table.from_batches([batch.select([TIMELINE, column]) for batch in batches])
    rows = table.column(column).combine_chunks()
    lengths = rows.value_lengths().fill_null(0).to_numpy(zero_copy_only=False)
    time_s = table.column(TIMELINE).to_numpy() / np.timedelta64(1, "s")
    kept = np.flatnonzero((lengths > 0) & np.isfinite(time_s))
    order = kept[np.argsort(time_s[kept], kind="stable")]
    return time_s[order], rows.take(pa.array(order))


def _values(name: str, rows: pa.Array) -> np.ndarray:
    """Numbers of a signal: (n,), or (n, k) of k components."""
    flat = rows.flatten()
    if pa.types.is_fixed_size_list(flat.type):
        flat = flat.flatten()
    values = flat.to_numpy(zero_copy_only=False).astype(np.float64)
    if not len(rows):
        return np.zeros(0)
    if values.size % len(rows):
        raise FileError(f"signal {name} changes its number of components; record it again")
    values = values.reshape(len(rows), -1)
    return values[:, 0] if values.shape[1] == 1 else values


class Parameter(NamedTuple):
    """A parameter of the run: its value in the given unit, what it is, and its source."""

    value: float | bool | str | list[Any]
    unit: str
    description: str
    source: str


class DrivenMove(NamedTuple):
    """A commanded move of a robot.

    Attributes:
        start_s: time of the decision.
        end_s: time at which it ended, was given up, or was cut off by the episode's end.
        direction: commanded, such as "45°".
        ended: whether the robot ended it.
        given_up: whether it took too long and was given up for another.
    """

    start_s: float
    end_s: float
    direction: str
    ended: bool
    given_up: bool


class _Simulated(msgspec.Struct):
    """The part of a recording's property `origin` that is read here."""

    scenario: Scenario


class SignalError(FileError, KeyError):
    """A signal that a recording lacks; the message names it and those with names like it."""

    __str__ = Exception.__str__  # a KeyError would put its message in quotes


class Signals(Mapping[str, Signal]):
    """Signals of a recording by entity path, which may lack its first part.

    `signals["r1/motors/omega"]` is `signals["/sim/r1/motors/omega"]`. Exact paths come first, then
    those below /sim, /rl, /raw and /world. Iterating gives whole paths.

    Args:
        origin: what they are of, for messages.
        signals: by whole path.
    """

    def __init__(self, origin: str, signals: Mapping[str, Signal]) -> None:
        self._origin, self._signals = origin, signals

    def __getitem__(self, name: str) -> Signal:
        """The signal of a name."""
        for prefix in PREFIXES:
            if prefix + name in self._signals:
                return self._signals[prefix + name]
        short = [path.split("/", 2)[-1] for path in self._signals]
        near = difflib.get_close_matches(name, [*self._signals, *short], n=3)
        fix = (
            f"like it are {', '.join(near)}"
            if near
            else "record with the defaults of `minirobots run`"
        )
        raise SignalError(f"{self._origin} has no signal {name}; {fix}")

    def __iter__(self) -> Iterator[str]:
        return iter(self._signals)

    def __len__(self) -> int:
        return len(self._signals)


@dataclass(frozen=True, eq=False, repr=False)
class Episode:
    """The record of an episode: configuration, outcome, and every signal.

    >>> import minirobots as mr
    >>> policy = mr.train("1a", method="shortest", progress=None)
    >>> episode = mr.simulate("1a", policy, time_limit=4.0, progress=None)
    >>> episode.signals["r1/motors/omega"].unit
    'rad/s'

    Attributes:
        recording: a file, or what keeps the episode in memory.
        recording_id: its identity.
        complete: whether its writer completed it; a killed one leaves what it had written.
        outcome: success, collision, out_of_board or timeout; empty if the recording ends before.
        time_s: simulated time at the end, that of the last sample.
        robots: their names in entity paths: r1, r2 and so on.
        facts: scenario, seed, episode, start cells, targets, versions and what else identifies the
            run, as JSON holds it.
        parameters: by name.
        signals: values, unit, times and components by entity path, such as
            "/sim/r1/motors/omega" or, in short, "r1/motors/omega".
        texts: states and the log by entity path, such as "/rl/r1/failure".
        moves: of each robot, in order.
        scenario: its board; None in recordings of other programs.
    """

    recording: Path | Kept
    recording_id: str
    complete: bool
    outcome: str
    time_s: float
    robots: tuple[str, ...]
    facts: Mapping[str, Any]
    parameters: Mapping[str, Parameter]
    signals: Signals
    texts: Mapping[str, Texts]
    moves: Mapping[str, tuple[DrivenMove, ...]]
    scenario: Scenario | None = None

    @property
    def path(self) -> Path:
        """Return the recording, which is written to a temporary folder if it was in memory only."""
        return self.recording if isinstance(self.recording, Path) else self.recording.path

    @property
    def origin(self) -> str:
        """Return what messages call the episode."""
        return str(self.recording) if isinstance(self.recording, Path) else "the episode"

    def __repr__(self) -> str:
        return f"Episode({self.origin}: {self.outcome or 'unfinished'}, {self.time_s:g} s)"

    def parameter(self, name: str) -> float:
        """The value of a numeric parameter."""
        parameter = self.parameters.get(name)
        if parameter is None or isinstance(parameter.value, (str, list)):
            raise FileError(f"{self.origin} lacks its parameter {name}; record it again")
        return float(parameter.value)

    def save(self, path: Path | str) -> None:
        """Write the recording to a file that is not there yet."""
        path = require_suffix(path, ".rrd")
        if path.exists():
            raise FileError(f"{path}: it exists; move it away or choose another name")
        if isinstance(self.recording, Kept):
            self.recording.write(path)
            return
        require_file(self.recording, EPISODE)
        with replacing(path) as temporary:
            shutil.copyfile(self.recording, temporary)


def read_episode(recording: Path | Kept) -> Episode:
    """Read the recording of an episode, whole or left by a killed writer, or from memory."""
    if isinstance(recording, Path):
        path, data = recording, read_rrd(recording)
    else:
        path, data = Path("the episode"), read_chunks(recording.chunks, recording.recording_id)
    if "episode" not in data.properties:
        raise FileError(f"{path} holds no episode; record one with `minirobots run`")
    ends = [
        (match[2], float(signal.time_s[-1]))
        for key, signal in data.signals.items()
        if (match := _ROBOT.match(key)) and len(signal.time_s)
    ]
    robots = sorted({name for name, _ in ends}, key=lambda name: (len(name), name))  # r10 after r2
    if not robots:
        raise FileError(
            f"{path} ends before the first signals of its episode were written; record it again"
        )
    outcomes = [t for t in data.texts.get(OUTCOME, _NOTHING).texts if t != STILL_RUNNING]
    if len(outcomes) > 1:
        raise FileError(
            f"{path} holds {len(outcomes)} episodes merged into one; name a file with one"
        )
    time_s = max(end_s for _, end_s in ends)
    facts = dict(data.properties["episode"])
    for key, value in facts.items():
        if isinstance(value, str) and value[:1] in {"[", "{"}:  # start cells, versions
            with contextlib.suppress(ValueError):
                facts[key] = json.loads(value)
    with parsing(path, EPISODE):
        parameters = {
            name: Parameter(**json.loads(text))
            for name, text in data.properties.get("parameters", {}).items()
        }
        origin = data.properties.get("origin", {}).get("task")
        scenario = msgspec.json.decode(origin, type=_Simulated).scenario if origin else None
    return Episode(
        recording=recording,
        recording_id=data.recording_id,
        complete=data.complete,
        outcome="".join(outcomes),
        time_s=time_s,
        robots=tuple(robots),
        facts=facts,
        parameters=parameters,
        signals=Signals(str(path), data.signals),
        texts=data.texts,
        moves={r: _moves(data.texts.get(f"/rl/{r}/move", _NOTHING), time_s) for r in robots},
        scenario=scenario,
    )


def _moves(states: Texts, end_s: float) -> tuple[DrivenMove, ...]:
    """Moves of a robot: a direction, and how long it is in force until the next state."""
    rows = [*zip(states.time_s.tolist(), states.texts, strict=True), (end_s, "")]
    return tuple(
        DrivenMove(start_s, until_s, direction, after == ENDED, after == GIVEN_UP)
        for (start_s, direction), (until_s, after) in pairwise(rows)
        if direction not in {ENDED, GIVEN_UP}
    )

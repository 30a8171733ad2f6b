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
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import msgspec
import numpy as np
import pyarrow as pa
from rerun.chunk import Chunk, RrdReader

from cosim.base.errors import FileError
from cosim.base.reading import Kind, parsing, require_file
from cosim.base.storage import replacing, require_suffix
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
    """Contents of a recording."""

    path: Path | None
    recording_id: str
    complete: bool  # whether its writer completed it
    # By entity path, such as "/sim/r1/motors/omega"; a pose is two signals, "<path>:translation" in
    # m and "<path>:quaternion" (x, y, z, w)
    signals: dict[str, Signal]
    texts: dict[str, Texts]
    properties: dict[str, dict[str, Any]]  # by their name, such as "episode", then by key


def read_rrd(path: Path, without: Sequence[str] = ()) -> RecordingData:
    """Read a recording on the timeline `sim_time`, `without` some entities, such as "/world/**"."""
    part = path.parent / f"{path.name}.part"
    left = not path.exists() and part.is_file()
    fix = f"its writer left {part}, read that" if left else "name an .rrd file"
    require_file(path, Kind("recording", fix))
    try:
        return _read_whole(path, path, without)
    except (RuntimeError, ValueError) as error:
        broken = error
    with TemporaryDirectory() as folder:
        repaired = Path(folder) / "repaired.rrd"
        # Only the command line skips a frame that was cut off.
        command = [sys.executable, "-m", "rerun", "rrd", "optimize", str(path), "-o", str(repaired)]
        run = subprocess.run(command, capture_output=True, check=False)
        if run.returncode == 0 and repaired.is_file():
            try:
                return _read_whole(repaired, path, without)
            except (RuntimeError, ValueError) as error:
                broken = error
    raise FileError(
        f"{path} is not a readable Rerun recording ({broken}); record one with `minirobots run`"
    )


def _read_whole(file: Path, path: Path, without: Sequence[str]) -> RecordingData:
    """Read a file, which may be one that was made of the recording at the path."""
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
            complete = file == path
        except (RuntimeError, ValueError):  # it has no footer
            complete = False
        stream = reader.stream()
        for entities in without:
            stream = stream.drop(content=entities)
        return read_chunks(stream, entries[0].recording_id, path, complete)


def read_chunks(
    chunks: Iterable[Chunk], recording_id: str, path: Path | None = None, complete: bool = True
) -> RecordingData:
    """Read all chunks of a recording, as `read_rrd` does those of a file.

    Each becomes arrays at once, so that no more than one is in memory twice.
    """
    moving: dict[tuple[str, str], list[tuple[np.ndarray, np.ndarray]]] = defaultdict(list)
    fixed: dict[str, dict[str, list[Any]]] = defaultdict(dict)
    for chunk in chunks:
        batch = chunk.to_record_batch()
        if chunk.is_static:
            values = {name: batch.column(name)[0].as_py() for name in batch.schema.names}
            fixed[chunk.entity_path] |= {name: row for name, row in values.items() if row}
        elif TIMELINE in batch.schema.names:
            for column in {*_NUMBERS, *_TEXTS} & {*batch.schema.names}:
                moving[chunk.entity_path, column].append(_rows(chunk.entity_path, batch, column))
    signals, texts = {}, {}
    for entity, column in sorted(moving):
        (ending, unit), style = _NUMBERS.get(column, ("", "")), fixed[entity]
        time_s, values = _joined(entity + ending, moving.pop((entity, column)))
        if column in _TEXTS:
            texts[entity] = Texts(time_s, tuple(values[:, 0].tolist()))
        else:
            values = values[:, 0] if values.shape[1] == 1 else values
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


def _rows(name: str, batch: pa.RecordBatch, column: str) -> tuple[np.ndarray, np.ndarray]:
    """Times in s (n,) of a column's non-empty rows, and their numbers or texts (n, k)."""
    rows = batch.column(column)
    time_s = batch.column(TIMELINE).to_numpy(zero_copy_only=False) / np.timedelta64(1, "s")
    lengths = rows.value_lengths().to_numpy(zero_copy_only=False)
    known = (lengths > 0) & np.isfinite(time_s)  # of a row without value the length is NaN
    if not known.all():
        time_s, rows = time_s[known], rows.filter(pa.array(known))
    if column in _TEXTS:
        found = [row[0] for row in rows.to_pylist()]
        return time_s, np.array(found, dtype=object).reshape(-1, 1)
    flat = rows.flatten()
    if pa.types.is_fixed_size_list(flat.type):
        flat = flat.flatten()
    values = flat.to_numpy(zero_copy_only=False).astype(np.float64)
    if values.size % max(len(rows), 1):
        raise FileError(f"signal {name} changes its number of components; record it again")
    return time_s, values.reshape(len(rows), -1) if len(rows) else np.zeros((0, 1))


def _joined(name: str, parts: list[tuple[np.ndarray, np.ndarray]]) -> tuple[np.ndarray, np.ndarray]:
    """Times in s and values of all parts of a signal, in order of time."""
    filled = [part for part in parts if len(part[0])] or parts[:1]
    if len({values.shape[1] for _, values in filled}) > 1:
        raise FileError(f"signal {name} changes its number of components; record it again")
    time_s, values = (np.concatenate(each) for each in zip(*filled, strict=True))
    if (np.diff(time_s) < 0.0).any():
        order = np.argsort(time_s, kind="stable")
        time_s, values = time_s[order], values[order]
    return time_s, values


class Parameter(NamedTuple):
    """A parameter of the run: its value in the given unit, what it is, and its source."""

    value: float | bool | str | list[Any]
    unit: str
    description: str
    source: str


class DrivenMove(NamedTuple):
    """A commanded move of a robot.

    Attributes:
        end_s: time at which it ended, was given up, or was cut off by the episode's end.
        direction: commanded, such as "45°".
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
        complete: whether its writer completed it; a killed one leaves what it had written.
        outcome: success, collision, out_of_board or timeout; empty if the recording ends before.
        time_s: simulated time at the end, that of the last sample.
        robots: their names in entity paths: r1, r2 and so on.
        facts: scenario, seed, episode, start cells, targets, versions and what else identifies the
            run, as JSON holds it.
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


def read_episode(recording: Path | Kept, without: Sequence[str] = ()) -> Episode:
    """Read the recording of an episode, whole or left by a killed writer, or from memory.

    Of a file, entities `without` which the caller can do are left out, such as "/world/**".
    """
    if isinstance(recording, Path):
        path, data = recording, read_rrd(recording, without)
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

"""A recorded episode as named numpy arrays with units: what the entities of a recording mean.

The file itself is read by `cosim.recording.rrd`: every signal of it is there, also what is not
known here.
"""

import difflib
import json
import re
import shutil
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np

from cosim.base.errors import FileError
from cosim.base.reading import Kind, parsing, require_file
from cosim.base.storage import replacing, require_suffix
from cosim.model.scenario import Scenario
from cosim.recording.file import Kept
from cosim.recording.rrd import Signal, Texts, read_chunks, read_rrd
from cosim.recording.series import ENDED, GIVEN_UP, OUTCOME, STILL_RUNNING

_ROBOT = re.compile(r"^/(sim|raw|rl)/([^/]+)/")
# What a signal's name may leave out, in the order of being tried.
PREFIXES = ("", "/", "/sim/", "/rl/", "/raw/", "/world/")
_NOTHING = Texts(np.zeros(0), ())
EPISODE = Kind("recording of an episode", "record it again")


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
        """The signal of a name.

        Raises:
            SignalError: there is none, an error of the user's and a KeyError at once.
        """
        for prefix in PREFIXES:
            if prefix + name in self._signals:
                return self._signals[prefix + name]
        near = difflib.get_close_matches(name, [*self._signals, *map(_short, self._signals)], n=3)
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


def _short(path: str) -> str:
    """An entity path without its first part."""
    return path.split("/", 2)[-1]


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
    scenario: Scenario | None

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
        """The value of a numeric parameter.

        Raises:
            FileError: the recording names no such number.
        """
        parameter = self.parameters.get(name)
        if parameter is None or isinstance(parameter.value, (str, list)):
            raise FileError(f"{self.origin} lacks its parameter {name}; record it again")
        return float(parameter.value)

    def save(self, path: Path | str) -> None:
        """Write the recording to a file that is not there yet.

        Args:
            path: of the new file (.rrd); its folder is made if it is missing.

        Raises:
            FileError: there is such a file or folder, or its name does not end in .rrd.
            FileError: the recording itself is gone.
        """
        path = require_suffix(path, ".rrd")
        if path.exists():
            raise FileError(f"{path}: it exists; move it away or choose another name")
        if isinstance(self.recording, Kept) and self.recording.chunks:  # not unpickled
            self.recording.write(path)
            return
        require_file(self.path, EPISODE)
        with replacing(path) as temporary:
            shutil.copyfile(self.path, temporary)


def read_episode(recording: Path | Kept) -> Episode:
    """Read the recording of an episode, whole or left by a killed writer, or from memory.

    Args:
        recording: an .rrd file, the .rrd.part that a killed writer left, or chunks in memory.

    Raises:
        FileError: the file does not exist, cannot be read, or holds no episode.
    """
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
        facts={key: _fact(value) for key, value in data.properties["episode"].items()},
        parameters=parameters,
        signals=Signals(str(path), data.signals),
        texts=data.texts,
        moves={r: _moves(data.texts.get(f"/rl/{r}/move", _NOTHING), time_s) for r in robots},
        scenario=scenario,
    )


def _fact(value: Any) -> Any:
    """Return the value of a property: start cells and versions are JSON, see `properties`."""
    if isinstance(value, str) and value[:1] in {"[", "{"}:
        try:
            return json.loads(value)
        except ValueError:
            return value
    return value


def _moves(states: Texts, end_s: float) -> tuple[DrivenMove, ...]:
    """Moves of a robot: a direction, and how long it is in force until the next state."""
    rows = [*zip(states.time_s.tolist(), states.texts, strict=True), (end_s, "")]
    return tuple(
        DrivenMove(start_s, until_s, direction, after == ENDED, after == GIVEN_UP)
        for (start_s, direction), (until_s, after) in pairwise(rows)
        if direction not in {ENDED, GIVEN_UP}
    )

"""A recorded episode as named numpy arrays with units: what the entities of a recording mean.

The file itself is read by `analysis.reading.rrd`: every signal of it is there, also what is not
known here.
"""

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from analysis.reading.rrd import RecordingReadError, Signal, Texts, read_rrd
from cosim.base.reading import Kind, parsing
from cosim.recording.series import ENDED, GIVEN_UP, OUTCOME

_ROBOT = re.compile(r"^/(sim|raw|rl)/([^/]+)/")
_NOTHING = Texts(np.zeros(0), ())
_EPISODE = Kind("recording of an episode", "record it anew", RecordingReadError)


class Parameter(NamedTuple):
    """A parameter of the run: its value in the given unit, what it is, and its source."""

    value: float | bool | str
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


@dataclass(frozen=True)
class Episode:
    """A recorded episode.

    Attributes:
        path: of the recording.
        recording_id: its identity.
        complete: whether its writer completed it; a killed one leaves what it had written.
        outcome: success, collision, out_of_board or timeout; empty if the recording ends before.
        duration_s: simulated time up to the last sample.
        robots: their names in entity paths.
        facts: scenario, seed, episode, start cells, versions and what else identifies the run.
        parameters: by name.
        signals: by entity path, such as "/sim/r1/motors/omega".
        texts: states and the log by entity path, such as "/rl/r1/failure".
        moves: of each robot, in order.
    """

    path: Path
    recording_id: str
    complete: bool
    outcome: str
    duration_s: float
    robots: tuple[str, ...]
    facts: Mapping[str, Any]
    parameters: Mapping[str, Parameter]
    signals: Mapping[str, Signal]
    texts: Mapping[str, Texts]
    moves: Mapping[str, tuple[DrivenMove, ...]]

    def signal(self, path: str) -> Signal:
        """The signal of an entity path.

        Raises:
            RecordingReadError: the recording has none.
        """
        try:
            return self.signals[path]
        except KeyError:
            raise RecordingReadError(
                f"{self.path} has no signal {path}; record with the defaults of "
                "`python -m cosim.run`"
            ) from None

    def parameter(self, name: str) -> float:
        """The value of a numeric parameter.

        Raises:
            RecordingReadError: the recording names no such number.
        """
        parameter = self.parameters.get(name)
        if parameter is None or isinstance(parameter.value, str):
            raise RecordingReadError(
                f"{self.path} does not say its parameter {name}; record it anew"
            )
        return float(parameter.value)


def read_episode(path: Path) -> Episode:
    """Read the recording of an episode, whole or left by a killed writer.

    Raises:
        RecordingReadError: the file does not exist, cannot be read, or holds no episode.
    """
    data = read_rrd(path)
    found = {match[2] for key in data.signals if (match := _ROBOT.match(key))}
    robots = sorted(found, key=lambda name: (len(name), name))  # r10 after r2
    if not robots or "episode" not in data.properties:
        raise RecordingReadError(f"{path} holds no episode; record one with `python -m cosim.run`")
    ends = [s.time_s[-1] for key, s in data.signals.items() if _ROBOT.match(key) and len(s.time_s)]
    time_s = float(max(ends))
    with parsing(path, _EPISODE):
        parameters = {
            name: Parameter(**json.loads(text))
            for name, text in data.properties.get("parameters", {}).items()
        }
    return Episode(
        path=path,
        recording_id=data.recording_id,
        complete=data.complete,
        outcome="".join(data.texts.get(OUTCOME, _NOTHING).texts),
        duration_s=time_s,
        robots=tuple(robots),
        facts={key: _fact(value) for key, value in data.properties["episode"].items()},
        parameters=parameters,
        signals=data.signals,
        texts=data.texts,
        moves={r: _moves(data.texts.get(f"/rl/{r}/move", _NOTHING), time_s) for r in robots},
    )


def _fact(value: Any) -> Any:
    """What a property stands for: start cells, versions and the like are JSON, see `properties`."""
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

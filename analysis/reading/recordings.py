"""A recorded episode as named numpy arrays with units: what the entities of a recording mean.

The file itself is read by `analysis.reading.rrd`: every signal of it is there, also what is not
known here.
"""

import ast
import re
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from analysis.reading.rrd import RecordingData, RecordingReadError, Signal, Texts, read_rrd

_ROBOT = re.compile(r"^/(sim|raw|rl)/([^/]+)/")
_DECIDED = re.compile(r"^(\S+) in .* heads for (\S+)$")
_ENDED = re.compile(r"^(\S+) ends its move ")
_OUTCOME = "episode ends: "
_PARAMETER_COLUMNS = 5


class Parameter(NamedTuple):
    """A parameter of the run, as the recording's information page lists it."""

    value: float | bool | str
    unit: str
    description: str
    source: str


class Move(NamedTuple):
    """A commanded move of a robot.

    Attributes:
        start_s: time of the decision.
        end_s: time of the robot's next decision or of the episode's end.
        direction: commanded, such as "45°".
        ended: whether the robot ended it; otherwise it was given up (or the episode ended).
        last: whether the episode ended during or after it.
    """

    start_s: float
    end_s: float
    direction: str
    ended: bool
    last: bool

    @property
    def timed_out(self) -> bool:
        """Whether the move was given up for another."""
        return not self.ended and not self.last


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
        texts: states and the log by entity path.
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
    moves: Mapping[str, tuple[Move, ...]]

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
    robots = sorted({match[2] for key in data.signals if (match := _ROBOT.match(key))})
    if not robots or "episode" not in data.properties:
        raise RecordingReadError(f"{path} holds no episode; record one with `python -m cosim.run`")
    log = data.texts.get("/log", Texts(np.zeros(0), ()))
    outcome = next((t.removeprefix(_OUTCOME) for t in log.texts if t.startswith(_OUTCOME)), "")
    ends = [s.time_s[-1] for key, s in data.signals.items() if _ROBOT.match(key) and len(s.time_s)]
    duration_s = float(max(ends))
    return Episode(
        path=path,
        recording_id=data.recording_id,
        complete=data.complete,
        outcome=outcome,
        duration_s=duration_s,
        robots=tuple(robots),
        facts={key: _literal(value) for key, value in data.properties["episode"].items()},
        parameters=_parameters(data),
        signals=data.signals,
        texts=data.texts,
        moves={robot: _moves(robot, log, duration_s) for robot in robots},
    )


def _literal(value: Any) -> Any:
    """What a property's text stands for: start cells and versions are written as Python says it."""
    if isinstance(value, str) and value[:1] in {"(", "[", "{"}:
        try:
            return ast.literal_eval(value)
        except (ValueError, SyntaxError):
            return value
    return value


def _parameters(data: RecordingData) -> dict[str, Parameter]:
    """Rows of the parameter table of the information page."""
    _, _, table = data.documents.get("/info/run", "").partition("# Parameters")
    parameters = {}
    for line in table.splitlines():
        cells = [cell.strip() for cell in line.strip().strip("|").split("|")]
        if len(cells) == _PARAMETER_COLUMNS and cells[0] not in {"", "-", "name"}:
            name, value, *rest = cells
            parameters[name] = Parameter(_number(value), *rest)
    return parameters


def _number(text: str) -> float | bool | str:
    if text in {"True", "False"}:
        return text == "True"
    try:
        return float(text)
    except ValueError:
        return text


def _moves(robot: str, log: Texts, duration_s: float) -> tuple[Move, ...]:
    """Moves of a robot from the log's lines on its decisions and on how they end."""
    decided, ended = [], []
    for time_s, text in zip(log.time_s, log.texts, strict=True):
        if (match := _DECIDED.match(text)) and match[1] == robot:
            decided.append((float(time_s), match[2]))
        elif (match := _ENDED.match(text)) and match[1] == robot:
            ended.append(float(time_s))
    moves = []
    for (start_s, direction), (end_s, following) in pairwise([*decided, (duration_s, "")]):
        over = any(start_s < time_s <= end_s for time_s in ended)
        moves.append(Move(start_s, end_s, direction, over, not following))
    return tuple(moves)

"""Contents of a recorded episode: statistics of every signal, robots, findings."""

from typing import Any

import msgspec
import numpy as np

from analysis.reading.findings import Finding, find
from cosim.recording.reader import Episode, Signal
from cosim.simulation.measures import PATH_SAMPLING_S

SCHEMA_VERSION = 1


class SignalStatistics(msgspec.Struct, frozen=True):
    """Statistics of a component of a signal; None where nothing finite is recorded."""

    signal: str
    component: str
    unit: str
    samples: int
    period_s: float | None
    minimum: float | None
    mean: float | None
    maximum: float | None
    deviation: float | None


class RobotSummary(msgspec.Struct, frozen=True):
    """Statistics of a robot: length of its path, moves begun, ended and given up."""

    path_length_m: float | None
    moves: int
    moves_ended: int
    moves_timed_out: int


class Inspection(msgspec.Struct, frozen=True):
    """Everything that `minirobots inspect` prints."""

    recording: str
    recording_id: str
    complete: bool  # whether its writer came to the end
    outcome: str | None  # of the episode, None if the recording ends before it
    time_s: float
    facts: dict[str, Any]
    parameters: dict[str, dict[str, Any]]  # value, unit, description and source of each, by name
    robots: dict[str, RobotSummary]
    signals: list[SignalStatistics]  # a row per component
    findings: list[Finding]
    schema_version: int = SCHEMA_VERSION


def statistics(path: str, signal: Signal) -> list[SignalStatistics]:
    """Statistics of each component of a signal."""
    columns = signal.values.reshape(len(signal.time_s), -1)
    rows = []
    for component, column in zip(signal.names, columns.T, strict=True):
        known = column[np.isfinite(column)]
        measures = (np.min, np.mean, np.max, np.std)
        rows.append(
            SignalStatistics(
                path,
                component,
                signal.unit,
                len(column),
                _period(signal.time_s),
                *(float(measure(known)) if len(known) else None for measure in measures),
            )
        )
    return rows


def _period(time_s: np.ndarray) -> float | None:
    """Time between two samples, as far as the gaps between bursts do not matter."""
    return round(float(np.median(np.diff(time_s))), 9) if len(time_s) > 1 else None


def path_length_m(episode: Episode, robot: str) -> float | None:
    """Length of a robot's path, sampled as slowly as the co-simulation does: without vibration."""
    position = episode.signals.get(f"/sim/{robot}/position")
    period_s = _period(position.time_s) if position is not None else None
    if position is None or period_s is None:
        return None
    every = max(1, round(PATH_SAMPLING_S / period_s))
    path = position.values[every - 1 :: every, :2]
    return float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())


def inspect_episode(episode: Episode) -> Inspection:
    """Return the content of an episode's recording, and its findings."""
    robots = {}
    for robot in episode.robots:
        moves = episode.moves[robot]
        robots[robot] = RobotSummary(
            path_length_m(episode, robot),
            len(moves),
            sum(move.ended for move in moves),
            sum(move.given_up for move in moves),
        )
    return Inspection(
        recording=episode.origin,
        recording_id=episode.recording_id,
        complete=episode.complete,
        outcome=episode.outcome or None,
        time_s=episode.time_s,
        facts=dict(episode.facts),
        parameters={name: p._asdict() for name, p in episode.parameters.items()},
        robots=robots,
        signals=[
            row
            for path, signal in episode.signals.items()
            if not path.startswith("/world/")
            for row in statistics(path, signal)
        ],
        findings=find(episode),
    )

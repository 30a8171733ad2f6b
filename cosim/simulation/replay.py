"""A recorded episode, simulated again and compared with its recording."""

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from cosim.base.progress import Progress
from cosim.base.provenance import versions
from cosim.base.reading import parsing
from cosim.coupling.rl_step import sampled_of
from cosim.model.scenario import Scenario
from cosim.recording.episode import EpisodeRecorder
from cosim.recording.file import Kept
from cosim.recording.reader import EPISODE
from cosim.recording.rrd import RecordingData, read_chunks, read_rrd
from cosim.simulation.episode import RunningEpisode
from cosim.simulation.options import Physics
from cosim.simulation.tasks import EpisodeOrigin, Task, recorder_of, simulate_tasks

_NONE = (np.empty(0), np.empty(0))


def replay(
    recording: Path, find_policy: Callable[[Scenario], Any], motor: Physics, progress: Progress
) -> dict[str, Any]:
    """Simulate a recorded episode again, and return how it differs from the recording.

    Args:
        recording: of an episode.
        find_policy: returns the policy of the run.
        motor: options with the motor FMU of the run.
        progress: receives the simulated time.

    Returns:
        The file, whether its writer completed it, numbers of signals and values that were compared
        (states and log lines among them), the differences, each with the signal and the time from
        which on it differs (None if samples are lacking), and versions of packages that are not
        those of the recording, recorded and now.

    Raises:
        UserError: it is no recording of an episode, says too little to run it again, or was
            recorded with another motor FMU.
    """
    data = read_rrd(recording)
    with parsing(recording, EPISODE):
        origin = msgspec.json.decode(data.properties["origin"]["task"], type=EpisodeOrigin)
        level = data.properties["episode"]["record"]
        signals = msgspec.json.decode(data.properties["episode"].get("signals", "[]"))
        then = msgspec.json.decode(data.properties["episode"]["versions"], type=dict[str, str])
    policy = find_policy(origin.scenario)
    task = Task.again(origin, motor.fmu(progress), policy)
    kept = Kept()

    def recorder(episode: RunningEpisode) -> EpisodeRecorder:
        maps = policy.maps()
        return recorder_of(episode, kept, data.recording_id, {}, level=level, policies=maps)

    def watch(_: Any, episode: RunningEpisode, __: float) -> None:
        progress("replaying", episode.time_s, task.config.timing.episode_limit_s)

    sampled = sampled_of(task.scenario.robots, signals)
    for _ in simulate_tasks([replace(task, recorder=recorder, watch=watch, sampled=sampled)], 1):
        pass
    replayed, now = read_chunks(kept.chunks, data.recording_id), versions()
    recorded = _series(data)
    return {
        "recording": str(data.path),
        "complete": data.complete,
        "signals": len(recorded | _series(replayed)),
        "values": sum(values.size for _, values in recorded.values()),
        "differences": [
            {"signal": name, "time_s": time_s}
            for name, time_s in _differences(data, replayed).items()
        ],
        "versions": {k: (v, now.get(k, "")) for k, v in then.items() if v != now.get(k)},
    }


def _differences(recorded: RecordingData, replayed: RecordingData) -> dict[str, float | None]:
    """Return the time from which on signals differ, by name; None if one of them lacks samples."""
    series, found = [_series(data) for data in (recorded, replayed)], {}
    for name in sorted(series[0] | series[1]):
        was, now = (signals.get(name, _NONE) for signals in series)
        if not recorded.complete:
            now = tuple(part[: len(was[0])] for part in now)
        at = _first_difference(was, now)
        if at is not None:
            found[name] = float(was[0][at]) if at < min(len(was[0]), len(now[0])) else None
    return found


def _series(data: RecordingData) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Times and values of all signals and texts."""
    found = {name: (signal.time_s, signal.values) for name, signal in data.signals.items()}
    return found | {name: (t.time_s, np.array(t.texts)) for name, t in data.texts.items()}


def _first_difference(was: tuple[np.ndarray, ...], now: tuple[np.ndarray, ...]) -> int | None:
    """Index of the first sample that is not the same bits; None if all are."""
    count = min(len(was[0]), len(now[0]))
    equal = np.full(count, fill_value=True)
    for a, b in zip(was, now, strict=True):
        if a.shape[1:] != b.shape[1:]:
            return 0
        if a.dtype == b.dtype == np.float64:  # NaN is equal to itself, and 0 not to −0
            a, b = (np.ascontiguousarray(part).view(np.int64) for part in (a, b))  # noqa: PLW2901
        equal &= (a[:count] == b[:count]).reshape(count, math.prod(a.shape[1:])).all(axis=1)
    if not equal.all():
        return int(equal.argmin())
    return None if len(was[0]) == len(now[0]) else count

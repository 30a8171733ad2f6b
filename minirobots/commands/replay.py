"""Run a recorded episode again and compare every bit."""

import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import msgspec
import numpy as np
import tyro

from cosim.base.command import MotorFmuFile
from cosim.base.progress import Progress
from minirobots.options import File, IsolatedOptions

if TYPE_CHECKING:
    from cosim.recording.reader import RecordingData

_NONE = (np.empty(0), np.empty(0))


class Replay(IsolatedOptions):
    """Run a recorded episode again and compare every signal, bit for bit.

    Scenario, parameters, start cells and seeds are those of the recording; the policy is that of
    the run. Exits with status 1 if anything differs. A recording that a killed run left is compared
    as far as it goes.
    """

    recording: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="RECORDING.rrd")]
    """Recording of an episode."""
    policy: File | None = None
    """Policy of the run; by default policy.npz in the folder above that of the recording."""
    motor_fmu: MotorFmuFile = None


class Difference(msgspec.Struct, frozen=True):
    """Place where a signal first differs.

    Attributes:
        signal: entity path in the recording.
        time_s: simulated time of the first sample that differs; None if one of them lacks samples.
    """

    signal: str
    time_s: float | None


class Comparison(msgspec.Struct, frozen=True):
    """A recording next to its replay.

    Attributes:
        recording: file.
        complete: whether its writer completed it.
        signals, values: that were compared, states and log lines among them.
        differences: signals that are not equal.
        versions: of packages that are not those of the recording, recorded and now.
    """

    recording: str
    complete: bool
    signals: int
    values: int
    differences: tuple[Difference, ...]
    versions: dict[str, tuple[str, str]]


def run(options: Replay, progress: Progress) -> Iterator[Comparison]:
    """Run an episode again, compare it with its recording and print what differs.

    Raises:
        RecordingReadError: it is no recording of an episode, or says too little to run it again.
        ConfigError: it was recorded with another motor FMU.
        UserError: of the policy or the FMU.
    """
    from agent.policies import load_policy
    from cosim.base.provenance import versions
    from cosim.base.reading import parsing
    from cosim.coupling.rl_step import sampled_of
    from cosim.recording.episode import EpisodeRecorder
    from cosim.recording.file import Kept
    from cosim.recording.reader import EPISODE, read_chunks, read_rrd
    from cosim.simulation.episode import RunningEpisode
    from cosim.simulation.options import Physics
    from cosim.simulation.tasks import EpisodeOrigin, Task, recorder_of, simulate_tasks

    data = read_rrd(options.recording)
    with parsing(options.recording, EPISODE):
        origin = msgspec.json.decode(data.properties["origin"]["task"], type=EpisodeOrigin)
        level = data.properties["episode"]["record"]
        signals = msgspec.json.decode(data.properties["episode"].get("signals", "[]"))
        then = msgspec.json.decode(data.properties["episode"]["versions"], type=dict[str, str])
    path = options.policy or options.recording.absolute().parents[1] / "policy.npz"
    loaded = load_policy(path, origin.scenario)
    task = Task.again(origin, Physics(motor_fmu=options.motor_fmu).fmu(progress), loaded)
    kept = Kept()

    def recorder(episode: RunningEpisode) -> EpisodeRecorder:
        maps = loaded.maps()
        return recorder_of(episode, kept, data.recording_id, {}, level=level, policies=maps)

    def watch(_: Any, episode: RunningEpisode, __: float) -> None:
        progress("replaying", episode.time_s, task.config.timing.episode_limit_s)

    sampled = sampled_of(task.scenario.robots, signals)
    for _ in simulate_tasks([replace(task, recorder=recorder, watch=watch, sampled=sampled)], 1):
        pass
    replayed = read_chunks(kept.chunks, data.recording_id)
    now = versions()
    changed = {k: (v, now.get(k, "")) for k, v in then.items() if v != now.get(k)}
    compared = _compared(data, replayed, changed)
    yield compared
    for name, (was, is_now) in changed.items():
        print(f"{name} was {was} when it was recorded, and is {is_now or 'missing'} now")
    for signal, time_s in map(msgspec.structs.astuple, compared.differences):
        print(f"{signal} differs" + (f" from {time_s:g} s on" if time_s is not None else ""))
    ended = "" if compared.complete else " as far as the recording goes, which is not complete"
    equal = compared.signals - len(compared.differences)
    print(
        f"{equal} of {compared.signals} signals ({compared.values} values) are equal in every "
        f"bit{ended}"
    )


def _compared(
    recorded: "RecordingData", replayed: "RecordingData", changed: dict[str, tuple[str, str]]
) -> Comparison:
    series = [_series(data) for data in (recorded, replayed)]
    names = sorted(set(series[0]) | set(series[1]))
    differences = []
    for name in names:
        was, now = (found.get(name, _NONE) for found in series)
        if not recorded.complete:
            now = tuple(part[: len(was[0])] for part in now)
        at = _first_difference(was, now)
        if at is not None:
            time_s = float(was[0][at]) if at < min(len(was[0]), len(now[0])) else None
            differences.append(Difference(name, time_s))
    values = sum(part[1].size for part in series[0].values())
    path, whole = str(recorded.path), recorded.complete
    return Comparison(path, whole, len(names), values, tuple(differences), changed)


def _series(data: "RecordingData") -> dict[str, tuple[np.ndarray, np.ndarray]]:
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


def failed(compared: Comparison) -> bool:
    """Return whether anything differs."""
    return bool(compared.differences)

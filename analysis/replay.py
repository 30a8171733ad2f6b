"""A recorded episode, simulated again and compared with its recording."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec

from agent.training.policy import load_policy
from analysis.compare import find_differences, series_of
from cosim.base.progress import Progress
from cosim.base.provenance import versions
from cosim.base.reading import parsing
from cosim.coupling.rl_step import sampled_of
from cosim.recording.file import Kept
from cosim.recording.reader import EPISODE, read_chunks, read_rrd
from cosim.simulation.episode import RunningEpisode
from cosim.simulation.options import Physics
from cosim.simulation.tasks import EpisodeOrigin, Record, Task, simulate_tasks


def replay(
    recording: Path, policy: Path | None, motor_fmu: Path | None, progress: Progress
) -> dict[str, Any]:
    """Simulate a recorded episode again, and return how it differs from the recording.

    Args:
        policy: of the run, by default policy.npz in the folder above that of the recording.
        motor_fmu: of the run, by default the built-in one.

    Returns:
        The file, whether its writer completed it, numbers of signals and values that were compared
        (states and log lines among them), the differences, each with the signal and the time from
        which on it differs (None if samples are lacking), and versions of packages that are not
        those of the recording, recorded and now.
    """
    data = read_rrd(recording)
    with parsing(recording, EPISODE):
        origin = msgspec.json.decode(data.properties["origin"]["task"], type=EpisodeOrigin)
        level = data.properties["episode"]["record"]
        signals = msgspec.json.decode(data.properties["episode"].get("signals", "[]"))
        then = msgspec.json.decode(data.properties["episode"]["versions"], type=dict[str, str])
    path = policy or recording.absolute().parents[1] / "policy.npz"
    loaded = load_policy(path, origin.scenario)
    task = Task.again(origin, Physics(motor_fmu=motor_fmu).fmu(progress), loaded)
    kept = Kept()

    def watch(_: Any, episode: RunningEpisode, __: float) -> None:
        progress("replaying", episode.time_s, task.config.timing.episode_limit_s)

    record = Record(kept, {}, level, recording_id=data.recording_id)
    sampled = sampled_of(task.scenario.robots, signals)
    for _ in simulate_tasks([replace(task, record=record, watch=watch, sampled=sampled)], 1):
        pass
    replayed, now = read_chunks(kept.chunks, data.recording_id), versions()
    recorded = series_of(data)
    return {
        "recording": str(data.path),
        "complete": data.complete,
        "signals": len(recorded | series_of(replayed)),
        "values": sum(values.size for _, values in recorded.values()),
        "differences": [
            {"signal": name, "time_s": time_s}
            for name, time_s in find_differences(data, replayed).items()
        ],
        "versions": {k: (v, now.get(k, "")) for k, v in then.items() if v != now.get(k)},
    }

"""Two episodes next to each other: where they part, and what differs in their configuration.

The second may be the first one, simulated again.
"""

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import msgspec
import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from agent.training.policy import load_policy
from analysis.figures.fig05 import draw_board
from cosim.base.colours import BLACK, robot_colour
from cosim.base.plotting import styled
from cosim.base.progress import Progress
from cosim.base.provenance import versions
from cosim.base.reading import Kind, parsing
from cosim.coupling.rl_step import sampled_of
from cosim.recording.file import Kept
from cosim.recording.reader import Episode, RecordingData, read_chunks, read_rrd
from cosim.simulation.episode import RunningEpisode
from cosim.simulation.options import Physics
from cosim.simulation.tasks import EpisodeOrigin, Record, Task, simulate_tasks

Recorded = Episode | RecordingData
_REPLAYABLE = Kind(
    "recording with the parameters of this version",
    "replay it with the version that recorded it, which `minirobots inspect` prints",
)
_NONE = (np.empty(0), np.empty(0))
_STYLES = ("-", "--")  # of the first episode and of the second
_CURVES = 3  # signals that are drawn, at most


class Comparison(msgspec.Struct, frozen=True):
    """Two episodes and what differs between them."""

    recordings: tuple[str, str]
    # Whether the first one's writer completed it; else both are compared up to its end
    complete: bool
    # outcomes, times_s: how and when each ended
    outcomes: tuple[str, str]
    times_s: tuple[float, float]
    # facts, parameters: values of both, by the name of what differs
    facts: dict[str, tuple[Any, Any]]
    parameters: dict[str, tuple[Any, Any]]
    # signals, values: that were compared, states and log lines among them
    signals: int
    values: int
    # Time from which on signals differ in a bit, the earliest first; None where one of them lacks
    # samples
    differences: dict[str, float | None]


def compare(a: Episode, b: Episode) -> Comparison:
    """Return what differs between two episodes: configuration, outcome, and every signal."""
    parameters = [{n: p.value for n, p in e.parameters.items()} for e in (a, b)]
    return Comparison(
        recordings=(a.origin, b.origin),
        outcomes=(a.outcome, b.outcome),
        times_s=(a.time_s, b.time_s),
        facts=_changed(a.facts, b.facts),
        parameters=_changed(*parameters),
        **_compared_signals(a, b),
    )


def _compared_signals(a: Recorded, b: Recorded) -> dict[str, Any]:
    """Return the fields of a `Comparison` about signals and states.

    Of an episode `a` that is not complete the samples that it has are compared.
    """
    series, found = [_series_of(episode) for episode in (a, b)], {}
    names = sorted(series[0] | series[1])
    for name in names:
        was, now = (signals.get(name, _NONE) for signals in series)
        if not a.complete:
            now = tuple(part[: len(was[0])] for part in now)
        at = _first_difference(was, now)
        if at is not None:
            found[name] = float(was[0][at]) if at < min(len(was[0]), len(now[0])) else None
    by_time = sorted(found.items(), key=lambda row: math.inf if row[1] is None else row[1])
    return {
        "complete": a.complete,
        "signals": len(names),
        "values": sum(values.size for _, values in series[0].values()),
        "differences": dict(by_time),
    }


def _series_of(episode: Recorded) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Return times and values of all signals and states, by name."""
    found = {name: (signal.time_s, signal.values) for name, signal in episode.signals.items()}
    return found | {name: (t.time_s, np.array(t.texts)) for name, t in episode.texts.items()}


def _changed(a: Mapping[str, Any], b: Mapping[str, Any]) -> dict[str, tuple[Any, Any]]:
    names = sorted(a.keys() | b.keys())
    return {n: (a.get(n), b.get(n)) for n in names if a.get(n) != b.get(n)}


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
    with parsing(recording, _REPLAYABLE):
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
    found, now = _compared_signals(data, read_chunks(kept.chunks, data.recording_id)), versions()
    parted = [{"signal": name, "time_s": at_s} for name, at_s in found["differences"].items()]
    changed = {k: (v, now.get(k, "")) for k, v in then.items() if v != now.get(k)}
    return found | {"recording": str(data.path), "differences": parted, "versions": changed}


def differing(name: str, time_s: float | None) -> str:
    """Return the line that says from when on a signal differs."""
    return f"{name} differs" + ("" if time_s is None else f" from {time_s:g} s on")


@styled
def draw(a: Episode, b: Episode, compared: Comparison) -> Figure:
    """Return a picture of both: paths on the board, and the signals that part first, over time.

    A colour is a robot's in all plots. The first one's lines are solid and its targets filled, the
    second one's dashed and hollow.
    """
    parted = [n for n, time_s in compared.differences.items() if time_s is not None]
    curves = [name for name in parted if name.startswith("/sim/")][:_CURVES]
    figure = plt.figure(figsize=(10.0, 5.2))
    board, *plots = figure.subplot_mosaic(
        [["board", f"curve {row}"] for row in range(max(1, len(curves)))], width_ratios=(1, 1.2)
    ).values()
    if a.scenario is not None:
        draw_board(board, a.scenario)
    if b.scenario is not None:
        for number, target in enumerate(b.scenario.targets):
            x, y = (100.0 * b.scenario.cell_m * (cell + 0.5) for cell in target)
            board.plot(x, y, "s", color=robot_colour(number), fillstyle="none", markersize=9)
    for episode, style in zip((a, b), _STYLES, strict=True):
        for number, robot in enumerate(episode.robots):
            path = 100.0 * episode.signals[f"{robot}/position"].values[:, :2]
            board.plot(*path.T, style, color=robot_colour(number), linewidth=1.2)
        for axes, name in zip(plots, curves, strict=False):
            if (signal := episode.signals.get(name)) is not None:
                colour = robot_colour(episode.robots.index(name.split("/")[2]))
                values = signal.values.reshape(len(signal.values), -1)
                axes.plot(signal.time_s, values[:, 0], style, color=colour, linewidth=0.8)
                axes.set_title(f"{name.removeprefix('/sim/')} in {signal.unit}", loc="left")
    board.set(ylabel="y in cm", aspect="equal")
    plots[-1].set_xlabel("time in s")
    keys = [Line2D([], [], color=BLACK, linestyle=style) for style in _STYLES]
    legend = figure.legend(keys, compared.recordings, loc="outside upper left")
    for text in legend.get_texts():
        text.set_parse_math(False)  # a name of a file
    return figure

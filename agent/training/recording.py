"""Training as Rerun recordings: learning curves, and maps of the tables at several moments.

One run is `write_training`; the mean and the scatter of many runs are `write_runs`.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr

from agent.mdp.greedy import GreedyPolicy
from agent.training.loop import TrainingLog
from cosim.base.colours import robot_rgba
from cosim.base.provenance import digest_of
from cosim.recording.blueprint import training_blueprint
from cosim.recording.file import Recording, scalars
from cosim.recording.scene import map_colours, palette, unit_arrows
from cosim.recording.series import SERIES, PolicyMap, robot_names

_ARROW_CELLS = 0.8
_GAP_CELLS, _BAR_CELLS = 1, 1  # between a map and its colour bar, and the bar's width
_WHITE = np.array([0xFFFFFFFF], dtype=np.uint32)  # the viewer's background is dark
# Entity below /train, fields of `TrainingLog` of its times and values, name in plots.
_CURVES = (
    ("success", "episode", "success", "exploring"),
    ("path_length", "episode", "path_length_cm", "exploring"),
    ("epsilon", "episode", "epsilon", "epsilon"),
    ("greedy/success", "greedy_episode", "greedy_success", "greedy, all starts"),
    ("greedy/path_length", "greedy_episode", "greedy_path_length_cm", "greedy, all starts"),
)


def write_training(
    path: Path, policy: GreedyPolicy, log: TrainingLog, facts: dict[str, Any]
) -> None:
    """Write one run: curves and, at several moments, maps on the timeline `episode`.

    `facts` identify the run, in the recording's properties.
    """
    robots = policy.config.scenario.robots
    identity = f"training-{facts.get('scenario')}-{policy.digest()}"
    size = policy.config.scenario.columns, policy.config.scenario.rows
    with Recording(path, identity, training_blueprint(robots, *size)) as file:
        file.properties("training", facts)
        for entity, times, values, name in _CURVES:
            _send(file, entity, getattr(log, times), getattr(log, values), [name])
        _send(file, "return", log.episode, log.returns, robot_names(robots))
        _mark_end_of_exploration(file, log)
        moments = {
            int(episode): [PolicyMap(m[0], m[1].astype(np.int64), m[2]) for m in maps]
            for episode, maps in zip(log.map_episode, log.maps, strict=True)
        }
        moments[policy.episodes] = policy.maps()
        for episode, maps in moments.items():
            for name, of_robot in zip(robot_names(robots), maps, strict=True):
                _write_maps(file, name, episode, of_robot)


def write_runs(path: Path, logs: Sequence[TrainingLog], facts: dict[str, Any]) -> None:
    """Write runs of one configuration together: mean ± standard deviation of their curves."""
    identity = f"trainings-{facts.get('scenario')}-{digest_of(*(log.returns for log in logs))}"
    with Recording(path, identity, training_blueprint(0)) as file:
        file.properties("training", facts | {"runs": len(logs)})
        for entity, times, values, name in _CURVES:
            episode, table = joined(logs, times, values)
            _send_scatter(file, entity, episode, table, f"{name}, mean ± σ")
        returns = [log._replace(returns=log.returns.mean(axis=1)) for log in logs]
        episode, table = joined(returns, "episode", "returns")
        _send_scatter(file, "return", episode, table, "mean over robots, mean ± σ")


def joined(logs: Sequence[TrainingLog], times: str, values: str) -> tuple[np.ndarray, np.ndarray]:
    """Episodes that all runs have a value at, (K,), and the values there, (runs, K)."""
    common = getattr(logs[0], times)
    for log in logs:
        finite = np.isfinite(getattr(log, values))
        common = np.intersect1d(common, getattr(log, times)[finite])
    rows = [getattr(log, values)[np.isin(getattr(log, times), common)] for log in logs]
    return common, np.array(rows)


def _colours(entity: str, count: int) -> np.ndarray:
    """Colours of the curves of an entity: the robots', or that of greedy or exploring ones."""
    if entity == "return":
        return palette([robot_rgba(robot) for robot in range(count)])
    first = int(entity.startswith("greedy/"))
    return palette([SERIES[(first + k) % len(SERIES)] for k in range(count)])


def _curve(file: Recording, entity: str, style: Any, episode: np.ndarray, columns: Any) -> None:
    file.static(f"/train/{entity}", style)
    file.columns(f"/train/{entity}", [rr.TimeColumn("episode", sequence=episode)], columns)


def _send(
    file: Recording, entity: str, episode: np.ndarray, values: np.ndarray, names: list[str]
) -> None:
    finite = np.isfinite(values).all(axis=tuple(range(1, values.ndim)))
    style = rr.SeriesLines(names=names, colors=_colours(entity, len(names)))
    _curve(file, entity, style, episode[finite], scalars(values[finite]))


def _mark_end_of_exploration(file: Recording, log: TrainingLog) -> None:
    """Mark on the curves where ε comes to its least value and stays there."""
    falls = np.flatnonzero(np.diff(log.epsilon) < 0.0)
    if not len(falls):
        return
    end = slice(falls[-1] + 1, falls[-1] + 2)
    marks = {"success": log.success, "path_length": log.path_length_cm, "epsilon": log.epsilon}
    marks["return"] = log.returns.mean(axis=1)
    look: dict[str, Any] = {"colors": _WHITE, "markers": "Diamond", "marker_sizes": 6.0}
    for entity, values in marks.items():
        if np.isfinite(values[end]).all():
            style = rr.SeriesPoints(names="exploration ends", **look)
            curve = f"{entity}/exploration_end"
            _curve(file, curve, style, log.episode[end], scalars(values[end]))


def _send_scatter(
    file: Recording, entity: str, episode: np.ndarray, table: np.ndarray, name: str
) -> None:
    """Mean and variance over runs, which the viewer draws as a line with a band of ± σ."""
    style = rr.Measurements.from_fields(names=[name], colors=_colours(entity, 1))
    if not len(episode):  # there is no path without a success
        file.static(f"/train/{entity}", style)
        return
    variance = table.var(axis=0, ddof=1) if len(table) > 1 else np.zeros(len(episode))
    rows = rr.Measurements.columns(values=table.mean(axis=0), variances=variance)
    _curve(file, entity, style, episode, rows)


def _write_maps(file: Recording, name: str, episode: int, maps: PolicyMap) -> None:
    known = maps.visits > 0
    visits = np.log10(np.maximum(maps.visits, 1))
    time = rr.TimeColumn("episode", sequence=[episode])
    for path, drawn in (
        ("value_map", _image(maps.value, known)),
        ("visits", _image(visits, known)),
        ("value_map/scale", _scale(maps.value, known, "{:.3g}")),
        ("visits/scale", _scale(visits, known, "10^{:.1f}")),
        ("policy", _arrows(maps.action, known)),
    ):
        file.row(f"/q/{name}/{path}", drawn, times=[time])


def _image(values: np.ndarray, known: np.ndarray) -> rr.Image:
    """A map over (columns, rows) as an image, a pixel per cell, y up; unvisited cells are black."""
    image = np.flipud(map_colours(values, known).transpose(1, 0, 2))
    ramp = np.linspace(1.0, 0.0, len(image))[:, None].repeat(_BAR_CELLS, axis=1)
    bar = map_colours(ramp, np.ones_like(ramp, dtype=bool))
    gap = np.zeros((len(image), _GAP_CELLS, 3), dtype=np.uint8)
    return rr.Image(np.hstack([image, gap, bar]))


def _scale(values: np.ndarray, known: np.ndarray, form: str) -> rr.Points2D:
    """Labels at the ends of the colour bar to the right of a map."""
    columns, rows = values.shape
    ends = (values[known].max(), values[known].min()) if known.any() else (1.0, 0.0)
    x = columns + _GAP_CELLS + _BAR_CELLS / 2.0
    return rr.Points2D(
        [(x, 0.0), (x, rows)],
        labels=[form.format(end) for end in ends],
        radii=0.01,
        colors=_WHITE,
        show_labels=True,
    )


def _arrows(action: np.ndarray, known: np.ndarray) -> rr.Arrows2D:
    """Greedy directions as arrows, in the pixels of the maps, which are cells."""
    columns, rows = np.nonzero(known)
    centres = np.stack([columns + 0.5, known.shape[1] - rows - 0.5], axis=1)
    vectors = unit_arrows(action[known]) * np.array([1, -1]) * _ARROW_CELLS
    return rr.Arrows2D(vectors=vectors, origins=centres - vectors / 2.0, colors=_WHITE)

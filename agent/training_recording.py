"""A training run as a Rerun recording: learning curves, and what the tables say at the end."""

from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
from matplotlib import colormaps

from agent.maps import policy_maps
from agent.policy import Policy
from agent.training import TrainingLog
from cosim.blueprint import robot_names, training_blueprint
from cosim.features import DIRECTIONS
from cosim.recording import Recording, properties, scalars

_PIXELS_PER_CELL = 12
_ARROW_CELLS = 0.8
_WHITE = 0xFFFFFFFF  # the viewer's background is dark


def write_training(path: Path, policy: Policy, log: TrainingLog, facts: dict[str, Any]) -> None:
    """Write `training.rrd`: curves on the timeline `episode`, maps of the trained tables.

    Args:
        path: of the recording.
        policy: trained policy with its tables and visit counts.
        log: learning curves.
        facts: what identifies the run, for the recording's properties.

    Raises:
        RecordingError: the file cannot be written.
    """
    robots = policy.config.scenario.robots
    identity = f"training-{facts.get('scenario')}-{facts.get('seed')}"
    with Recording(path, identity, training_blueprint(robots)) as file:
        file.stream.send_property("training", properties(facts))
        _write_curves(file, log)
        maps = policy_maps(policy)
        for robot, name in enumerate(robot_names(robots)):
            value, action, visits = maps[robot]
            _write_map(file, f"/q/{name}/value_map", value, visits > 0)
            _write_map(file, f"/q/{name}/visits", np.log10(np.maximum(visits, 1)), visits > 0)
            _write_arrows(file, f"/q/{name}/policy", action, visits > 0)


def _write_curves(file: Recording, log: TrainingLog) -> None:
    def send(name: str, episode: np.ndarray, values: np.ndarray, names: list[str]) -> None:
        known = np.isfinite(values.reshape(len(values), -1)).all(axis=1)
        file.static(f"/train/{name}", rr.SeriesLines(names=names, aggregation_policy="Average"))
        times = [rr.TimeColumn("episode", sequence=episode[known])]
        file.columns(f"/train/{name}", times, scalars(values[known]))

    names = robot_names(log.returns.shape[1])
    send("success", log.episode, log.success, ["exploring"])
    send("path_length", log.episode, log.path_length_cm, ["exploring"])
    send("return", log.episode, log.returns, names)
    send("epsilon", log.episode, log.epsilon, ["epsilon"])
    send("greedy/success", log.greedy_episode, log.greedy_success, ["greedy, all starts"])
    send(
        "greedy/path_length", log.greedy_episode, log.greedy_path_length_cm, ["greedy, all starts"]
    )


def _write_map(file: Recording, entity: str, values: np.ndarray, known: np.ndarray) -> None:
    """A map over (columns, rows) as a colour image, y up; cells never visited stay black."""
    low, high = values[known].min(), values[known].max()
    scaled = (values - low) / max(high - low, 1e-12)
    colours = colormaps["viridis"](scaled, bytes=True)[..., :3]
    colours[~known] = 0
    image = np.flipud(colours.transpose(1, 0, 2))
    image = np.ascontiguousarray(
        image.repeat(_PIXELS_PER_CELL, axis=0).repeat(_PIXELS_PER_CELL, axis=1)
    )
    file.static(entity, rr.Image(image))


def _write_arrows(file: Recording, entity: str, action: np.ndarray, known: np.ndarray) -> None:
    """Greedy directions as arrows, in the pixels of the maps."""
    columns, rows = np.nonzero(known)
    centres = np.stack([columns + 0.5, known.shape[1] - rows - 0.5], axis=1) * _PIXELS_PER_CELL
    step = DIRECTIONS[action[known]] * np.array([1, -1])
    unit = step / np.linalg.norm(step, axis=1, keepdims=True)
    vectors = unit * _ARROW_CELLS * _PIXELS_PER_CELL
    file.static(
        entity,
        rr.Arrows2D(
            vectors=vectors,
            origins=centres - vectors / 2.0,
            colors=np.array([_WHITE], dtype=np.uint32),
        ),
    )

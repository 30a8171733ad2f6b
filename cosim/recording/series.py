"""The recorded signals of an episode: where each comes from, its rate, unit, names and colours."""

from collections.abc import Callable, Sequence
from typing import Literal, NamedTuple

import numpy as np
import rerun as rr

from cosim.coupling.signals import Samples
from cosim.model.outcome import ENDS
from cosim.onboard.features import DIRECTION_COUNT, DISTANCE_CLASSES, GRADIENT_SIGNS
from cosim.onboard.steering import MODE_NAMES
from cosim.physics.rotation import headings
from cosim.recording.blueprint import robot_names
from cosim.recording.file import Sink
from cosim.recording.scene import EIGHT, GREY, LIGHT, SERIES, WHITE, palette, robot_colour, shades

DIRECTION_NAMES = tuple(f"{360 * k // DIRECTION_COUNT}°" for k in range(DIRECTION_COUNT))
ARRIVED = "at target"
DRIVEN = "motors"  # a policy commands them
# States of /rl/<robot>/move but for directions, and of /rl/<robot>/failure; OUTCOME is an entity.
ENDED, GIVEN_UP = "ended", "given up"
OFF_THE_BOARD, ON_OBSTACLE = "leaves the board", "touches an obstacle"
ON_TARGET, IN_ZONE = "enters another robot's target", "enters the restricted zone"
NOT_ARRIVED = "has not arrived"
OUTCOME, STILL_RUNNING = "/outcome", "running"
REWARD_PARTS = ("goal or failure", "step", "nearness")  # Eq. (8) and (11)
_DE, _ABC, _XY, _HEADING = ("D", "E"), ("A", "B", "C"), ("x", "y"), ("heading",)
_COVARIANCE = ("xx", "xy", "yy", "x heading", "y heading", "heading")


class SignalSpec(NamedTuple):
    """A signal below `/sim/<robot>`.

    Attributes:
        path: of its entity.
        names: of its components.
        unit: of its values.
        rate: which of the rates of `cosim.recording.levels.Detail` it has.
        reduced: what a row says of the control periods since the last one.
        of: its values (n, N) or (n, N, k) at every control period.
    """

    path: str
    names: tuple[str, ...]
    unit: str
    rate: Literal["fast", "slow", "pose", "loop"]
    reduced: Literal["mean", "max", "last"]
    of: Callable[[Samples], np.ndarray]


def nearest_distances(samples: Samples) -> np.ndarray:
    """Distance in m of each robot's centre to the nearest other, (n, N), infinite if alone."""
    between = samples.position[:, :, None, :2] - samples.position[:, None, :, :2]
    distances = np.linalg.norm(between, axis=-1)
    robots = np.arange(distances.shape[1])
    distances[:, robots, robots] = np.inf
    return distances.min(axis=2)


SIGNALS = (
    SignalSpec("motors/omega", _DE, "rad/s", "fast", "mean", lambda s: s.omega),
    SignalSpec("motors/voltage", _DE, "V", "fast", "mean", lambda s: s.voltage),
    SignalSpec("motors/omega_des", _DE, "rad/s", "slow", "last", lambda s: s.omega_des),
    SignalSpec("motors/theta", _DE, "rad", "slow", "last", lambda s: s.theta),
    SignalSpec("motors/current", _DE, "A", "slow", "mean", lambda s: s.current),
    SignalSpec("motors/omega_dot", _DE, "rad/s2", "loop", "last", lambda s: s.omega_dot),
    SignalSpec("motors/noise", _DE, "rad/s", "loop", "last", lambda s: s.noise),
    SignalSpec("motors/u", _DE, "V", "loop", "last", lambda s: s.command),
    SignalSpec("motors/integral", _DE, "rad", "loop", "last", lambda s: s.integral),
    SignalSpec("motors/disturbance", _DE, "N.m", "loop", "last", lambda s: s.disturbance),
    SignalSpec("position", _XY, "m", "pose", "last", lambda s: s.position[..., :2]),
    SignalSpec("heading", _HEADING, "rad", "pose", "last", lambda s: headings(s.quaternion)),
    SignalSpec("estimate/position", _XY, "m", "pose", "last", lambda s: s.estimate[..., :2]),
    SignalSpec("estimate/heading", _HEADING, "rad", "pose", "last", lambda s: s.estimate[..., 2]),
    SignalSpec(
        "estimate/covariance",
        _COVARIANCE,
        "m2, m rad, rad2",
        "pose",
        "last",
        lambda s: s.covariance,
    ),
    SignalSpec("velocity", _XY, "m/s", "slow", "mean", lambda s: s.velocity[..., :2]),
    SignalSpec("yaw_rate", ("yaw rate",), "rad/s", "slow", "mean", lambda s: s.yaw_rate),
    SignalSpec("heading_error", ("error",), "rad", "slow", "last", lambda s: s.heading_error),
    SignalSpec("mode", ("mode",), "1", "slow", "last", lambda s: s.mode),
    SignalSpec("distance_m", ("to the nearest",), "m", "slow", "last", nearest_distances),
    SignalSpec("contact/normal_mean", _ABC, "N", "slow", "mean", lambda s: s.normal_mean),
    SignalSpec("contact/friction_mean", _ABC, "N", "slow", "mean", lambda s: s.friction_mean),
    SignalSpec("contact/impact", _ABC, "N.s", "slow", "max", lambda s: s.impact),
    SignalSpec("contact/slipping_share", _ABC, "1", "slow", "mean", lambda s: s.slipping_share),
    SignalSpec("contact/lifted_share", ("share",), "1", "slow", "mean", lambda s: s.lifted_share),
    SignalSpec(
        "contact/touching_share", ("share",), "1", "slow", "mean", lambda s: s.touching_share
    ),
)

# Signals of bursts below /raw/<robot>, fields of `cosim.coupling.signals.RawSamples`: names and
# unit.
RAW_SERIES = {
    "omega": (_DE, "rad/s"),
    "theta": (_DE, "rad"),
    "position": (("x", "y", "z"), "m"),
    "normal": (_ABC, "N"),
    "friction": (("A x", "A y", "B x", "B y", "C x", "C y"), "N"),
}

# Signals of decisions below /rl/<robot>; decisions say the unit of action values.
RL_SERIES = {
    "cell": (_XY, "cells"),
    "visited": (("cells",), "cells"),
    "distance": (("distance",), "cells"),
    "reward": (("reward",), "1"),
    "reward_parts": (REWARD_PARTS, "1"),
    "return": (("return",), "1"),
    "q_s": (DIRECTION_NAMES, ""),
}


def signals_of(distances: bool, *, camera: bool, loop: bool) -> list[SignalSpec]:
    """The meaningful ones: no distances of a robot alone, no estimates of exact poses.

    Args:
        distances: whether there are several robots, all of which are sampled.
        camera: whether robots see themselves through one.
        loop: whether signals of the motors' controllers are recorded.
    """
    return [
        signal
        for signal in SIGNALS
        if (distances or signal.path != "distance_m")
        and (camera or not signal.path.startswith("estimate/"))
        and (loop or signal.rate != "loop")
    ]


def write_styles(file: Sink, signals: Sequence[SignalSpec], robots: Sequence[int]) -> None:
    """Log names, units, colours and aggregation of every signal and state of some robots."""
    for robot, name in enumerate(robot_names(robots)):
        series = {f"/sim/{name}/{s.path}": (s.names, s.unit) for s in signals}
        series |= {f"/raw/{name}/{path}": entry for path, entry in RAW_SERIES.items()}
        series |= {f"/rl/{name}/{path}": entry for path, entry in RL_SERIES.items()}
        for entity, (names, unit) in series.items():
            few = len(names) <= len(_ABC)
            colours = (
                shades(robot_colour(robot), len(names)) if few else palette(EIGHT[: len(names)])
            )
            set_points = entity.endswith("/omega_des")  # in one plot with the speeds
            file.static(
                entity,
                # The default, averaging, would flatten a vibration to nothing.
                rr.SeriesLines(
                    names=names,
                    colors=palette([WHITE] * len(names)) if set_points else colours,
                    widths=[0.5 if set_points else 1.5] * len(names),
                    aggregation_policy="MinMax",
                    visible_series=[part != REWARD_PARTS[0] for part in names],
                ),
                *([rr.AnyValues(unit=unit)] if unit else []),
            )
        for path, values, colours in (
            ("action", (*DIRECTION_NAMES, ARRIVED, DRIVEN), [*EIGHT, LIGHT, GREY]),
            ("steering", MODE_NAMES, [GREY, *EIGHT]),
            ("move", (*DIRECTION_NAMES, ENDED, GIVEN_UP), [*EIGHT, LIGHT, GREY]),
            (
                "failure",
                (OFF_THE_BOARD, ON_OBSTACLE, NOT_ARRIVED, ON_TARGET, IN_ZONE),
                [*SERIES, GREY, LIGHT],
            ),
            ("greedy", DIRECTION_NAMES, EIGHT),
            ("gradient", GRADIENT_SIGNS, SERIES),
            ("distance_class", DISTANCE_CLASSES, SERIES),
        ):
            _write_states(file, f"/rl/{name}/{path}", values, colours)
    colours = [SERIES[2], EIGHT[5], EIGHT[4], GREY, LIGHT]
    _write_states(file, OUTCOME, (*ENDS, STILL_RUNNING), colours)


def _write_states(file: Sink, entity: str, values: Sequence[str], colours: Sequence[int]) -> None:
    states = rr.StateConfiguration(
        values=list(values), labels=list(values), colors=palette(list(colours))
    )
    file.static(entity, states)

"""What is recorded of an episode: every signal, state and level of `--record`, with its colours.

A signal is a row of `SIGNALS`. Recorder, styles, blueprint and levels follow this table. A row of a
Rerun table costs some 35 bytes for any content, so rates decide what a recording weighs;
docs/performance.md has the sizes.
"""

import logging
import math
from collections.abc import Callable, Sequence
from typing import Any, Literal, NamedTuple

import numpy as np

from cosim.base.colours import BLUE, GREEN, ORANGE, PURPLE, SKY, VERMILION, rgba
from cosim.coupling.rl_step import Step
from cosim.coupling.signals import Samples
from cosim.model.config import CoSimConfig
from cosim.model.outcome import ENDS
from cosim.model.params import (
    TABLE_I,
    TIMING,
    RobotParams,
    TimingParams,
    feet_names,
    motor_names,
)
from cosim.onboard.features import DIRECTION_COUNT, DISTANCE_CLASSES, GRADIENT_SIGNS
from cosim.onboard.steering import MODE_NAMES
from cosim.physics.rotation import headings

GREY, LIGHT, INK, WHITE = 0x888888FF, 0x88888840, 0x222222FF, 0xFFFFFFFF
SERIES = [rgba(BLUE), rgba(ORANGE), rgba(GREEN)]  # of states and curves that belong to no robot
EIGHT = [
    *(rgba(BLUE), rgba(SKY), rgba(GREEN), 0xF0E442FF),
    *(rgba(ORANGE), rgba(VERMILION), rgba(PURPLE), 0x888888FF),
]

DIRECTION_NAMES = tuple(f"{360 * k // DIRECTION_COUNT}°" for k in range(DIRECTION_COUNT))
ARRIVED = "at target"
DRIVEN = "motors"  # a policy commands them
ENDED, GIVEN_UP = "ended", "given up"
OFF_THE_BOARD, ON_OBSTACLE = "leaves the board", "touches an obstacle"
ON_TARGET, IN_ZONE = "enters another robot's target", "enters the restricted zone"
NOT_ARRIVED = "has not arrived"
OUTCOME, STILL_RUNNING = "/outcome", "running"
REWARD_PARTS = ("goal or failure", "step", "nearness")  # Eq. (8) and (11)
# States below /rl/<robot>, and of the whole episode: their values and colours.
STATES: dict[str, tuple[Sequence[str], Sequence[int]]] = {
    "action": ((*DIRECTION_NAMES, ARRIVED, DRIVEN), [*EIGHT, LIGHT, GREY]),
    "steering": (MODE_NAMES, [GREY, *EIGHT]),
    "move": ((*DIRECTION_NAMES, ENDED, GIVEN_UP), [*EIGHT, LIGHT, GREY]),
    "failure": (
        (OFF_THE_BOARD, ON_OBSTACLE, NOT_ARRIVED, ON_TARGET, IN_ZONE),
        [*SERIES, GREY, LIGHT],
    ),
    "greedy": (DIRECTION_NAMES, EIGHT),
    "gradient": (GRADIENT_SIGNS, SERIES),
    "distance_class": (DISTANCE_CLASSES, SERIES),
}
OUTCOMES = (*ENDS, STILL_RUNNING), [SERIES[2], EIGHT[5], EIGHT[4], GREY, LIGHT]


class PolicyMap(NamedTuple):
    """A robot's policy by cell; arrays of shape (columns, rows)."""

    value: np.ndarray  # largest action value, mean over the cell's states weighted by visits
    action: np.ndarray  # greedy direction index in the state visited most
    visits: np.ndarray  # decisions made in the cell while learning


# Measured; most numbers are compressed to a half. Board and blueprint are what is fixed.
_ROW_BYTES, _NUMBER_BYTES, _FIXED_BYTES = 28.0, 3.5, 1.1e6
LARGE_MB = 500.0  # of a recording that is announced
_LOGGER = logging.getLogger(__name__)
Level = Literal["summary", "default", "full"]


class Detail(NamedTuple):
    """Times between the rows of a level, in s; infinite is once per RL step."""

    fast_s: float  # of what changes within a motor turn: speeds and voltages
    slow_s: float  # of everything else; forces and shares are means over it, impacts the largest
    pose_s: float  # of poses, positions and headings
    burst_s: float  # length of a burst, at the start of an RL step, that is kept at every tick
    between_s: float = TIMING.rl_step_s  # least time between the starts of two bursts
    full: bool = False  # whether signals are recorded that only this level has


DETAILS: dict[Level, Detail] = {
    "summary": Detail(math.inf, math.inf, 0.1, 0.0),
    # 9 ms are 1.4 motor turns; slow rows meet the ends of RL steps, where bursts begin. Rows of 5
    # ms show how a speed loop settles, and weigh a fifth of those of every control period.
    "default": Detail(0.005, 0.025, 0.025, 0.009, between_s=6.0),
    "full": Detail(0.001, 0.001, 0.001, 0.05, full=True),
}


def with_bursts(config: CoSimConfig, level: Level | Literal["none"]) -> CoSimConfig:
    """A configuration that samples the bursts of a level, and none where nothing is recorded."""
    burst_s = 0.0 if level == "none" else DETAILS[level].burst_s
    return config.having("a recording's level", burst_s=burst_s)


def periods(time_s: float, control_period_s: float, rl_step_s: float) -> int:
    """Control periods between two rows: at least one, at most an RL step's."""
    return max(1, round(min(time_s, rl_step_s) / control_period_s))


class SignalSpec(NamedTuple):
    """A signal of a robot."""

    path: str  # of its entity, without the robot's name
    names: tuple[str, ...]  # of its components
    unit: str  # of its values; empty if decisions say it
    # Which of the rates of `Detail` it has; "burst" is every tick of bursts, and "decision" once
    # per RL step
    rate: Literal["fast", "slow", "pose", "burst", "decision"]
    # What a row says of the control periods since the last one
    reduced: Literal["mean", "max", "last"] = "last"
    # Its values (n, N) or (n, N, k) in `Samples`, or in `RawSamples` of bursts; None where the
    # recorder computes them
    of: Callable[[Any], np.ndarray] | None = None
    # Of its plot, with {} for the names of components; a signal without one is drawn with the one
    # before it
    label: str = ""
    # Of the viewer that have the plot; "values" and "places" are the overview with and without the
    # values of a policy
    tabs: tuple[str, ...] = ()
    full: bool = False  # whether only the level "full" has it

    def entity(self, robot: str) -> str:
        """Return the path of its entity."""
        kind, _, name = self.path.partition("/")
        return f"/{kind}/{robot}/{name}"


def nearest_distances(samples: Samples) -> np.ndarray:
    """Distance in m of each robot's centre to the nearest other, (n, N), infinite if alone."""
    between = samples.position[:, :, None, :2] - samples.position[:, None, :, :2]
    distances = np.linalg.norm(between, axis=-1)
    robots = np.arange(distances.shape[1])
    distances[:, robots, robots] = np.inf
    return distances.min(axis=2)


_DE, _ABC, _XY, _SHARE = ("D", "E"), ("A", "B", "C"), ("x", "y"), ("share",)
_HEADING, _CELLS = ("heading",), "cells"
_COVARIANCE = ("xx", "xy", "yy", "x heading", "y heading", "heading")
_FRICTION = tuple(f"{foot} {axis}" for foot in _ABC for axis in _XY)
_BENT = tuple(f"{foot} {axis}" for foot in _ABC for axis in "xyz")  # of elastic legs alone
_MOTORS, _BURST = ("overview", "motors"), ("bursts at every tick",)
_APART = {"sim/distance_m", "rl/distance"}  # of which a robot alone has none

# fmt: off
_spec = SignalSpec
SIGNALS = (
    _spec("sim/motors/omega", _DE, "rad/s", "fast", "mean", lambda s: s.omega,
          "speed of {}, set points (white), rad/s", _MOTORS),
    _spec("sim/motors/omega_des", _DE, "rad/s", "slow", "last", lambda s: s.omega_des, "", _MOTORS),
    _spec("sim/motors/voltage", _DE, "V", "fast", "mean", lambda s: s.voltage,
          "voltage of {}, V", ("overview",)),
    _spec("sim/motors/theta", _DE, "rad", "slow", "last", lambda s: s.theta),
    _spec("sim/motors/current", _DE, "A", "slow", "mean", lambda s: s.current,
          "current of {}, A", ("motors",)),
    _spec("sim/motors/omega_dot", _DE, "rad/s2", "slow", "last", lambda s: s.omega_dot, full=True),
    _spec("sim/motors/noise", _DE, "rad/s", "slow", "last", lambda s: s.noise, full=True),
    _spec("sim/motors/u", _DE, "V", "slow", "last", lambda s: s.command, full=True),
    _spec("sim/motors/integral", _DE, "rad", "slow", "last", lambda s: s.integral, full=True),
    _spec("sim/motors/disturbance", _DE, "N.m", "slow", "last", lambda s: s.disturbance, full=True),
    _spec("rl/q_s", DIRECTION_NAMES, "", "decision", label="Q of the eight directions",
          tabs=("values", "learning")),
    # The reward of the goal is hidden: a hundred times that of a step, it would flatten the rest.
    _spec("rl/reward_parts", REWARD_PARTS, "1", "decision",
          label="reward of a step: its time (dark), nearness; not the goal", tabs=("values",)),
    _spec("rl/return", ("return",), "1", "decision", label="return", tabs=("values",)),
    _spec("rl/reward", ("reward",), "1", "decision"),
    _spec("rl/cell", _XY, _CELLS, "decision"),
    _spec("rl/visited", (_CELLS,), _CELLS, "decision", label="visited cells", tabs=("learning",)),
    _spec("rl/distance", ("distance",), _CELLS, "decision",
          label="distance to the nearest robot in cells", tabs=("learning",)),
    _spec("sim/position", _XY, "m", "pose", "last", lambda s: s.position[..., :2],
          "position x (dark), y, m", ("places", "motion")),
    _spec("sim/heading", _HEADING, "rad", "pose", "last", lambda s: headings(s.quaternion),
          "heading rad", ("motion",)),
    _spec("sim/estimate/position", _XY, "m", "pose", "last", lambda s: s.estimate[..., :2],
          "estimated position m", ("camera",)),
    _spec("sim/estimate/heading", _HEADING, "rad", "pose", "last", lambda s: s.estimate[..., 2],
          "estimated heading rad", ("camera",)),
    _spec("sim/estimate/covariance", _COVARIANCE, "m2, m rad, rad2", "pose", "last",
          lambda s: s.covariance, "covariance of the estimate", ("camera",)),
    _spec("sim/velocity", _XY, "m/s", "slow", "mean", lambda s: s.velocity[..., :2],
          "velocity m/s", ("motion",)),
    _spec("sim/yaw_rate", ("yaw rate",), "rad/s", "slow", "mean", lambda s: s.yaw_rate),
    _spec("sim/heading_error", ("error",), "rad", "slow", "last", lambda s: s.heading_error,
          "heading error rad", ("motion",)),
    _spec("sim/mode", ("mode",), "1", "slow", "last", lambda s: s.mode),
    _spec("sim/distance_m", ("to the nearest",), "m", "slow", "last", nearest_distances,
          "distance to the nearest robot, m", ("places", "motion")),
    _spec("sim/contact/normal_mean", _ABC, "N", "slow", "mean", lambda s: s.normal_mean,
          "mean normal force N", ("contact",)),
    _spec("sim/contact/friction_mean", _ABC, "N", "slow", "mean", lambda s: s.friction_mean,
          "mean friction force N", ("contact",)),
    _spec("sim/contact/impact", _ABC, "N.s", "slow", "max", lambda s: s.impact,
          "impulse of impacts N s", ("contact",)),
    _spec("sim/contact/deflection", _BENT, "m", "slow", "last", lambda s: s.deflection,
          "deflection of the tips of legs m", ("contact",)),
    _spec("sim/contact/slipping_share", _ABC, "1", "slow", "mean", lambda s: s.slipping_share,
          "share of time in which a foot slides", ("contact",)),
    _spec("sim/contact/lifted_share", _SHARE, "1", "slow", "mean", lambda s: s.lifted_share,
          "share of time with a foot in the air", ("contact",)),
    _spec("sim/contact/touching_share", _SHARE, "1", "slow", "mean", lambda s: s.touching_share),
    _spec("raw/omega", _DE, "rad/s", "burst", "last", lambda s: s.omega,
          "speed at every tick rad/s", _BURST),
    _spec("raw/theta", _DE, "rad", "burst", "last", lambda s: s.theta, full=True),
    _spec("raw/position", ("x", "y", "z"), "m", "burst", "last", lambda s: s.position),
    _spec("raw/normal", _ABC, "N", "burst", "last", lambda s: s.normal, "normal force N", _BURST),
    _spec("raw/friction", _FRICTION, "N", "burst", "last", lambda s: s.friction,
          "friction force N", _BURST),
)
# fmt: on


def signals_of(
    robot: RobotParams = TABLE_I, *, distances: bool, camera: bool, full: bool = True
) -> list[SignalSpec]:
    """The meaningful ones: `distances` to others, estimates with a camera, deflections of legs."""
    feet = feet_names(len(robot.feet))
    own = {
        _DE: tuple(motor_names(len(robot.motors))),
        _ABC: feet,
        _FRICTION: tuple(f"{foot} {axis}" for foot in feet for axis in _XY),
        _BENT: tuple(f"{foot} {axis}" for foot in feet for axis in "xyz"),
    }
    known = ((signal, own.get(signal.names, signal.names)) for signal in SIGNALS)
    return [
        signal._replace(names=names, label=signal.label.format(_listed(names)))
        for signal, names in known
        if (distances or signal.path not in _APART)
        and (camera or not signal.path.startswith("sim/estimate/"))
        and (robot.elastic or signal.path != "sim/contact/deflection")
        and (full or not signal.full)
    ]


def tints(count: int) -> Sequence[float]:
    """Return how far the colour of each component of a signal is from a robot's towards white."""
    return (0.0, 0.6, 0.35, 0.8)[:count] if count <= 4 else np.linspace(0.0, 0.8, count).tolist()


def in_eight(names: Sequence[str]) -> bool:
    """Return whether a signal's components have the eight colours, so that their plot has a legend.

    Fewer have tints of their robot's colour.
    """
    return len(names) > 3


def _listed(names: Sequence[str]) -> str:
    """Names of components for the label of their plot, tints from dark to light."""
    if len(names) == 1 or in_eight(names):
        return ", ".join(names)
    dark, *lighter = [name for _, name in sorted(zip(tints(len(names)), names, strict=True))]
    return ", ".join([f"{dark} (dark)", *lighter])


def robot_names(robots: int | Sequence[int]) -> list[str]:
    """Names in entity paths of a number of robots, or of those with some indices: r1 and so on."""
    indices = range(robots) if isinstance(robots, int) else robots
    return [f"r{robot + 1}" for robot in indices]


def bytes_per_s(config: CoSimConfig, level: Level, robots: int) -> float:
    """Return the weight of a recording per simulated second, about, with signals of some robots."""
    detail, timing = DETAILS[level], config.timing
    total = robots / detail.pose_s * (_ROW_BYTES + 7 * _NUMBER_BYTES)  # of the scene
    bursts_s = timing.rl_step_s * math.ceil(detail.between_s / timing.rl_step_s - 1e-9)
    for signal in signals_of(config.robot, distances=robots > 1, camera=False, full=detail.full):
        if signal.rate == "burst":
            per_s = min(detail.burst_s, timing.rl_step_s) / timing.dt_s / bursts_s
        else:
            period_s = getattr(detail, f"{signal.rate}_s", math.inf)
            per_s = 1.0 / min(max(period_s, timing.control_period_s), timing.rl_step_s)
        total += robots * per_s * (_ROW_BYTES + _NUMBER_BYTES * len(signal.names))
    return total


def warn_of_size(config: CoSimConfig, level: Level, robots: int) -> None:
    """Warn before recordings that can become large, and say what to do."""
    limit_s = config.timing.episode_limit_s
    most, least = (
        1e-6 * (_FIXED_BYTES + limit_s * bytes_per_s(config, each, robots))
        for each in (level, "summary")
    )
    if most > LARGE_MB and level != "summary":
        _LOGGER.warning(
            "the recording of an episode can become %.0f MB large (%.0f s at most); record = "
            "summary (--record summary) makes it %.0f MB at most, and time_limit or signals less",
            most,
            limit_s,
            math.ceil(least),
        )


class Stretch:
    """Samples of consecutive RL steps, one after the other, and (n,) ends of their periods."""

    def __init__(self, steps: Sequence[Step], timing: TimingParams) -> None:
        ticks = round(timing.control_period_s / timing.dt_s)
        self._lengths = [len(step.samples.omega) for step in steps]
        ends = [
            step.first_tick + ticks * np.arange(1, count + 1)
            for step, count in zip(steps, self._lengths, strict=True)
        ]
        self.time_s = timing.dt_s * np.concatenate(ends)
        joined = zip(*(step.samples for step in steps), strict=True)
        self.samples = Samples._make(map(np.concatenate, joined))
        self._last: dict[int, Samples] = {1: self.samples}  # of blocks

    def ends(self, every: int) -> np.ndarray:
        """Return the last row of each block of `every` periods; the last block may be shorter."""
        count = len(self.time_s)
        return np.minimum(np.arange(every - 1, count + every - 1, every), count - 1)

    def bursts(self, periods: int) -> np.ndarray:
        """Return the rows of the first periods of each RL step."""
        firsts = np.cumsum([0, *self._lengths[:-1]])
        steps = zip(firsts, self._lengths, strict=True)
        return np.concatenate([first + np.arange(min(periods, n)) for first, n in steps])

    def rows(
        self, of: Callable[[Samples], np.ndarray], every: int, how: Literal["mean", "max", "last"]
    ) -> np.ndarray:
        """Return a signal's mean or maximum over blocks of periods, or its last value in them."""
        if how == "last" or every == 1:
            if every not in self._last:
                ends = self.ends(every)
                self._last[every] = Samples._make(field[ends] for field in self.samples)
            return of(self._last[every])
        values, starts = of(self.samples), np.arange(0, len(self.time_s), every)
        if how == "max":
            return np.maximum.reduceat(values, starts)
        counts = np.diff(np.append(starts, len(values))).astype(np.float64)
        return np.add.reduceat(values, starts) / counts.reshape(-1, *[1] * (values.ndim - 1))

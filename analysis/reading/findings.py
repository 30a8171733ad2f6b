"""Findings in an episode: saturation, slipping, lift-offs, near misses, moves given up.

Works on what a recording holds (`cosim.recording.reader`); a finding is left out if a
recording lacks its signals. Nothing is printed here.
"""

from collections.abc import Iterator
from itertools import combinations
from typing import Any

import msgspec
import numpy as np

from cosim.recording.reader import Episode
from cosim.recording.rrd import Signal
from cosim.recording.series import IN_ZONE, NOT_ARRIVED, OFF_THE_BOARD, ON_OBSTACLE, ON_TARGET

# Eq. (9) calls robots near up to 6 cm for robots of 5 cm: a fifth of a diameter between them.
NEAR_DIAMETERS = 1.2
# A friction force is at its limit µN within this share of it; sticking feet stay below.
AT_LIMIT = 1e-6
FEET = 3
_FAILURES = {
    OFF_THE_BOARD: "out of board",
    ON_OBSTACLE: "obstacle",
    ON_TARGET: "another's target",
    IN_ZONE: "restricted zone",
    NOT_ARRIVED: "not arrived",
}


class Finding(msgspec.Struct, frozen=True):
    """One thing that looks wrong.

    Attributes:
        kind: such as "near miss".
        where: robot, pair of robots or part of one.
        text: as text.
        time_s: when to look at the recording; None if it is about all of it.
        numbers: what the text says, for programs.
    """

    kind: str
    where: str
    text: str
    time_s: float | None
    numbers: dict[str, Any]


def find(episode: Episode) -> list[Finding]:
    """All findings of an episode, by kind and time."""
    found: list[Finding] = []
    for robot in episode.robots:
        found += _saturation(episode, robot)
        found += _slipping(episode, robot)
        found += _lift_offs(episode, robot)
        found += _given_up(episode, robot)
        found += _failures(episode, robot)
    for pair in combinations(episode.robots, 2):
        found += _near_misses(episode, *pair)
    return found


def intervals(mask: np.ndarray) -> np.ndarray:
    """First and last index of every run of True, (k, 2)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(int)))
    return edges.reshape(-1, 2) - [0, 1]


def _saturation(episode: Episode, robot: str) -> Iterator[Finding]:
    voltage = episode.signals.get(f"/sim/{robot}/motors/voltage")
    if voltage is None or "V_s_max" not in episode.parameters:
        return
    limit = episode.parameter("V_s_max")
    saturated = np.abs(voltage.values) >= limit
    for motor, column in zip(voltage.components, saturated.T, strict=False):
        share = float(column.mean())
        if share > 0.0:
            first_s = float(voltage.time_s[np.argmax(column)])
            text = f"voltage at its limit of {limit:g} V in {share:.1%} of the samples"
            numbers = {"share": share, "limit_v": limit}
            yield Finding("voltage saturation", f"{robot} {motor}", text, first_s, numbers)


def _slipping(episode: Episode, robot: str) -> Iterator[Finding]:
    """Slipping is how these robots move; all feet at once for long is not."""
    state = episode.signals.get(f"/sim/{robot}/contact/slipping_share")
    if state is not None:
        share, source = float(state.values.mean()), "of the time of the feet"
    else:
        friction = episode.signals.get(f"/raw/{robot}/friction")
        normal = episode.signals.get(f"/raw/{robot}/normal")
        if friction is None or normal is None or "mu" not in episode.parameters:
            return
        share = float(sliding(friction, normal, episode.parameter("mu")).mean())
        source = "of the feet's ticks in the raw bursts"
    numbers = {"share": share}
    yield Finding("slipping", robot, f"feet slide in {share:.1%} {source}", None, numbers)


def sliding(friction: Signal, normal: Signal, mu: float) -> np.ndarray:
    """Which feet bear load with friction at its limit, (n, 3) bool, from raw forces."""
    size = np.linalg.norm(friction.values.reshape(-1, FEET, 2), axis=2)
    return (normal.values > 0.0) & (size >= mu * normal.values * (1.0 - AT_LIMIT))


def _lift_offs(episode: Episode, robot: str) -> Iterator[Finding]:
    lifted = episode.signals.get(f"/sim/{robot}/contact/lifted_share")
    if lifted is None or not lifted.values.any():
        return
    period_s = float(np.median(np.diff(lifted.time_s))) if len(lifted.time_s) > 1 else 0.0
    runs = intervals(lifted.values > 0.0)
    total_s = float(lifted.values.sum() * period_s)
    longest = max(runs, key=lambda run: lifted.values[run[0] : run[1] + 1].sum())
    numbers = {"count": len(runs), "total_s": total_s}
    text = f"{len(runs)} times a foot left the floor, for {total_s:.3f} s in all; longest here"
    yield Finding("lift-off", robot, text, float(lifted.time_s[longest[0]]), numbers)


def _given_up(episode: Episode, robot: str) -> Iterator[Finding]:
    for move in episode.moves[robot]:
        if move.given_up:
            lasted_s = move.end_s - move.start_s
            text = f"move {move.direction} given up after {lasted_s:.0f} s"
            numbers = {"lasted_s": lasted_s, "direction": move.direction}
            yield Finding("move timed out", robot, text, move.start_s, numbers)


def _failures(episode: Episode, robot: str) -> Iterator[Finding]:
    """Return what the robot lacked at the end."""
    failures = episode.texts.get(f"/rl/{robot}/failure")
    position = episode.signals.get(f"/sim/{robot}/position")
    if failures is None or position is None:
        return
    x, y = position.values[-1]
    for time_s, state in zip(failures.time_s, failures.texts, strict=True):
        numbers = {"x_m": float(x), "y_m": float(y)}
        text = f"{state} at ({100.0 * x:.2f}, {100.0 * y:.2f}) cm"
        if state == NOT_ARRIVED:
            target = episode.facts["targets_m"][episode.robots.index(robot)]
            numbers["target_away_m"] = float(np.hypot(target[0] - x, target[1] - y))
            text = f"{state}: target {100.0 * numbers['target_away_m']:.1f} cm away"
        yield Finding(_FAILURES[state], robot, text, float(time_s), numbers)


def gap_m(episode: Episode, first: str, second: str) -> tuple[np.ndarray, np.ndarray]:
    """Times in s and the gap in m between the rims of two robots, both (n,)."""
    a, b = (episode.signals[f"/sim/{robot}/position"] for robot in (first, second))
    n = min(len(a.time_s), len(b.time_s))
    distance = np.linalg.norm(a.values[:n, :2] - b.values[:n, :2], axis=1)
    return a.time_s[:n], distance - episode.parameter("diameter_m")


def _near_misses(episode: Episode, first: str, second: str) -> Iterator[Finding]:
    if any(f"/sim/{robot}/position" not in episode.signals for robot in (first, second)):
        return
    time_s, gap = gap_m(episode, first, second)
    limit = (NEAR_DIAMETERS - 1.0) * episode.parameter("diameter_m")
    runs = intervals(gap <= limit)
    told = [t for name in episode.robots if (t := episode.texts.get(f"/rl/{name}/failure"))]
    collided = episode.outcome == "collision" and not any(
        {ON_TARGET, IN_ZONE} & {*t.texts} for t in told
    )
    for number, (begin, end) in enumerate(runs):
        closest = begin + int(np.argmin(gap[begin : end + 1]))
        touched = gap[closest] <= 0.0 or (collided and number == len(runs) - 1)
        numbers = {
            "gap_m": float(gap[closest]),
            "from_s": float(time_s[begin]),
            "until_s": float(time_s[end]),
        }
        text = (
            f"gap down to {1e3 * max(float(gap[closest]), 0.0):.1f} mm, below "
            f"{1e3 * limit:.0f} mm from {time_s[begin]:.2f} to {time_s[end]:.2f} s"
        )
        kind = "collision" if touched else "near miss"
        yield Finding(kind, f"{first} and {second}", text, float(time_s[closest]), numbers)

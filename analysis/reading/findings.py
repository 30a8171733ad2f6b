"""Findings in an episode: how it ended, collisions, moves given up, saturation, slipping and more.

Works on what a recording holds (`cosim.recording.reader`); a finding is left out if a
recording lacks its signals. Nothing is printed here.
"""

import contextlib
import math
from collections.abc import Iterator
from functools import partial
from itertools import combinations
from typing import Any

import msgspec
import numpy as np

from cosim.base.errors import FileError
from cosim.recording.episode_log import REACH
from cosim.recording.reader import Episode, Signal
from cosim.recording.series import IN_ZONE, NOT_ARRIVED, OFF_THE_BOARD, ON_OBSTACLE, ON_TARGET

# A motor from rest has its full voltage for 40 ms; one that takes longer than this lacks voltage.
LONG_SATURATION_S = 0.5
# Eq. (9) calls robots near up to 6 cm for robots of 5 cm: a fifth of a diameter between them.
NEAR_DIAMETERS = 1.2
# Policies that succeed take 1.5 to 3 times as long as the longest straight line at driving speed:
# robots turn, wait and give way.
SLOW = 4.0
# A friction force is at its limit µN within this share of it; sticking feet stay below.
AT_LIMIT = 1e-6
_FAILURES = {
    OFF_THE_BOARD: "out of board",
    ON_OBSTACLE: "obstacle",
    ON_TARGET: "another's target",
    IN_ZONE: "restricted zone",
    NOT_ARRIVED: "not arrived",
}


class Finding(msgspec.Struct, frozen=True):
    """One thing that stands out in an episode."""

    kind: str  # such as "near miss"
    where: str  # robot, pair of robots or part of one
    text: str
    time_s: float | None  # when to look at the recording; None if it is about all of it
    numbers: dict[str, Any]  # what the text says, for programs
    # Whether it looks wrong; robots that reach their targets also slide, lift their feet, start
    # with full voltage and pass each other
    wrong: bool = True


def find(episode: Episode) -> list[Finding]:
    """All findings of an episode: how it ended unless well, then by robot and pair."""
    of_robots = (_saturation, _slipping, _lift_offs, _given_up, _failures)
    checks = [partial(check, episode, robot) for robot in episode.robots for check in of_robots]
    checks += [partial(_near_misses, episode, *pair) for pair in combinations(episode.robots, 2)]
    checks.append(partial(_slow, episode))
    found = [*_ending(episode)]
    for check in checks:
        with contextlib.suppress(FileError):  # the recording lacks a signal or a parameter
            found += check()
    return found


def _ending(episode: Episode) -> Iterator[Finding]:
    at = f"at {episode.time_s:.2f} s"
    if not episode.complete or not episode.outcome:
        why = "the episode was stopped" if episode.complete else "it was cut or its writer stopped"
        text = f"{why}: signals end {at}, some perhaps before"
        yield Finding("incomplete", "recording", text, episode.time_s, {})
    if episode.outcome not in ("", "success"):
        text = f"the episode ends {at}: {episode.outcome}"
        yield Finding("no success", "episode", text, episode.time_s, {})


def _slow(episode: Episode) -> Iterator[Finding]:
    """Return that robots took much longer than straight lines to their targets take."""
    targets = episode.facts.get("targets_m", [])
    starts = (episode.signals[f"/sim/{robot}/position"].values[0, :2] for robot in episode.robots)
    away_m = [float(np.hypot(*(target - at))) for target, at in zip(targets, starts, strict=False)]
    straight_s = max(away_m, default=math.inf) / episode.parameter("drive_speed_m_s")
    if 0.0 < SLOW * straight_s < episode.time_s:
        times = episode.time_s / straight_s
        text = f"{episode.time_s:.0f} s are {times:.1f} times what the longest straight line takes"
        numbers = {"straight_s": straight_s, "times": times}
        yield Finding("slow", "episode", text, SLOW * straight_s, numbers)


def intervals(mask: np.ndarray) -> np.ndarray:
    """First and last index of every run of True, (k, 2)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(int)))
    return edges.reshape(-1, 2) - [0, 1]


def _saturation(episode: Episode, robot: str) -> Iterator[Finding]:
    voltage = episode.signals[f"/sim/{robot}/motors/voltage"]
    limit = episode.parameter("V_s_max")
    saturated = np.abs(voltage.values) >= limit
    for motor, column in zip(voltage.components, saturated.T, strict=False):
        share = float(column.mean())
        if share > 0.0:
            first_s = float(voltage.time_s[np.argmax(column)])
            text = f"voltage at its limit of {limit:g} V in {share:.1%} of the samples"
            ends_s = voltage.time_s[intervals(column)]
            longest_s = float((ends_s[:, 1] - ends_s[:, 0]).max())
            numbers = {"share": share, "limit_v": limit, "longest_s": longest_s}
            where, wrong = f"{robot} {motor}", longest_s > LONG_SATURATION_S
            yield Finding("voltage saturation", where, text, first_s, numbers, wrong)


def _slipping(episode: Episode, robot: str) -> Iterator[Finding]:
    """Return the share of time in which feet slide, which is how these robots move."""
    state = episode.signals.get(f"/sim/{robot}/contact/slipping_share")
    if state is not None:
        share, source = float(state.values.mean()), "of the time of the feet"
    else:
        friction, normal = (episode.signals[f"/raw/{robot}/{n}"] for n in ("friction", "normal"))
        share = float(sliding(friction, normal, episode.parameter("mu")).mean())
        source = "of the feet's ticks in the raw bursts"
    text, numbers = f"feet slide in {share:.1%} {source}", {"share": share}
    yield Finding("slipping", robot, text, None, numbers, wrong=False)


def sliding(friction: Signal, normal: Signal, mu: float) -> np.ndarray:
    """Which feet bear load with friction at its limit, (n, 3) bool, from raw forces."""
    size = np.linalg.norm(friction.values.reshape(*normal.values.shape, 2), axis=2)
    return (normal.values > 0.0) & (size >= mu * normal.values * (1.0 - AT_LIMIT))


def _lift_offs(episode: Episode, robot: str) -> Iterator[Finding]:
    lifted = episode.signals[f"/sim/{robot}/contact/lifted_share"]
    if not lifted.values.any():
        return
    period_s = float(np.median(np.diff(lifted.time_s))) if len(lifted.time_s) > 1 else 0.0
    runs = intervals(lifted.values > 0.0)
    total_s = float(lifted.values.sum() * period_s)
    longest = max(runs, key=lambda run: lifted.values[run[0] : run[1] + 1].sum())
    numbers = {"count": len(runs), "total_s": total_s}
    text = f"{len(runs)} times a foot left the floor, for {total_s:.3f} s in all; longest here"
    at_s = float(lifted.time_s[longest[0]])
    yield Finding("lift-off", robot, text, at_s, numbers, wrong=False)


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
    if failures is None:
        return
    x, y = episode.signals[f"/sim/{robot}/position"].values[-1]
    for time_s, state in zip(failures.time_s, failures.texts, strict=True):
        numbers = {"x_m": float(x), "y_m": float(y)}
        text = f"{state} at ({100.0 * x:.2f}, {100.0 * y:.2f}) cm"
        if state == NOT_ARRIVED:
            target = episode.facts["targets_m"][int(robot.removeprefix("r")) - 1]
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
    time_s, gap = gap_m(episode, first, second)
    diameter_m = episode.parameter("diameter_m")
    limit = (NEAR_DIAMETERS - 1.0) * diameter_m
    touching = gap <= (REACH - 1.0) * diameter_m
    for robot in (first, second):
        touching &= _touches(episode, robot, time_s)
    for begin, end in intervals(gap <= limit):
        closest = begin + int(np.argmin(gap[begin : end + 1]))
        numbers = {
            "gap_m": float(gap[closest]),
            "from_s": float(time_s[begin]),
            "until_s": float(time_s[end]),
        }
        text = (
            f"gap down to {1e3 * max(float(gap[closest]), 0.0):.1f} mm, below "
            f"{1e3 * limit:.0f} mm from {time_s[begin]:.2f} to {time_s[end]:.2f} s"
        )
        touched = bool(touching[begin : end + 1].any())
        kind, where = "collision" if touched else "near miss", f"{first} and {second}"
        yield Finding(kind, where, text, float(time_s[closest]), numbers, touched)


def _touches(episode: Episode, robot: str, time_s: np.ndarray) -> np.ndarray:
    """Return whether a robot touches anything at each time, (n,) bool, by its recorded contacts."""
    touching = episode.signals.get(f"/sim/{robot}/contact/touching_share")
    if touching is None or not len(touching.time_s):
        return np.zeros(len(time_s), dtype=bool)
    rows = np.searchsorted(touching.time_s, time_s - 1e-9).clip(max=len(touching.time_s) - 1)
    return touching.values[rows] > 0.0

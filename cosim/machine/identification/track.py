"""Motor speeds that make a robot show what it is, and its track by an overhead camera."""

import csv
import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from cosim.base.errors import FileError, UserError
from cosim.base.reading import Kind, parsing, read_bytes
from cosim.base.storage import replacing
from cosim.model.config import CoSimConfig
from cosim.model.params import TABLE_I, RobotParams, lift_off_speed, motors_of

# Set points of each motor and the one before it, each held for HOLD_S, as shares of the speed at
# which the motor alone would lift the robot. Magnitudes differ, so that the phase between the
# motors goes around many times a second and averages out.
HOLD_S, DRIVEN_S = 3.0, 60.0
SHARES = ((0.0, 0.8), (0.0, -0.7), (-0.65, 0.75), (0.75, 0.65))
FRAME_RATE_HZ = 30.0

_HEADING = re.compile(
    r"\s*(.*?)\s*(?:[\[(]\s*(.*?)\s*[\])])?\s*"
)  # of a column, perhaps with a unit
LEAST_S, LEAST_FRAMES = 5.0, 100
MOST_S = 3600.0  # longer ones are in milliseconds or smaller units
MOST_INTERVAL_S = 0.25  # between most frames; longer ones are numbers of frames, or milliseconds
# Between neighbouring frames a robot moves some 0.2 mm: more than this is a hand, or another unit.
MOST_STEP_M, MOST_TURN_RAD = 0.02, 1.0
COMMENTS = "#%/"  # what lines that are none of a table begin with
MOST_SPEED_RAD_S = 5800.0  # what the motors reach at their largest voltage


_KIND = Kind("track", "record it again, see docs/own.md")


class SeenTrack(NamedTuple):
    """Observed poses and commanded motor speeds."""

    times: np.ndarray  # (n,) of the frames in s, from 0, increasing
    poses: np.ndarray  # (n, 3) x and y of the robot's axis in m, heading in rad, continuous
    commands: np.ndarray  # (n, M) set points of the motors in rad/s, each until the next frame

    def set_points(self, period_s: float) -> np.ndarray:
        """Set points (P, M) of every control period until the last frame."""
        starts = period_s * np.arange(math.ceil(self.times[-1] / period_s))
        # a command at a period's start is that period's, however its time was rounded
        rows = np.searchsorted(self.times, starts + 0.5 * period_s, side="right") - 1
        return self.commands[rows]


def units(motors: int) -> dict[str, str]:
    """Return the unit of each column of a track of a robot with some motors."""
    speeds = {f"omega_{k}": "rad/s" for k in range(1, motors + 1)}
    return {"time": "s", "x": "m", "y": "m", "heading": "rad"} | speeds


def require_rigid(machine: str, robot: RobotParams) -> None:
    """Refuse a machine on elastic legs."""
    if robot.elastic:
        raise UserError(
            f"machine {machine} stands on elastic legs, whose stiffness and damping a track from "
            "above does not tell; identify machines on rigid feet"
        )


def excitation(config: CoSimConfig) -> tuple[tuple[float, ...], ...]:
    """Return set points of a machine's motors to drive it with, in rad/s, each for HOLD_S."""
    require_rigid(config.preset, config.robot)
    robot, count = config.robot, len(config.robot.motors)
    motors = zip(robot.motors, motors_of(robot, config.motor), strict=True)
    alone = [lift_off_speed(robot._replace(motors=(mount,)), motor) for mount, motor in motors]
    rows = np.zeros((count, len(SHARES), count))
    for k in range(count):
        for row, shares in zip(rows[k], SHARES, strict=True):
            for motor, share in zip((k - 1, k), shares, strict=True):
                row[motor] = round(share * alone[motor], 1)
    rows = rows.reshape(-1, count).tolist()
    return (*map(tuple, rows),) * math.ceil(DRIVEN_S / HOLD_S / len(rows))


def write_excitation(path: Path, sequence: Sequence[Sequence[float]]) -> None:
    """Write a sequence to drive a robot with: `time,omega_1,omega_2` …, 30 rows a second."""
    motors = len(sequence[0])
    frames = np.arange(round(len(sequence) * HOLD_S * FRAME_RATE_HZ) + 1)
    with replacing(path) as temporary, temporary.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(("time", *list(units(motors))[-motors:]))
        for time_s in (frames / FRAME_RATE_HZ).round(6).tolist():
            row = int(time_s / HOLD_S)
            writer.writerow((time_s, *(sequence[row] if row < len(sequence) else [0.0] * motors)))


def read_track(
    path: Path, board_m: tuple[float, float] | None = None, robot: RobotParams = TABLE_I
) -> SeenTrack:
    """Read a CSV file with the columns of `units`, in any order and case, and perhaps others.

    They are in seconds, metres, radians counter-clockwise from +x, and rad/s. Cells are separated
    by commas, semicolons or tabs; headings may name the unit, as in "time [s]".
    """
    try:
        return _checked(*_table(path, units(len(robot.motors))), board_m)
    except ValueError as fault:  # what is wrong, and how to fix it
        raise FileError(f"{path}: {fault}") from None


def _table(path: Path, wanted: Mapping[str, str]) -> tuple[np.ndarray, list[int]]:
    """Frames of a file, (n, 4 + M) in the order of the wanted columns, and their lines."""
    content = read_bytes(path, _KIND)
    with parsing(path, _KIND):
        text = content.decode("utf-8-sig").splitlines() or [""]
        for line, content in enumerate(text, start=1):
            if content.lstrip()[:1] in tuple(COMMENTS):
                raise ValueError(f"line {line} is a comment; leave comments out")
        separator = max(",;\t", key=text[0].count)
        if text[0] and separator not in text[0]:
            raise ValueError(
                "line 1 has one column; separate cells by commas, semicolons or tabs, not by blanks"
            )
        rows = csv.reader(text, delimiter=separator, skipinitialspace=True)
        table = [(rows.line_num, row) for row in rows if row or rows.line_num == 1]
    header = table.pop(0)[1]
    columns = _columns(header, wanted)
    numbers = []
    for line, row in table:
        if len(row) > len(header):
            raise ValueError(
                f"line {line}: {len(row)} cells for {len(header)} columns; remove what is too "
                "much, and write decimal points instead of commas"
            )
        cells = row + [""] * (len(header) - len(row))
        if not any(map(_is_number, row)):
            raise ValueError(
                f"line {line} has no numbers; leave it out, and write units into line 1 as in "
                "'time [s]'"
            )
        numbers.append([_number(cells[columns[name]], name, line) for name in wanted])
    return np.array(numbers).reshape(-1, len(wanted)), [line for line, _ in table]


def _columns(header: list[str], wanted: Mapping[str, str]) -> dict[str, int]:
    """Position of each wanted column in the first line."""
    found: dict[str, int] = {}
    for k, heading in enumerate(header):
        match = _HEADING.fullmatch(heading.lower())
        name, unit = match.groups() if match else ("", None)
        if name in found:
            raise ValueError(f"line 1 has two columns {name}; remove or rename one")
        if name in wanted:
            if unit not in {None, wanted[name]}:
                raise ValueError(f"line 1: {name} is in {unit}; give it in {wanted[name]}")
            found[name] = k
    if missing := [name for name in wanted if name not in found]:
        raise ValueError(f"line 1 has no column {missing[0]}; give {','.join(wanted)}")
    return found


def _is_number(text: str) -> bool:
    try:
        return math.isfinite(float(text.replace(",", ".")))
    except ValueError:
        return False


def _number(text: str, name: str, line: int) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        wrong = f"{text!r} is not a number" if text.strip() else "the number is missing"
        fix = "write a decimal point" if "," in text else "fix or remove the line"
        raise ValueError(f"line {line}: {name}: {wrong}; {fix}")
    return value


def _checked(table: np.ndarray, lines: list[int], board_m: tuple[float, float] | None) -> SeenTrack:
    times, commands = table[:, 0] - table[:1, 0], table[:, 4:].copy()
    if len(times) < LEAST_FRAMES or times[-1] < LEAST_S:
        raise ValueError(
            f"ends at line {lines[-1] if lines else 1} after {len(times)} frames; record at least "
            f"{LEAST_FRAMES} frames and {LEAST_S:g} s, with times in seconds"
        )
    if times[-1] > MOST_S:
        raise ValueError(
            f"the times of its frames span {times[-1]:.6g} s, more than {MOST_S:g} s; give them "
            "in seconds, or cut the track"
        )
    interval_s = float(np.median(np.diff(times)))
    if interval_s > MOST_INTERVAL_S:
        raise ValueError(
            f"its frames are {interval_s:g} s apart; give times in seconds instead of numbers of "
            f"frames or milliseconds, and record {1.0 / MOST_INTERVAL_S:g} or more a second"
        )
    poses = np.column_stack([table[:, 1:3], np.unwrap(table[:, 3])])
    intervals, steps = np.diff(times, prepend=-1.0), np.diff(poses, axis=0, prepend=poses[:1])
    places = poses[:, :2]
    outside = (places < 0.0) | (places > (board_m or math.inf))
    lost = (table[:, 1:4] == 0.0).all(axis=1)
    lost &= np.arange(len(lost)) > np.argmin(lost)  # a robot may begin at the origin
    for wrong, what in (
        (lost, "x, y and heading are 0: the camera has lost the robot; leave such lines out"),
        (
            _alone(poses),
            "the pose jumps and returns in the next frame; leave the line out (a heading turned by "
            "180° has front and back exchanged)",
        ),
        (intervals <= 0.0, "its time is not after the line before; sort the frames"),
        (
            outside.any(axis=1) & (board_m is not None),
            "the robot has left the board; cut the track before",
        ),
        (
            np.hypot(*steps[:, :2].T) > MOST_STEP_M,
            f"x and y jump by more than {MOST_STEP_M:g} m; give metres and leave the robot alone",
        ),
        (
            np.abs(steps[:, 2]) > MOST_TURN_RAD,
            f"the heading jumps by more than {MOST_TURN_RAD:g} rad; give radians, always of the "
            "robot's front",
        ),
        (
            np.abs(commands).max(axis=1) > MOST_SPEED_RAD_S,
            f"a motor speed beyond {MOST_SPEED_RAD_S:g} rad/s; give rad/s",
        ),
    ):
        if wrong.any():
            raise ValueError(f"line {lines[int(np.argmax(wrong))]}: {what}")
    if not commands.any():
        raise ValueError("the motor speeds are 0 in every line; drive the robot")
    return SeenTrack(times, poses, commands)


def _alone(poses: np.ndarray) -> np.ndarray:
    """Return for each frame whether it alone is elsewhere than both of its neighbours."""

    def far(frames: int) -> np.ndarray:
        steps = poses[frames:] - poses[:-frames]
        turns = np.abs(steps[:, 2] - 2.0 * np.pi * np.round(steps[:, 2] / (2.0 * np.pi)))
        return (np.hypot(*steps[:, :2].T) > MOST_STEP_M) | (turns > MOST_TURN_RAD)

    alone = far(1)[:-1] & far(1)[1:] & ~far(2)
    return np.concatenate([[False], alone, [False]])

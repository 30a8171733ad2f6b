"""Whether a track can be of a machine that is driven as its rows say, by a simulation."""

import logging
import math
from collections.abc import Iterator

import numpy as np

from cosim.base.errors import UserError
from cosim.machine.identification.simulated import Simulated
from cosim.machine.identification.track import SeenTrack

# Motors whose speeds are closer than this keep their phase for so long that it decides the motion,
# which nothing in a track tells; from when on it hardly matters; and the share of the time in which
# they may be closer.
LEAST_GAP_RAD_S, GOOD_GAP_RAD_S, MOST_SHARE = 50.0, 100.0, 0.2
_LOGGER = logging.getLogger(__name__)
# Of the correlation of motions seen and simulated: what a right track has at least, with motors
# that turn both ways and with others (a Kilobot whose parameters all differ has 0.49); what a fault
# must give to be named, and by how much better it must explain the track; and how near to that
# others are named too.
LEAST, LEAST_UNSIGNED = 0.3, 0.8
SURE, BETTER, NEAR = 0.5, 0.1, 0.25
STILL = 0.01  # of the seen motions: a simulation with less hardly moves
ARM_M = 0.02  # turns count as the way of a point at this distance
# What columns might be: signs of x, y and heading, and its offset; and factors of motor speeds.
POSES = {
    "": ((1.0, 1.0, 1.0), 0.0),
    "change the signs of y and heading (in a camera's image y points down)": ((1.0, -1.0, -1.0), 0),
    "change the sign of heading (counter-clockwise is positive)": ((1.0, 1.0, -1.0), 0.0),
    "change the sign of y (in a camera's image it points down)": ((1.0, -1.0, 1.0), 0.0),
    "exchange the motors' columns, or measure the heading towards the robot's front": (
        (1.0, 1.0, 1.0),
        math.pi,
    ),
}
SPEEDS = {
    "": 1.0,
    "change the sign of all motor speeds": -1.0,
    "give motor speeds in rad/s instead of Hz": 2.0 * math.pi,
    "give motor speeds in rad/s instead of rpm": math.pi / 30.0,
}


def require_plausible(name: str, track: SeenTrack, drive: Simulated) -> None:
    """Refuse a track whose motors keep their phases, or that moves as no such machine can.

    `name` is the track's in messages. The likeliest fault is named: what, if it were so, would make
    the track move as the simulation.
    """
    agreements = dict(_agreements(track, drive))
    own, best = agreements[""], max(agreements.values())
    signed = track.commands.min() < 0.0
    if own >= max(LEAST if signed else LEAST_UNSIGNED, best - BETTER):
        _require_phases(name, track)
        return
    fixes = [fix for fix, agreement in agreements.items() if fix and agreement > best - NEAR]
    if best < max(SURE, own + BETTER):
        fixes = ["check units, signs and order of the motor speeds, and --preset"]
        if not signed:
            fixes = ["give motor speeds with their signs, negative backwards"]
    raise UserError(
        f"{name}: the robot does not move as its machine does at these motor speeds; "
        + ", or ".join(fixes)
    )


def _require_phases(name: str, track: SeenTrack) -> None:
    """Refuse a track with speeds of two motors that are too close; warn of near ones."""
    sizes = np.abs(track.commands[:-1])
    ordered = np.sort(np.where(sizes > 0.0, sizes, np.nan), axis=1)  # those that stand are last
    gaps, lasting = np.diff(ordered, axis=1), np.diff(track.times)
    driven_s = max(lasting[sizes.any(axis=1)].sum(), 1e-9)
    for gap in (LEAST_GAP_RAD_S, GOOD_GAP_RAD_S):
        share = lasting[(gaps < gap).any(axis=1)].sum() / driven_s
        if share > MOST_SHARE:
            refused = gap == LEAST_GAP_RAD_S
            close = (
                f"{name}: in {share:.0%} of the time that it drives, speeds of two motors differ "
                f"by less than {gap:g} rad/s, and their phase "
                f"{'decides' if refused else 'is a part of'} the motion; drive it with what "
                "--excite writes, or let one motor stand"
            )
            if refused:
                raise UserError(close)
            _LOGGER.warning(close)


def _agreements(track: SeenTrack, drive: Simulated) -> Iterator[tuple[str, float]]:
    """Yield what might be wrong and how well motions agree then; "" as they are.

    Motions are those between changes of the set points, by a robot with the usual values.
    """
    changes = np.flatnonzero(np.diff(track.commands, axis=0).any(axis=1)) + 1
    starts = np.unique(np.append(0, changes[changes < len(track.times) - 1]))
    seen = {}
    for fix, (signs, offset) in POSES.items():
        seen[fix] = _motions(track.poses * signs + [0.0, 0.0, offset], starts)
    for fix, frames in zip(SPEEDS, drive.usual_frames([*SPEEDS.values()]), strict=True):
        simulated = _motions(frames, starts)
        for pose, motions in seen.items():
            if not (fix and pose):
                yield fix or pose, _correlation(motions, simulated)


def _correlation(seen: np.ndarray, simulated: np.ndarray) -> float:
    """Return the correlation of motions; 0 where nothing moves, or a simulation hardly does."""
    size, own = np.linalg.norm(seen), np.linalg.norm(simulated)
    return float((seen * simulated).sum() / max(size * max(own, STILL * size), 1e-15))


def _motions(poses: np.ndarray, starts: np.ndarray) -> np.ndarray:
    """Motions (S, 3) from start to start of poses (n, 3), as the robot sees them, in m."""
    steps = np.diff(poses[:, 0] + 1j * poses[:, 1]) * np.exp(-1j * poses[:-1, 2])
    turns = ARM_M * np.diff(poses[:, 2])
    return np.add.reduceat(np.column_stack([np.real(steps), np.imag(steps), turns]), starts)

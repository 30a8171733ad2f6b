"""The decision process as numba kernels: N robots on a board, one simultaneous move at a time.

Not a learner and not an environment class: `agent.training.qlearning`, `agent.mdp.exact` and
`agent.envs` all step these kernels, so that there is one process. A `world` is an (N, 11) int64
array; its columns are named below; `agent.mdp.interpretations.Process` describes the board.
"""

import numpy as np

from agent.mdp.interpretations import FREE, GOAL, OUTSIDE, Process
from agent.mdp.rng import PROBABILITY_SHIFT, next_index, next_word
from cosim.base.jit import inlined
from cosim.model.outcome import COLLISION, OUT_OF_BOARD, RUNNING, SUCCESS
from cosim.onboard.features import (
    DIRECTIONS,
    distance_class,
    facing_of,
    gradient_sign,
    starting_facing,
)

# Columns of a world.
X, Y = 0, 1  # cell
VX, VY = 2, 3  # last move in cells; 0 for a robot that stays
STATUS = 4  # MOVING, ARRIVED, LEFT or HIT
SQUARED = 5  # squared distance to the nearest other robot in cells², ALONE if there is none
CLASS = 6  # Eq. (9)
SIGN = 7  # Eq. (10)
BEARING = 8  # direction of the nearest other robot, index into DIRECTIONS; 0 if there is none
AXIS = 9  # what the robot faces, by `facing_of`: the paper's axis of the direction of its last move
PARTNER = 10  # cell x·rows + y of the nearest other robot; 0 if there is none
COLUMN_COUNT = 11
FEATURE_COLUMNS = {"x": X, "y": Y, "d": CLASS, "g": SIGN, "b": BEARING, "h": AXIS, "p": PARTNER}

MOVING, ARRIVED, LEFT, HIT = 0, 1, 2, 3  # status of a robot

ALONE = 1 << 40  # beyond every distance on a board
SQRT_2 = np.sqrt(2.0)  # cells that a diagonal move is long


@inlined
def nearest_other(process: Process, world: np.ndarray, i: int) -> tuple[int, int, int]:
    """The nearest robot to robot i (the first, if several): squared distance, bearing and cell.

    Bearing and cell are 0 where no feature needs them; a robot off the board is at its edge.
    """
    nearest = ALONE
    bearing = partner = 0
    for j in range(len(process.start_offsets) - 1):
        if j != i:
            dx = world[j, X] - world[i, X]
            dy = world[j, Y] - world[i, Y]
            squared = dx * dx + dy * dy
            if squared < nearest:
                nearest = squared
                if process.strides[4] > 0:
                    bearing = int(process.bearings[dx, dy])
                if process.strides[6] > 0:
                    columns, rows = process.terrain.shape[1] - 2, process.terrain.shape[2] - 2
                    x = min(max(world[j, X], 0), columns - 1)
                    partner = x * rows + min(max(world[j, Y], 0), rows - 1)
    return nearest, bearing, partner


@inlined
def _observe_nearest(process: Process, world: np.ndarray, i: int) -> None:
    """Update what robot i sees of the nearest other robot."""
    nearest, bearing, partner = nearest_other(process, world, i)
    # Eq. (10)
    world[i, SIGN] = gradient_sign(nearest, world[i, SQUARED])
    world[i, SQUARED] = nearest
    # Eq. (9)
    world[i, CLASS] = distance_class(nearest, process.thresholds)
    world[i, BEARING] = bearing
    world[i, PARTNER] = partner


@inlined
def place(process: Process, world: np.ndarray, cells: np.ndarray) -> bool:
    """Put the robots on their start cells, (N, 2) int64; False if two of them touch."""
    n, rows = len(process.start_offsets) - 1, process.terrain.shape[2] - 2
    for i in range(n):
        world[i, X] = cells[i, 0]
        world[i, Y] = cells[i, 1]
        world[i, VX] = 0
        world[i, VY] = 0
        world[i, STATUS] = MOVING
        world[i, AXIS] = starting_facing(cells[i, 1], rows, process.facings)
    free = True
    for i in range(n):
        _observe_nearest(process, world, i)
        world[i, SIGN] = 0
        free = free and world[i, SQUARED] > process.thresholds.contact
    return free


@inlined
def place_randomly(
    process: Process, world: np.ndarray, cells: np.ndarray, random: np.ndarray
) -> None:
    """Put the robots on uniformly drawn start cells, drawn again while any two touch.

    They are written to `cells`, (N, 2) int64, and the state of the generator advances.
    """
    while True:
        for i in range(len(process.start_offsets) - 1):
            first = process.start_offsets[i]
            k = first + next_index(random, process.start_offsets[i + 1] - first)
            cells[i, 0] = process.start_cells[k, 0]
            cells[i, 1] = process.start_cells[k, 1]
        if place(process, world, cells):
            return


@inlined
def slipped(process: Process, action: int, random: np.ndarray) -> int:
    """The direction executed for an action: itself, or with the slip probability a neighbour."""
    word = next_word(random)
    if (word >> PROBABILITY_SHIFT) < process.slip_threshold:
        turn = 1 if word & np.uint64(1) else -1
        return (action + turn) & 7
    return action


@inlined
def touched_between(world: np.ndarray, i: int, j: int, contact: int) -> bool:
    """Return whether two robots touched within their last straight, simultaneous moves."""
    # relative start p and move v; |p + v t|² is least at t = −p·v/|v|²
    vx = world[j, VX] - world[i, VX]
    vy = world[j, VY] - world[i, VY]
    px = world[j, X] - world[i, X] - vx
    py = world[j, Y] - world[i, Y] - vy
    along = -(px * vx + py * vy)
    speed = vx * vx + vy * vy
    if along <= 0 or along >= speed:
        return False  # closest at an end, which the cells show
    return (px * px + py * py) * speed - along * along <= contact * speed


@inlined
def grazed_a_corner(process: Process, world: np.ndarray, i: int) -> bool:
    """Return whether robot i touched an obstacle in the middle of its last move.

    Only in a diagonal one: all others are closest at an end, which the terrain shows.
    """
    vx, vy = world[i, VX], world[i, VY]
    if vx * vy == 0:
        return False
    x, y = max(world[i, X], world[i, X] - vx), max(world[i, Y], world[i, Y] - vy)
    return bool(process.corners[x, y])


@inlined
def move(process: Process, world: np.ndarray, actions: np.ndarray, rewards: np.ndarray) -> int:
    """Move all robots that are still moving by one cell at once.

    Args:
        world: updated.
        actions: (N,) int64 directions executed; ignored for robots that do not move.
        rewards: (N,) float32, written with Eq. (8) or (11); 0 for robots that did not move.

    Returns:
        RUNNING, SUCCESS, COLLISION or OUT_OF_BOARD; a robot off the board outranks a collision.
    """
    n = len(process.start_offsets) - 1
    for i in range(n):
        if world[i, STATUS] == MOVING:
            world[i, VX] = DIRECTIONS[actions[i], 0]
            world[i, VY] = DIRECTIONS[actions[i], 1]
            world[i, X] += world[i, VX]
            world[i, Y] += world[i, VY]
            world[i, AXIS] = facing_of(actions[i], process.facings)
        else:
            world[i, VX] = 0
            world[i, VY] = 0
    contact = process.thresholds.contact
    farthest = process.move_reward.shape[2] - 1
    arrived = 0
    outcome = RUNNING
    for i in range(n):
        _observe_nearest(process, world, i)
        nearest = world[i, SQUARED]
        touched = nearest <= contact
        if process.swept:
            for j in range(n):
                touched |= j != i and touched_between(world, i, j, contact)
            touched |= grazed_a_corner(process, world, i)
        if world[i, STATUS] != MOVING:
            rewards[i] = np.float32(0.0)
            arrived += 1
            continue
        terrain = process.terrain[i, world[i, X] + 1, world[i, Y] + 1]
        # begin reward
        # Eq. (8), and its last case by Eq. (11)
        if terrain == FREE and not touched:
            diagonal = (world[i, VX] * world[i, VY]) & 1
            approaching = 1 if world[i, SIGN] < 0 else 0
            rewards[i] = process.move_reward[diagonal, approaching, min(nearest, farthest)]
        elif terrain == GOAL and not touched:
            world[i, STATUS] = ARRIVED
            rewards[i] = process.goal_reward
            arrived += 1
        elif terrain == OUTSIDE:
            world[i, STATUS] = LEFT
            rewards[i] = -process.goal_reward
            outcome = OUT_OF_BOARD
        else:
            world[i, STATUS] = HIT
            rewards[i] = -process.goal_reward
            if outcome == RUNNING:
                outcome = COLLISION
        # end reward
    if outcome == RUNNING and arrived == n:
        return SUCCESS
    return outcome


@inlined
def state_index(process: Process, world: np.ndarray, i: int) -> np.uint64:
    """Row of robot i's table for what it sees: cell, Eq. (9), Eq. (10), bearing, axis, partner."""
    strides = process.strides
    # unsigned, so that the compiler leaves out the handling of negative indices
    return np.uint64(
        world[i, X] * strides[0]
        + world[i, Y] * strides[1]
        + world[i, CLASS] * strides[2]
        + (world[i, SIGN] + 1) * strides[3]
        + world[i, BEARING] * strides[4]
        + world[i, AXIS] * strides[5]
        + world[i, PARTNER] * strides[6]
    )


@inlined
def least_rotation_argmax(values: np.ndarray, facing: int) -> int:
    """Greedy direction of Eq. (6), (8,) values; ties go to the least rotation from `facing`."""
    best = values[facing]
    action = facing
    for turn in range(1, 5):
        left = (facing + turn) & 7
        right = (facing - turn) & 7
        # of two equal turns the lower index, as `numpy.argmax` would
        for candidate in (min(left, right), max(left, right)):
            if values[candidate] > best:
                best = values[candidate]
                action = candidate
    return action

"""The decision process with the dynamics' time: moves that last, and robots that move at once.

Robots are asked every RL step; where these are short, those in which no robot waits pass at once,
up to 2 s. One that waits begins a move, drawn from the moves observed in
co-simulation; the others are under way. Positions are continuous: a cell belongs to the robot
with its centre in it, contact is a distance of centres, or of a centre and an obstacle. The
features are those of `agent.mdp.grid`, seen between cells as `cosim.onboard.observing` sees
them. No learning here.
"""

import math

import numpy as np

from agent.mdp.config import REWARDS_PER
from agent.mdp.grid import (
    ARRIVED,
    AXIS,
    BEARING,
    CLASS,
    HIT,
    LEFT,
    MOVING,
    PARTNER,
    SIGN,
    SQUARED,
    STATUS,
    VX,
    VY,
    X,
    Y,
    nearest_other,
)
from agent.mdp.interpretations import FORBIDDEN, FREE, GOAL, OUTSIDE, Process
from agent.mdp.rng import next_index
from agent.moves.model import MoveModel, move_kind
from cosim.base.jit import inlined
from cosim.model.outcome import COLLISION, OUT_OF_BOARD, RUNNING, SUCCESS
from cosim.model.params import TIMING
from cosim.onboard.features import DIRECTIONS, distance_class, facing_of, gradient_sign
from cosim.physics.collision import touches_obstacle

# Columns of a robot's plan and how far it is along it, float64.
FROM_X, FROM_Y, TO_X, TO_Y = 0, 1, 2, 3  # ends of its move, cells
DRIFT_X, DRIFT_Y = 4, 5  # path during the turn, cells
TURN_S, DURATION_S = 6, 7  # time of the turn, and of the whole move
ELAPSED_S = 8  # since the move began; at least DURATION_S for a robot that waits
AT_X, AT_Y = 9, 10  # position, cells
LAST_X, LAST_Y = 11, 12  # position a step ago, where rewards are per distance
WORLD = 13  # index of the world that its moves are drawn from
PLAN_SIZE = 14

_CHECKS = 4  # of contact in up to 2 s: robots come closer by some 3 mm between two of them
_ROUNDING = 1e-9  # of times
_PAPER_RL_STEP_S = TIMING.rl_step_s  # what rewards per time are paid for
_PER_TIME, _PER_DISTANCE = REWARDS_PER.index("time"), REWARDS_PER.index("distance")


@inlined
def reset_plans(model: MoveModel, world: np.ndarray, plans: np.ndarray, random: np.ndarray) -> None:
    """Let every robot wait at the centre of its cell, in a world that it draws."""
    worlds = len(model.offsets)
    for i in range(world.shape[0]):
        plans[i, AT_X] = world[i, X] + 0.5
        plans[i, AT_Y] = world[i, Y] + 0.5
        plans[i, DURATION_S] = 0.0
        plans[i, ELAPSED_S] = 0.0
        plans[i, WORLD] = next_index(random, worlds) if worlds > 1 else 0


@inlined
def waits(plans: np.ndarray, i: int) -> bool:
    """Return whether robot i has ended its move."""
    return plans[i, ELAPSED_S] >= plans[i, DURATION_S]


@inlined
def begin_move(
    process: Process,
    model: MoveModel,
    world: np.ndarray,
    plans: np.ndarray,
    i: int,
    direction: int,
    random: np.ndarray,
) -> int:
    """Let robot i begin a move towards the neighbouring cell in a direction.

    Returns:
        RUNNING, or COLLISION or OUT_OF_BOARD if it may not enter that cell.
    """
    vx, vy = DIRECTIONS[direction, 0], DIRECTIONS[direction, 1]
    world[i, VX], world[i, VY] = vx, vy
    terrain = process.terrain[i, world[i, X] + vx + 1, world[i, Y] + vy + 1]
    if terrain not in (FREE, GOAL):
        world[i, STATUS] = LEFT if terrain == OUTSIDE else HIT
        return OUT_OF_BOARD if terrain == OUTSIDE else COLLISION
    kind = move_kind(direction, world[i, AXIS], process.facings)
    offsets = model.offsets[int(plans[i, WORLD])]
    row = offsets[kind] + next_index(random, offsets[kind + 1] - offsets[kind])
    drift_x, drift_y = model.moves[row, 2], model.moves[row, 3]
    stop_x, stop_y = model.moves[row, 4], model.moves[row, 5]
    for _ in range(direction // 2):
        drift_x, drift_y = -drift_y, drift_x
        stop_x, stop_y = -stop_y, stop_x
    plans[i, FROM_X], plans[i, FROM_Y] = plans[i, AT_X], plans[i, AT_Y]
    plans[i, TO_X] = world[i, X] + vx + 0.5 + stop_x
    plans[i, TO_Y] = world[i, Y] + vy + 0.5 + stop_y
    plans[i, DRIFT_X], plans[i, DRIFT_Y] = drift_x, drift_y
    plans[i, TURN_S] = model.moves[row, 0]
    plans[i, DURATION_S] = model.moves[row, 1]
    plans[i, ELAPSED_S] = 0.0
    world[i, AXIS] = facing_of(direction, process.facings)
    world[i, SQUARED] = nearest_other(process, world, i)[0]
    return RUNNING


@inlined
def _go_on(plans: np.ndarray, i: int, seconds: float) -> None:
    """Position of robot i some seconds later: it turns and drifts, then drives to its end."""
    plans[i, ELAPSED_S] += seconds
    elapsed, turn, duration = plans[i, ELAPSED_S], plans[i, TURN_S], plans[i, DURATION_S]
    if elapsed < turn:
        share = elapsed / turn
        plans[i, AT_X] = plans[i, FROM_X] + share * plans[i, DRIFT_X]
        plans[i, AT_Y] = plans[i, FROM_Y] + share * plans[i, DRIFT_Y]
        return
    rest = 0.0 if elapsed >= duration else (duration - elapsed) / (duration - turn)
    plans[i, AT_X] = plans[i, TO_X] + rest * (plans[i, FROM_X] + plans[i, DRIFT_X] - plans[i, TO_X])
    plans[i, AT_Y] = plans[i, TO_Y] + rest * (plans[i, FROM_Y] + plans[i, DRIFT_Y] - plans[i, TO_Y])


@inlined
def _is_forbidden(process: Process, i: int, x: float, y: float, to_x: float, to_y: float) -> bool:
    """Return whether the centre of robot i enters a forbidden cell between two near points."""
    terrain = process.terrain[i]
    if not (0.0 <= to_x < terrain.shape[0] - 2 and 0.0 <= to_y < terrain.shape[1] - 2):
        return False
    column, row = math.floor(x), math.floor(y)
    to_column, to_row = int(to_x), int(to_y)
    if terrain[to_column + 1, to_row + 1] == FORBIDDEN:
        return True
    if abs(column - to_column) != 1 or abs(row - to_row) != 1:
        return False
    # on its way it was in one of the two cells that both share a side with
    share = (max(column, to_column) - x) / (to_x - x)
    if math.floor(y + share * (to_y - y)) == row:
        return bool(terrain[to_column + 1, row + 1] == FORBIDDEN)
    return bool(terrain[column + 1, to_row + 1] == FORBIDDEN)


@inlined
def _touch(process: Process, model: MoveModel, world: np.ndarray, plans: np.ndarray) -> bool:
    """Return whether robots touch each other or obstacles; those that had not arrived are HIT."""
    touched = False
    for i in range(world.shape[0]):
        if world[i, STATUS] == MOVING and touches_obstacle(
            plans[i, AT_X], plans[i, AT_Y], process.squared_radius, process.walls
        ):
            touched = True
            world[i, STATUS] = HIT
        for j in range(i):
            dx = plans[i, AT_X] - plans[j, AT_X]
            dy = plans[i, AT_Y] - plans[j, AT_Y]
            if dx * dx + dy * dy <= model.contact_cells:
                touched = True
                for k in (i, j):
                    if world[k, STATUS] == MOVING:
                        world[k, STATUS] = HIT
    return touched


@inlined
def _near(model: MoveModel, plans: np.ndarray) -> bool:
    """Return whether any two robots could touch within the RL steps that pass at once."""
    for i in range(plans.shape[0]):
        for j in range(i):
            dx = plans[i, AT_X] - plans[j, AT_X]
            dy = plans[i, AT_Y] - plans[j, AT_Y]
            if dx * dx + dy * dy <= model.near_cells:
                return True
    return False


@inlined
def step(
    process: Process, model: MoveModel, world: np.ndarray, plans: np.ndarray, rewards: np.ndarray
) -> tuple[int, int]:
    """Let RL steps pass until a robot waits, or 2 s.

    Args:
        world: columns of `agent.mdp.grid`, updated; CLASS, SIGN, BEARING and PARTNER are what
            each robot sees now, SQUARED stays that of its last decision.
        plans: (N, PLAN_SIZE), updated.
        rewards: (N,) float32, written with Eq. (8) or (11) for every robot that was moving.

    Returns:
        RUNNING, SUCCESS, COLLISION or OUT_OF_BOARD, and how many RL steps have passed.
    """
    n = world.shape[0]
    steps = model.most_steps
    for i in range(n):
        if steps > 1 and world[i, STATUS] == MOVING and not waits(plans, i):
            left = (plans[i, DURATION_S] - plans[i, ELAPSED_S]) / model.rl_step_s
            steps = min(steps, max(1, math.ceil(left - _ROUNDING)))
    checks = _CHECKS if len(process.walls) > 0 or _near(model, plans) else 1
    pause = steps * model.rl_step_s / checks
    if process.reward_per == _PER_DISTANCE:
        for i in range(n):
            plans[i, LAST_X], plans[i, LAST_Y] = plans[i, AT_X], plans[i, AT_Y]
    touched = False
    for _ in range(checks):
        for i in range(n):
            if world[i, STATUS] == MOVING and not waits(plans, i):
                x, y = plans[i, AT_X], plans[i, AT_Y]
                _go_on(plans, i, pause)
                if _is_forbidden(process, i, x, y, plans[i, AT_X], plans[i, AT_Y]):
                    world[i, STATUS] = HIT
                    touched = True
        touched |= _touch(process, model, world, plans)
        if touched:
            break
    lost = False
    columns, rows = process.terrain.shape[1] - 2, process.terrain.shape[2] - 2
    for i in range(n):
        x, y = plans[i, AT_X], plans[i, AT_Y]
        if not (0.0 <= x < columns and 0.0 <= y < rows):  # it drifted off while it turned
            lost = True
            world[i, STATUS] = LEFT
        world[i, X] = min(max(int(x), 0), columns - 1)
        world[i, Y] = min(max(int(y), 0), rows - 1)
    arrived = 0
    farthest = process.move_reward.shape[2] - 1
    for i in range(n):
        rewards[i] = np.float32(0.0)
        if world[i, STATUS] == ARRIVED:
            arrived += 1
            continue
        nearest, world[i, BEARING], world[i, PARTNER] = nearest_other(process, world, i)
        # Eq. (9) and (10)
        world[i, CLASS] = distance_class(nearest, process.thresholds)
        world[i, SIGN] = gradient_sign(nearest, world[i, SQUARED])
        at_goal = process.terrain[i, world[i, X] + 1, world[i, Y] + 1] == GOAL
        # Eq. (8), and its last case by Eq. (11)
        if world[i, STATUS] in (HIT, LEFT):
            rewards[i] = -process.goal_reward
        elif at_goal and waits(plans, i):
            world[i, STATUS] = ARRIVED
            rewards[i] = process.goal_reward
            arrived += 1
        else:
            approaching = 1 if world[i, SIGN] < 0 else 0
            rewards[i] = process.move_reward[0, approaching, min(nearest, farthest)]
            if process.reward_per == _PER_TIME:
                rewards[i] *= np.float32(steps * model.rl_step_s / _PAPER_RL_STEP_S)
            elif process.reward_per == _PER_DISTANCE:
                dx, dy = plans[i, AT_X] - plans[i, LAST_X], plans[i, AT_Y] - plans[i, LAST_Y]
                rewards[i] *= np.float32(np.sqrt(dx * dx + dy * dy))
            else:
                rewards[i] *= np.float32(steps)
    if lost:
        return OUT_OF_BOARD, steps
    if touched:
        return COLLISION, steps
    return SUCCESS if arrived == n else RUNNING, steps

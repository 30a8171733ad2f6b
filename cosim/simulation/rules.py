"""What happens to an episode between two stretches of its simulation, as kernels.

Robots are put on their start cells, adopt moves, and are judged after each RL step. Kernels write
into arrays of their caller, so that they need nothing but numbers: whatever calls them makes the
uniform numbers and has the time pass (`cosim.simulation.batch`).
"""

import math
from typing import NamedTuple

import numpy as np

from cosim.base.jit import inlined, kernel
from cosim.coupling.signals import State
from cosim.model.config import CoSimConfig
from cosim.model.outcome import RUNNING, SUCCESS, TIMEOUT
from cosim.model.params import ShieldParams
from cosim.model.scenario import Scenario
from cosim.onboard.estimation import POSE
from cosim.onboard.features import (
    DIRECTION_COUNT,
    DIRECTIONS,
    DistanceThresholds,
    Observation,
    distance_thresholds,
)
from cosim.onboard.observing import cell_of, observe
from cosim.onboard.shield import PARKED, plan_margin
from cosim.onboard.steering import (
    DIRECTION,
    DRIVE,
    GOAL_X,
    HOLD,
    MODE,
    PAST,
    START,
)
from cosim.onboard.yielding import DETOUR_DRAWS, WAIT, Board, board_of, give_way
from cosim.physics.body_state import X, Y, stand
from cosim.physics.contact import floor_margin

# Numbers that an episode remembers: ticks that have passed, moves that the shield has changed, and
# uniform numbers for detours that are used up.
TICK, CONFLICTS, USED = range(3)


class Rules(NamedTuple):
    """Constants of an episode."""

    board: Board
    thresholds: DistanceThresholds
    # Least and largest coordinate in m at which robots are asked, on each axis; infinite without a
    # camera, which may put them off the board
    least_m: float
    most_m: tuple[float, float]
    # move_limit, episode_limit: ticks until a robot may choose again, and until the end
    move_limit: int
    episode_limit: int
    height_m: float  # of the centre of mass of a robot that stands


class Moves(NamedTuple):
    """What an episode of N robots remembers; arrays of N int64 unless said otherwise."""

    counts: np.ndarray  # (3,) int64, see TICK
    seen: Observation  # at the end of the last RL step
    positions_m: np.ndarray  # (N, 2) float64, where robots took themselves to be then
    squared: np.ndarray  # squared distance in cells² to the nearest other robot then
    squared_before: np.ndarray  # the same at the robot's last decision
    action: np.ndarray  # direction in force, −1 of a robot that has arrived or waits
    moving_since: np.ndarray  # tick of the last decision
    # Bool: whether robots adopt an action next, adopted one at the start of the RL step, were under
    # way then, ended their move within it, and have reached their targets
    awaiting: np.ndarray
    decided: np.ndarray
    moving: np.ndarray
    completed: np.ndarray
    arrived: np.ndarray
    detours: np.ndarray  # (8 N,) float64, uniform numbers in [0, 1), see USED


def rules_of(scenario: Scenario, config: CoSimConfig) -> Rules:
    """Return the constants of an episode."""
    sensor, timing, most_m = config.world.camera, config.timing, (math.inf, math.inf)
    if sensor.rate_hz:
        width_m, height_m = scenario.size_m
        most_m = math.nextafter(width_m, 0.0), math.nextafter(height_m, 0.0)
    return Rules(
        board_of(scenario, floor_margin(config.robot, config.world)),
        distance_thresholds(scenario),
        least_m=0.0 if sensor.rate_hz else -math.inf,
        most_m=most_m,
        move_limit=config.ticks(timing.move_limit_s),
        episode_limit=config.ticks(timing.episode_limit_s),
        height_m=config.robot.com_height_m,
    )


def new_moves(targets: np.ndarray) -> Moves:
    """Return the memory of an episode before its start, with targets (N, 2) int64."""
    n = len(targets)
    numbers, flags = np.zeros((7, n), dtype=np.int64), np.zeros((5, n), dtype=bool)
    cells, goals = np.zeros_like(targets), np.zeros_like(targets)
    seen = Observation._make([cells, *numbers[:3], targets, goals])
    draws = n * DETOUR_DRAWS  # at most in an RL step
    memory = np.array([0, 0, draws]), seen, np.zeros((n, 2)), *numbers[3:], *flags, np.zeros(draws)
    moves = Moves(*memory)
    moves.action[:], moves.awaiting[:] = -1, True
    return moves


@kernel
def put_down(rules: Rules, state: State, first: int, moves: Moves, cells: np.ndarray) -> None:
    """Put the robots at rest on start cells (N, 2) int64, facing the board's centre row."""
    cell_m = rules.board.cell_m
    for i in range(len(cells)):
        x, y = (cells[i, 0] + 0.5) * cell_m, (cells[i, 1] + 0.5) * cell_m
        # Assumed: robots are set down facing the middle of the board.
        facing = math.copysign(math.pi / 2.0, rules.board.rows * cell_m / 2.0 - y)
        stand(state.bodies[:, first + i], rules.height_m, x, y, facing)
        estimate = state.estimates[first + i]
        estimate[POSE], estimate[POSE + 1], estimate[POSE + 2] = x, y, facing
    _see(rules, state, first, moves, moves.squared)
    for i in range(len(cells)):
        moves.squared_before[i] = moves.squared[i]


@inlined
def _at_end(state: State, column: int) -> bool:
    """Return whether a robot waits for a decision."""
    return state.commands[column, MODE] in (HOLD, PAST)


@inlined
def _see(rules: Rules, state: State, first: int, moves: Moves, squared_before: np.ndarray) -> None:
    """Update what robots see, and where they take themselves to be."""
    n, seen = len(moves.action), moves.seen
    for i in range(n):
        for axis in range(2):
            position_m = state.estimates[first + i, POSE + axis]
            # No robot that is asked estimates itself off the board.
            position_m = min(max(position_m, rules.least_m), rules.most_m[axis])
            moves.positions_m[i, axis] = position_m
    headings_rad = state.estimates[first : first + n, POSE + 2]
    cell_m, thresholds = rules.board.cell_m, rules.thresholds
    observe(
        moves.positions_m, headings_rad, cell_m, thresholds, squared_before, moves.squared, seen
    )
    for i in range(n):
        for axis in range(2):
            goal = cell_of(state.commands[first + i, GOAL_X + axis], cell_m)
            seen.goals[i, axis] = seen.cells[i, axis] if _at_end(state, first + i) else goal


@kernel
def adopt(
    rules: Rules,
    state: State,
    first: int,
    moves: Moves,
    wanted: np.ndarray,
    shield: ShieldParams | None,
) -> None:
    """Give fresh commands to the robots that wait for them or are late.

    Args:
        wanted: (N,) int64, the direction that each would take.
        shield: what decides which moves are permitted; None permits all.
    """
    n, margin_m, commands = len(wanted), 0.0, state.commands
    if shield is not None:
        margin_m = plan_margin(state.estimates[first : first + n], shield)
    for i in range(n):
        moves.decided[i] = False
        command, direction, before = commands[first + i], wanted[i], moves.action[i]
        if moves.awaiting[i]:
            if shield is not None:
                direction, used = give_way(
                    rules.board,
                    moves.positions_m,
                    commands[first : first + n],
                    i,
                    direction,
                    margin_m,
                    moves.detours[moves.counts[USED] :],
                )
                moves.counts[USED] += used
                moves.counts[CONFLICTS] += direction != wanted[i]
            moves.action[i] = direction
            if direction == WAIT:
                command[MODE] = HOLD
            else:
                for axis in range(2):
                    goal = moves.seen.cells[i, axis] + DIRECTIONS[direction, axis]
                    command[GOAL_X + axis] = (goal + 0.5) * rules.board.cell_m
                command[DIRECTION] = direction * 2.0 * math.pi / DIRECTION_COUNT
                on = command[MODE] == PAST and direction == before
                command[MODE] = DRIVE if on else START
                moves.moving_since[i] = moves.counts[TICK]
                moves.squared_before[i] = moves.squared[i]
                moves.decided[i] = True
        if moves.arrived[i]:
            moves.action[i] = -1
        moves.moving[i] = not _at_end(state, first + i)


@kernel
def conclude(rules: Rules, state: State, first: int, moves: Moves, driven: bool) -> int:
    """Find out what robots see and who has arrived after an RL step; return the outcome's rank.

    Args:
        driven: whether robots arrive wherever they are at the end of one, not only at the end of
            their move.
    """
    n, seen, cell_m = len(moves.action), moves.seen, rules.board.cell_m
    _see(rules, state, first, moves, moves.squared_before)
    arrived, event = 0, RUNNING
    for i in range(n):
        moves.completed[i] = moves.moving[i] and _at_end(state, first + i)
        # on their target, wherever they think they are
        column = cell_of(state.bodies[X, first + i], cell_m)
        row = cell_of(state.bodies[Y, first + i], cell_m)
        there = column == seen.targets[i, 0] and row == seen.targets[i, 1]
        if there and (driven or moves.completed[i]):
            moves.arrived[i] = True
        late = moves.counts[TICK] - moves.moving_since[i] >= rules.move_limit
        moves.awaiting[i] = not moves.arrived[i] and (_at_end(state, first + i) or late)
        if moves.arrived[i]:
            state.commands[first + i, MODE] = HOLD
        state.shields[first + i, PARKED] = moves.arrived[i]
        arrived += moves.arrived[i]
        event = max(event, state.events[first + i])
    if event != RUNNING:
        return event
    if arrived == n:
        return SUCCESS
    return TIMEOUT if moves.counts[TICK] >= rules.episode_limit else RUNNING

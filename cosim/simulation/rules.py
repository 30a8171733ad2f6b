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
from cosim.onboard.features import DIRECTION_COUNT, DIRECTIONS, Observation
from cosim.onboard.observing import Area, area_of, cell_of, observe
from cosim.onboard.shield import plan_margin
from cosim.onboard.state import PARKED
from cosim.onboard.steering import DIRECTION, DRIVE, GOAL_X, HOLD, MODE, PAST, START, waits
from cosim.onboard.yielding import DETOUR_DRAWS, WAIT, Board, board_of, give_way
from cosim.physics.body_state import X, Y, stand
from cosim.physics.feet import floor_margin

# Ticks that passed, moves that the shield changed, uniform numbers for detours that are used up.
TICK, CONFLICTS, USED = range(3)


class Rules(NamedTuple):
    """Constants of an episode."""

    board: Board
    area: Area
    # move_limit, episode_limit: ticks until a robot may choose again, and until the end
    move_limit: int
    episode_limit: int
    height_m: float  # of the centre of mass of a robot that stands


class Robots(NamedTuple):
    """Some arrays of a `State`; those alone, because more take long to compile."""

    first: int  # column of the episode
    bodies: np.ndarray
    estimates: np.ndarray
    commands: np.ndarray
    shields: np.ndarray
    events: np.ndarray


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
    return Rules(
        board_of(scenario, floor_margin(config.robot, config.world)),
        area_of(scenario, config.world.camera.rate_hz > 0.0),
        config.ticks(config.move_limit_s(scenario.cell_m)),
        config.ticks(config.timing.episode_limit_s),
        config.robot.com_height_m,
    )


def robots_of(state: State, first: int) -> Robots:
    """Return the arrays of a state that an episode reads and writes, from its first column."""
    onboard = state.onboard
    return Robots(
        first,
        state.bodies.motion,
        onboard.estimates,
        onboard.commands,
        onboard.shields,
        state.episodes.events,
    )


def new_moves(targets: np.ndarray) -> Moves:
    """Return the memory of an episode before its start, with targets (N, 2) int64."""
    n = len(targets)
    numbers, flags = np.zeros((7, n), dtype=np.int64), np.zeros((5, n), dtype=bool)
    cells, goals = np.zeros_like(targets), np.zeros_like(targets)
    seen = Observation._make([cells, *numbers[:3], targets, goals])
    draws = n * DETOUR_DRAWS  # at most in an RL step
    counts, positions_m = np.array([0, 0, draws]), np.zeros((n, 2))
    moves = Moves._make([counts, seen, positions_m, *numbers[3:], *flags, np.zeros(draws)])
    moves.action[:], moves.awaiting[:] = -1, True
    return moves


@kernel
def put_down(rules: Rules, robots: Robots, moves: Moves, cells: np.ndarray) -> None:
    """Put the robots at rest on start cells (N, 2) int64, facing the board's centre row."""
    first, cell_m = robots.first, rules.board.cell_m
    for i in range(len(cells)):
        x, y = (cells[i, 0] + 0.5) * cell_m, (cells[i, 1] + 0.5) * cell_m
        # Assumed: robots are set down facing the middle of the board.
        facing = math.copysign(math.pi / 2.0, rules.board.rows * cell_m / 2.0 - y)
        stand(robots.bodies[:, first + i], rules.height_m, x, y, facing)
        estimate = robots.estimates[first + i]
        estimate[POSE], estimate[POSE + 1], estimate[POSE + 2] = x, y, facing
    _observe(rules, robots, moves, moves.squared)
    for i in range(len(cells)):
        moves.squared_before[i] = moves.squared[i]


@inlined
def _observe(rules: Rules, robots: Robots, moves: Moves, before: np.ndarray) -> None:
    first, last = robots.first, robots.first + len(before)
    estimates, commands = robots.estimates[first:last], robots.commands[first:last]
    observe(estimates, commands, rules.area, before, moves.positions_m, moves.squared, moves.seen)


@kernel
def adopt(
    rules: Rules, robots: Robots, moves: Moves, wanted: np.ndarray, shield: ShieldParams | None
) -> None:
    """Give fresh commands to the robots that wait for them or are late.

    Args:
        wanted: (N,) int64, the direction that each would take.
        shield: what decides which moves are permitted; None permits all.
    """
    first, last, margin_m = robots.first, robots.first + len(wanted), 0.0
    commands, where = robots.commands[first:last], moves.positions_m
    if shield is not None:
        margin_m = plan_margin(robots.estimates[first:last], shield)
    for i in range(len(wanted)):
        moves.decided[i] = False
        command, direction, before = commands[i], wanted[i], moves.action[i]
        if moves.awaiting[i]:
            if shield is not None:
                draws = moves.detours[moves.counts[USED] :]
                asked = rules.board, where, commands, i, direction, margin_m, draws
                direction, used = give_way(*asked)
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
        moves.moving[i] = not waits(command)


@kernel
def conclude(rules: Rules, robots: Robots, moves: Moves, driven: bool) -> int:
    """Find out what robots see and who has arrived after an RL step; return the outcome's rank.

    Args:
        driven: whether robots arrive wherever they are at the end of one, not only at the end of
            their move.
    """
    first, seen, cell_m = robots.first, moves.seen, rules.board.cell_m
    _observe(rules, robots, moves, moves.squared_before)
    arrived, event = 0, RUNNING
    for i in range(len(moves.action)):
        command = robots.commands[first + i]
        moves.completed[i] = moves.moving[i] and waits(command)
        # on their target, wherever they think they are
        x, y = robots.bodies[X, first + i], robots.bodies[Y, first + i]
        there = (
            cell_of(x, cell_m) == seen.targets[i, 0] and cell_of(y, cell_m) == seen.targets[i, 1]
        )
        if there and (driven or moves.completed[i]):
            moves.arrived[i] = True
        late = moves.counts[TICK] - moves.moving_since[i] >= rules.move_limit
        moves.awaiting[i] = not moves.arrived[i] and (waits(command) or late)
        if moves.arrived[i]:
            command[MODE] = HOLD
        robots.shields[first + i, PARKED] = moves.arrived[i]
        arrived += moves.arrived[i]
        event = max(event, robots.events[first + i])
    if event != RUNNING:
        return event
    if arrived == len(moves.action):
        return SUCCESS
    return TIMEOUT if moves.counts[TICK] >= rules.episode_limit else RUNNING

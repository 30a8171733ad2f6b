"""The decision process of Sections III and V as data: terrain, reward and state tables.

`build_process` turns a scenario and a `ProcessConfig`, the interpretations of what the paper leaves
open, into the arrays that the kernels of `agent.mdp.grid` walk on. No dynamics here.
"""

import math
from typing import NamedTuple

import numpy as np

from agent.mdp.config import FEATURES, PARTNER_UPDATES, REWARDS_PER, ProcessConfig
from agent.mdp.rng import probability_threshold
from cosim.base.errors import UserError
from cosim.model.scenario import MAX_SIDE_CELLS, Scenario
from cosim.onboard.features import (
    AXIS_COUNT,
    DIRECTION_COUNT,
    DISTANCE_CLASSES,
    GRADIENT_SIGNS,
    DistanceThresholds,
    distance_thresholds,
)
from cosim.onboard.observing import DRAWS

FREE, GOAL, OUTSIDE, OBSTACLE, FORBIDDEN = range(5)  # terrain of a cell, as one robot sees it

MAX_JOINT_STATES = 4_000_000  # of two robots on some 45 x 45 cells: 128 MB a table, some seconds
MAX_STATES = 2**25  # of all robots together: 1 GB of tables


class Process(NamedTuple):
    """The decision process of one scenario, for the kernels."""

    # (N, columns + 2, rows + 2) uint8, FREE, GOAL, OUTSIDE, OBSTACLE or FORBIDDEN as robot i sees
    # cell (x, y) at [i, x + 1, y + 1]; the rim is OUTSIDE. In the middle of an OBSTACLE cell a
    # robot would touch an obstacle; no centre of a robot may be anywhere in a FORBIDDEN one:
    # another robot's target, or the zone if that is an obstacle
    terrain: np.ndarray
    # (columns + 1, rows + 1) bool, whether a robot over the lower left corner of a cell touches an
    # obstacle: the middle of a diagonal move, used if contact is swept
    corners: np.ndarray
    walls: np.ndarray  # (M, 4) float64, obstacles as rectangles left, bottom, right, top in cells
    squared_radius: float  # of a robot, in cells²
    cell_m: float  # edge of a cell
    start_cells: np.ndarray  # (K, 2) int64, of all robots, one robot after the other
    # N + 1 integers, robot i starts in rows start_offsets[i] to [i + 1]; a tuple, so that the
    # number of robots is a constant for the compiler
    start_offsets: tuple[int, ...]
    thresholds: DistanceThresholds  # squared distances of Eq. (9) in cells²
    # (2, 2, D² + 1) float32, Eq. (11): reward of a move that ends nothing, at [diagonal,
    # approaching, squared distance in cells², at most D²]
    move_reward: np.ndarray
    goal_reward: np.float32  # L
    # Seven integers, state index = x·s₀ + y·s₁ + d·s₂ + (g + 1)·s₃ + b·s₄ + h·s₅ + p·s₆
    strides: tuple[int, ...]
    state_count: int  # number of states of one robot's table
    # (2 columns + 3, 2 rows + 3) uint8, direction of another robot at offset (dx, dy), negative
    # offsets counting from the end
    bearings: np.ndarray
    swept: bool  # whether contact is checked along the moves
    slip_threshold: np.uint64  # `agent.mdp.rng.probability_threshold` of the slip probability
    step_limit: int  # moves after which an episode is cut
    partner_update: int  # index into `PARTNER_UPDATES`
    reward_per: int  # index into `REWARDS_PER`
    facings: int  # values of h, see `SteeringParams.facings`


def build_process(scenario: Scenario, config: ProcessConfig, facings: int = AXIS_COUNT) -> Process:
    """Tables of the decision process of a scenario under the given interpretations.

    `facings` is that of the machine, see `SteeringParams.facings`.
    """
    thresholds = distance_thresholds(scenario)
    terrain = np.stack(
        [
            _terrain(scenario, config, thresholds, robot, rectangles)
            for robot, rectangles in enumerate(scenario.forbidden)
        ]
    )
    near = ", or too near another's target" if config.target_obstacle == "disk" else ""
    for robot, cells in enumerate(scenario.starts):
        for x, y in cells:
            if terrain[robot, x + 1, y + 1] != FREE:
                raise UserError(
                    f"scenario {scenario.name}: starts[{robot}] has cell ({x}, {y}), which is "
                    f"the robot's target or an obstacle to it{near}; choose a free cell"
                )
    if not _has_free_starts(scenario, thresholds.contact):
        raise UserError(
            f"scenario {scenario.name}: hardly any combination of starts keeps the robots "
            "apart; move the start cells further apart"
        )
    if config.distance_limit_m > MAX_SIDE_CELLS * scenario.cell_m:
        raise UserError(
            f"scenario {scenario.name}: distance_limit_m = {config.distance_limit_m:g} is more "
            f"than {MAX_SIDE_CELLS} cells; make it smaller"
        )
    strides: dict[str, int] = dict.fromkeys(FEATURES, 0)  # 0 of a feature that is not used
    state_count = 1
    for feature, size in reversed(feature_sizes(scenario, config, facings).items()):
        strides[feature] = state_count
        state_count *= size
    if scenario.robots * state_count > MAX_STATES:
        raise UserError(
            f"scenario {scenario.name}: the robots' tables have {scenario.robots * state_count:,} "
            f"states, more than {MAX_STATES:,}; choose fewer robots, cells or features "
            "(`minirobots train --process.features`)"
        )
    if strides["p"] and state_count > MAX_JOINT_STATES:
        raise UserError(
            f"scenario {scenario.name}: feature p makes a robot's table {state_count:,} states "
            f"large, more than {MAX_JOINT_STATES:,}; choose a smaller board, or a method without "
            "this feature, such as moves"
        )
    return Process(
        terrain=terrain,
        corners=_blocked(scenario, 0),
        walls=scenario.walls.astype(float),
        cell_m=scenario.cell_m,
        squared_radius=(scenario.diameter_m / scenario.cell_m / 2.0) ** 2,
        start_cells=np.array([c for cells in scenario.starts for c in cells], dtype=np.int64),
        start_offsets=tuple(int(v) for v in np.cumsum([0, *(len(c) for c in scenario.starts)])),
        thresholds=thresholds,
        move_reward=_move_reward(scenario, config),
        goal_reward=np.float32(config.goal_reward),
        strides=tuple(strides.values()),
        state_count=state_count,
        bearings=_bearings(scenario),
        swept=config.collision == "swept",
        slip_threshold=probability_threshold(config.slip_probability),
        step_limit=config.step_limit,
        partner_update=PARTNER_UPDATES.index(config.partner_of_failed),
        reward_per=REWARDS_PER.index(config.reward_per),
        facings=facings,
    )


def _blocked(scenario: Scenario, shift: int) -> np.ndarray:
    """Return where a robot touches an obstacle: over corners of cells (shift 0) or in cells (1)."""
    sizes = (2 * scenario.columns + 1 - shift, 2 * scenario.rows + 1 - shift)  # in half cells
    x, y = np.ogrid[shift : sizes[0] + shift : 2, shift : sizes[1] + shift : 2]
    return np.zeros(np.broadcast(x, y).shape, dtype=bool) | scenario.blocks(x, y)


def _terrain(
    scenario: Scenario,
    config: ProcessConfig,
    thresholds: DistanceThresholds,
    robot: int,
    rectangles: np.ndarray,
) -> np.ndarray:
    """Terrain as one robot sees it, uint8 of shape (columns + 2, rows + 2).

    `rectangles` are the robot's of `Scenario.forbidden`, which takes long for many robots.
    """
    terrain = np.full((scenario.columns + 2, scenario.rows + 2), OUTSIDE, dtype=np.uint8)
    terrain[1:-1, 1:-1] = FREE
    terrain[1:-1, 1:-1][_blocked(scenario, 1)] = OBSTACLE
    for left, bottom, right, top in rectangles[np.isfinite(rectangles[:, 0])].astype(int):
        terrain[left + 1 : right + 1, bottom + 1 : top + 1] = FORBIDDEN
    goal_x, goal_y = scenario.targets[robot]
    if config.target_obstacle == "disk":
        reach = math.isqrt(thresholds.contact)
        x, y = np.mgrid[-reach : reach + 1, -reach : reach + 1]
        disk = np.argwhere(x**2 + y**2 <= thresholds.contact) - reach
        for other in np.delete(scenario.targets, robot, axis=0):
            near = other + disk
            near = near[((near >= 0) & (near < (scenario.columns, scenario.rows))).all(axis=1)]
            terrain[tuple(near.T + 1)] = FORBIDDEN
    terrain[goal_x + 1, goal_y + 1] = GOAL
    return terrain


def _has_free_starts(scenario: Scenario, contact: int) -> bool:
    """Return whether some of many draws of an episode's start cells have no contact."""
    rng = np.random.default_rng(0)
    drawn = [np.array(cells)[rng.integers(len(cells), size=DRAWS)] for cells in scenario.starts]
    low, high = (np.array([edge(cells, axis=0) for cells in drawn]) for edge in (np.min, np.max))
    gap = np.maximum(low[:, None] - high, low - high[:, None]).clip(0)  # between any two robots
    free = np.full(DRAWS, fill_value=True)
    for a, b in np.argwhere(np.triu((gap**2).sum(axis=2) <= contact, 1)).tolist():
        free &= ((drawn[a] - drawn[b]) ** 2).sum(axis=1) > contact
    return bool(free.any())


def _move_reward(scenario: Scenario, config: ProcessConfig) -> np.ndarray:
    """Eq. (11) and (12) tabulated over the squared distance, see `Process.move_reward`."""
    limit_cells = config.distance_limit_m / scenario.cell_m  # D, in cells
    squared = np.arange(math.ceil(limit_cells**2 - 1e-9) + 1)
    distance = np.minimum(np.sqrt(squared), limit_cells)
    cost = config.step_cost * np.array([1.0, config.diagonal_cost])[:, None, None]
    # begin pair
    # Eq. (12), of robots that do not approach and that do
    b = np.array([1.0, config.approach_coefficient])[:, None]
    # Eq. (11)
    reward = -b * (1.0 - distance / limit_cells) - cost
    # end pair
    return reward.astype(np.float32)


def feature_sizes(
    scenario: Scenario, config: ProcessConfig, facings: int = AXIS_COUNT
) -> dict[str, int]:
    """Number of values of each feature in use, in the order of the state index.

    A lone robot has x, y and h only.
    """
    sizes = {
        "x": scenario.columns,
        "y": scenario.rows,
        "d": len(DISTANCE_CLASSES),
        "g": len(GRADIENT_SIGNS),
        "b": DIRECTION_COUNT,
        "h": facings,
        "p": scenario.columns * scenario.rows,
    }
    seen = {"x", "y", "h"} if scenario.robots == 1 else set(sizes)
    used = {name: sizes[name] for name in sizes if name in config.features and name in seen}
    if not used:
        raise UserError(
            f"process: features = {', '.join(config.features)} have no effect: a lone robot sees "
            "no other; name x, y or h as well"
        )
    return used


def _bearings(scenario: Scenario) -> np.ndarray:
    """Sector of 45° around a direction in which each offset lies, see `Process.bearings`."""
    # offsets reach one cell beyond the board, where a robot that just left it is
    dx, dy = (
        np.concatenate([np.arange(size + 2), np.arange(-size - 1, 0)])
        for size in (scenario.columns, scenario.rows)
    )
    turns = np.arctan2(dy[None, :], dx[:, None]) / (2.0 * np.pi / DIRECTION_COUNT)
    return np.rint(turns).astype(np.int64).astype(np.uint8) % DIRECTION_COUNT

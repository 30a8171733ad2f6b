"""Features, errors and checks that environments on the grid and in the dynamics share."""

from typing import Any

import numpy as np

from agent.mdp.config import ProcessConfig
from agent.mdp.grid import AXIS, BEARING, CLASS, PARTNER, SIGN, X, Y, place
from agent.mdp.readings import FREE, GOAL, Process, feature_sizes
from cosim.base.arguments import taken
from cosim.base.errors import UserError
from cosim.model.scenario import Scenario
from cosim.onboard.features import DIRECTION_COUNT, DIRECTIONS

FEATURE_COLUMNS = {"x": X, "y": Y, "d": CLASS, "g": SIGN, "b": BEARING, "h": AXIS, "p": PARTNER}


class StartsError(UserError, ValueError):
    """Start cells, seeds or masks of a reset that cannot be used; the message says which."""


class ActionError(UserError, ValueError):
    """An action that cannot be taken; the message says whose."""


def observed_columns(scenario: Scenario, config: ProcessConfig) -> list[tuple[int, int, int]]:
    """Of each feature its column of a world, what is added to count from 0, the largest value."""
    return [
        (FEATURE_COLUMNS[name], 1 if name == "g" else 0, size - 1)
        for name, size in feature_sizes(scenario, config).items()
    ]


def free_directions(process: Process) -> np.ndarray:
    """Return which directions lead to a free cell or to the robot's target.

    (N, columns + 2, rows + 2, 8) int8 of robot i in cell (x, y) at [i, x + 1, y + 1]. Where no
    direction does, all count as free, as learners need one.
    """
    free = np.pad(np.isin(process.terrain, (FREE, GOAL)), ((0, 0), (1, 1), (1, 1)))
    columns, rows = process.terrain.shape[1:]
    moved = [free[:, 1 + x : 1 + x + columns, 1 + y : 1 + y + rows] for x, y in DIRECTIONS]
    table = np.stack(moved, axis=-1)
    return (table | ~table.any(axis=-1, keepdims=True)).astype(np.int8)


def direction_error(action: Any, whose: str = "") -> ActionError:
    """Return what is said of an action that is no direction."""
    last = DIRECTION_COUNT - 1
    return ActionError(f"action {action!r}{whose} is no direction; choose one from 0 to {last}")


def place_checked(process: Process, world: np.ndarray, starts: np.ndarray) -> None:
    """Put robots on the start cells that a user gave.

    Raises:
        StartsError: they are not (N, 2) whole numbers, off the board, blocked or in contact; the
            world is as it was.
    """
    cells = whole_cells(starts, (len(world), 2))
    columns, rows = (size - 2 for size in process.terrain.shape[1:])
    if (cells < 0).any() or (cells >= (columns, rows)).any():
        raise StartsError(f"starts {cells.tolist()} are off the {columns} x {rows} board")
    terrain = process.terrain[np.arange(len(world)), cells[:, 0] + 1, cells[:, 1] + 1]
    if terrain.any():
        raise StartsError(f"starts {cells.tolist()} are on an obstacle or on the robot's target")
    placed = world.copy()
    if not place(process, placed, cells):
        raise StartsError(f"starts {cells.tolist()} let robots touch; move them further apart")
    world[:] = placed


def require_seed(seed: Any) -> int | None:
    """Return a seed as an int; None stays None.

    Raises:
        StartsError: it is negative or no whole number.
    """
    seed = taken("seed", seed, int | None, StartsError)
    if seed is not None and seed < 0:
        raise StartsError(f"seed {seed} is negative; give a whole number from 0 on")
    return seed


def whole_cells(starts: Any, shape: tuple[int, ...], name: str = "starts") -> np.ndarray:
    """Start or target cells that a user gave, int64 of a shape.

    Raises:
        StartsError: they have another shape, or are no whole numbers.
    """
    try:
        cells = np.asarray(starts)
    except ValueError as error:  # rows of several lengths
        raise StartsError(f"{name} are no array; give cells of shape {shape}") from error
    if cells.shape != shape or cells.dtype.kind not in "iu":
        raise StartsError(
            f"{name} of shape {cells.shape} and type {cells.dtype}; give whole numbers, "
            f"cells [x, y] of shape {shape}"
        )
    return cells.astype(np.int64)


def known_options(options: dict[str, Any] | None, *names: str) -> dict[str, Any]:
    """Options of a reset.

    Raises:
        StartsError: one has another name.
    """
    for name in options or {}:
        if name not in names:
            raise StartsError(f"reset has no option '{name}'; choose from {', '.join(names)}")
    return options or {}

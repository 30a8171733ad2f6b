"""Features, errors and checks that environments on the grid and in the dynamics share."""

from typing import Any

import numpy as np

from agent.mdp.config import ProcessConfig
from agent.mdp.grid import AXIS, BEARING, CLASS, COLUMN_COUNT, PARTNER, SIGN, X, Y, place
from agent.mdp.readings import FREE, GOAL, Process, feature_sizes
from cosim.base.errors import UserError, shown
from cosim.model.scenario import Scenario
from cosim.onboard.features import DIRECTIONS

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


def placed_world(process: Process, starts: Any) -> np.ndarray:
    """Return the (N, COLUMN_COUNT) int64 world of robots on the start cells that a user gave.

    Raises:
        StartsError: they are not (N, 2) whole numbers, off the board, blocked or in contact.
    """
    world = np.zeros((len(process.start_offsets) - 1, COLUMN_COUNT), dtype=np.int64)
    cells = whole_cells("starts", starts, (len(world), 2))
    columns, rows = (size - 2 for size in process.terrain.shape[1:])
    if (cells < 0).any() or (cells >= (columns, rows)).any():
        raise StartsError(f"starts {cells.tolist()} are off the {columns} x {rows} board")
    terrain = process.terrain[np.arange(len(world)), cells[:, 0] + 1, cells[:, 1] + 1]
    if terrain.any():
        raise StartsError(f"starts {cells.tolist()} are on an obstacle or on the robot's target")
    if not place(process, world, cells):
        raise StartsError(f"starts {cells.tolist()} let robots touch; move them further apart")
    return world


def whole_numbers(values: Any, shape: tuple[int, ...]) -> np.ndarray | None:
    """Return what a user gave as int64; None if it has another shape or no whole numbers."""
    try:
        array = np.asarray(values)
    except ValueError:  # rows of several lengths
        return None
    fits = array.shape == shape and array.dtype.kind in "iu"
    return array.astype(np.int64, copy=False) if fits else None


def whole_cells(name: str, cells: Any, shape: tuple[int, ...]) -> np.ndarray:
    """Start or target cells that a user gave, int64 of a shape; raises StartsError."""
    found = whole_numbers(cells, shape)
    if found is None:
        raise StartsError(
            f"{name} = {shown(cells)} are no cells; give whole numbers [x, y] of shape {shape}"
        )
    return found


def known_options(options: dict[str, Any] | None, *names: str) -> dict[str, Any]:
    """Options of a reset.

    Raises:
        StartsError: one has another name.
    """
    for name in options or {}:
        if name not in names:
            raise StartsError(f"reset has no option '{name}'; choose from {', '.join(names)}")
    return options or {}

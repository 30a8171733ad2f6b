"""Neighbours of robots by cells: the cost for a robot does not grow with their number.

The board is divided into cells at least as wide as the distance of interest, so that everything
within it is in the 3 x 3 cells around a place. Everything is found in the order of its columns,
as if all were looked at one after the other: no sum or tie depends on the cells.
"""

import math
from typing import NamedTuple

import numpy as np

from cosim.base.jit import inlined

# Rows of the room for lists, int64: first entry of each cell, entry after each, those that were
# found. An episode of N robots has N columns in each.
HEAD, NEXT, FOUND = range(3)
LISTS = 3
_ROUNDING = 1.0 + 1e-6  # of a place's cell
_FEW = 16  # places that are in one cell: looking at all of them costs less than finding the near


class Grid(NamedTuple):
    """Cells of an episode's board."""

    first: int  # column in which the episode's lists begin
    # number of places
    count: int  # pyright: ignore[reportIncompatibleMethodOverride] - tuples can count
    # columns, rows: number of cells; at most one per robot
    columns: int
    rows: int
    # per_x, per_y: cells per metre
    per_x: float
    per_y: float


@inlined
def list_by_cells(
    lists: np.ndarray,
    xs: np.ndarray,
    ys: np.ndarray,
    first: int,
    count: int,
    board: np.ndarray,
    reach: float,
) -> Grid:
    """List places by cells, for `find_near`; returns the cells.

    Args:
        xs, ys: (B,) places in m; those off the board count to the cells at its edge.
        reach: distance in m within which places are to be found.
    """
    columns = rows = 1
    if count > _FEW:
        most = math.sqrt(count)
        columns = max(1, int(min(most, board[0] / (_ROUNDING * reach))))
        rows = max(1, int(min(most, board[1] / (_ROUNDING * reach))))
    grid = Grid(first, count, columns, rows, columns / board[0], rows / board[1])
    for cell in range(first, first + columns * rows):
        lists[HEAD, cell] = -1
    for i in range(first + count - 1, first - 1, -1):  # so that lists are in ascending order
        if columns * rows == 1:
            lists[FOUND, i], lists[NEXT, i], lists[HEAD, first] = i, lists[HEAD, first], i
            continue
        row = _index(ys[i] * grid.per_y, rows)
        cell = first + row * columns + _index(xs[i] * grid.per_x, columns)
        lists[NEXT, i] = lists[HEAD, cell]
        lists[HEAD, cell] = i
    return grid


@inlined
def find_near(lists: np.ndarray, grid: Grid, x: float, y: float) -> int:
    """Write the columns of all places within reach of (x, y), and of some beyond, to row FOUND.

    They begin at the episode's first column and ascend. Returns their number.
    """
    if grid.columns * grid.rows == 1:
        return grid.count  # all of them, see `list_by_cells`
    end = grid.first
    column, row = _index(x * grid.per_x, grid.columns), _index(y * grid.per_y, grid.rows)
    for near_row in range(max(row - 1, 0), min(row + 2, grid.rows)):
        for near_column in range(max(column - 1, 0), min(column + 2, grid.columns)):
            i = lists[HEAD, grid.first + near_row * grid.columns + near_column]
            while i >= 0:
                k = end
                while k > grid.first and lists[FOUND, k - 1] > i:
                    lists[FOUND, k] = lists[FOUND, k - 1]
                    k -= 1
                lists[FOUND, k] = i
                end += 1
                i = lists[NEXT, i]
    return end - grid.first


@inlined
def _index(cells: float, count: int) -> int:
    """Return the cell of a coordinate in cells along an axis that has a number of them."""
    return int(min(max(cells, 0.0), count - 1.0))

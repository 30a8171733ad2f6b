"""Scenarios: a board of cells, one target and one set of start cells per robot.

A scenario is geometry only; how robots learn on it is the agent's, how they move the
co-simulation's. Scenarios of the paper are built in, others are read from TOML files. Cells are
addressed (column, row) = (x, y) from the lower left corner; the board's frame has its origin at
that corner, x to the right, y up.
"""

import math
import re
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from itertools import product
from typing import Annotated, Any

import numpy as np
from msgspec import Meta

from cosim.base.arguments import validate_fields
from cosim.base.errors import UserError
from cosim.base.provenance import digest_of
from cosim.model.params import TABLE_I
from cosim.model.world import Rectangle

Cell = tuple[int, int]

MAX_SIDE_CELLS = 500  # a robot's table of such a board takes 72 MB
MAX_ROBOTS = 4096  # of which state and samples take some 0.5 GB
MAX_WALLS = 1000  # rectangles that the dynamics look at one by one
Side = Annotated[int, Meta(ge=1, le=MAX_SIDE_CELLS)]  # of a board, in cells


def touches_obstacle(x: Any, y: Any, squared_radius: Any, obstacles: np.ndarray) -> Any:
    """Return whether a disc touches an obstacle: its centre is no further from it than its radius.

    The one definition, for the grid (exact, in half cells), for moves that last and for the
    dynamics; kernels compile it with `cosim.base.jit.inlined`.

    Args:
        x, y: centre of the disc, in any unit; numbers, or arrays that broadcast.
        obstacles: (M, 4) rectangles left, bottom, right, top.
    """
    touched = False
    for k in range(len(obstacles)):
        dx = np.maximum(np.maximum(obstacles[k, 0] - x, x - obstacles[k, 2]), 0)
        dy = np.maximum(np.maximum(obstacles[k, 1] - y, y - obstacles[k, 3]), 0)
        touched = touched | (dx * dx + dy * dy <= squared_radius)
    return touched


@dataclass(frozen=True)
class Scenario:
    """Board, targets and start cells of N robots, as drawn in Fig. 5.

    >>> import minirobots as mr
    >>> mr.Scenario("near", "one robot", targets=[(15, 15)], starts=[[(5, 15), (25, 15)]]).robots
    1

    Attributes:
        targets: target cell of each robot, length N.
        starts: start cells of each robot, N tuples of cells.
        cell_m: edge of a cell in m (assumed: 1 cm, so that a target "occupies a single cell").
        zone: central zone as (first column, first row, last column, last row), inclusive
            (7 x 7 cells, Section V).
        zone_is_obstacle: whether no robot's centre may enter the zone, except its own target
            (assumed: no, the zone only places targets).
        obstacles: cells that no robot may touch (none in the paper).
        robot_diameter_m: diameter of every robot, on the grid and in the dynamics; None for the
            machine's, which is that of Table I on the grid alone.
    """

    name: str
    title: str
    targets: tuple[Cell, ...]
    starts: tuple[tuple[Cell, ...], ...]
    columns: Side = 30
    rows: Side = 30
    cell_m: Annotated[float, Meta(gt=0.0, le=1.0)] = 0.01
    zone: Rectangle = (12, 12, 18, 18)
    obstacles: tuple[Cell, ...] = ()
    robot_diameter_m: float | None = None
    zone_is_obstacle: bool = False

    def __post_init__(self) -> None:
        validate_fields(self, f"scenario {self.name}: ")
        self._check_sizes()
        if len(self.targets) != len(self.starts) or not 1 <= self.robots <= MAX_ROBOTS:
            raise UserError(
                f"scenario {self.name}: targets and starts need one entry per robot, of 1 to "
                f"{MAX_ROBOTS}, got {len(self.targets)} and {len(self.starts)}"
            )
        fields = {"targets": self.targets, "obstacles": self.obstacles} | {
            f"starts[{robot}]": cells for robot, cells in enumerate(self.starts)
        }
        for field, cells in fields.items():
            for x, y in cells:
                if not (0 <= x < self.columns and 0 <= y < self.rows):
                    raise UserError(
                        f"scenario {self.name}: {field} has cell ({x}, {y}), which is off the "
                        f"{self.columns} x {self.rows} board; use 0 to {self.columns - 1} and "
                        f"0 to {self.rows - 1}"
                    )
            if not cells and field.startswith("starts"):
                raise UserError(f"scenario {self.name}: {field} is empty; give a start cell")
        self._check_obstacles(fields)
        if touching := touching_pair(self.targets, self.squared_contact):
            j, i = touching
            a, b = self.targets[i], self.targets[j]
            raise UserError(
                f"scenario {self.name}: targets {b} and {a} of robots {j + 1} and {i + 1} "
                f"are {100 * math.dist(a, b) * self.cell_m:.1f} cm apart; robots of "
                f"{100 * self.diameter_m:.1f} cm do not both fit there; move them "
                "further apart"
            )

    def _check_sizes(self) -> None:
        left, bottom, right, top = self.zone
        most_m = MAX_SIDE_CELLS * self.cell_m
        on_board = 0 <= left <= right < self.columns and 0 <= bottom <= top < self.rows
        for field, valid, value, expected in (
            ("name", re.fullmatch(r"[\w.-]+", self.name), self.name, "letters, digits and . - _"),
            ("robot_diameter_m", 0 < self.diameter_m <= most_m, self.diameter_m,
             f"a length in m up to that of {MAX_SIDE_CELLS} cells"),
            ("zone", on_board, self.zone,
             "[first column, first row, last column, last row] on the board"),
        ):  # fmt: skip
            if not valid:
                raise UserError(
                    f"scenario {self.name}: {field} = {value} is not usable; give {expected}"
                )

    def _check_obstacles(self, fields: dict[str, tuple[Cell, ...]]) -> None:
        if len(self.walls) > MAX_WALLS:
            raise UserError(
                f"scenario {self.name}: obstacles make {len(self.walls)} rectangles, more than "
                f"{MAX_WALLS}; join or leave out some"
            )
        walls = 2 * self.walls
        for field, cells in fields.items() if len(walls) else ():
            x, y = 2 * np.array(cells).reshape(-1, 2).T + 1
            touching = np.flatnonzero(touches_obstacle(x, y, self.squared_contact, walls))
            if field != "obstacles" and len(touching):
                raise UserError(
                    f"scenario {self.name}: {field} has cell {cells[touching[0]]}, where a robot "
                    f"of {100 * self.diameter_m:.1f} cm touches an obstacle; move one of them"
                )

    def require_free_starts(self) -> None:
        """Refuse starts in cells that no centre may enter, and on the robot's own target."""
        taken = {*self.targets, *self._closed}
        for robot, cells in enumerate(self.starts):
            for cell in cells:
                if cell in taken:
                    raise UserError(
                        f"scenario {self.name}: starts[{robot}] has cell {cell}, which is a target "
                        "or in the closed zone; choose a free cell"
                    )

    @property
    def diameter_m(self) -> float:
        """Diameter of every robot."""
        return TABLE_I.diameter_m if self.robot_diameter_m is None else self.robot_diameter_m

    @property
    def robots(self) -> int:
        """Number of robots N."""
        return len(self.targets)

    @property
    def squared_contact(self) -> int:
        """Largest squared distance in cells² of the cells of two robots that touch.

        Also the square of a robot's radius in half cells, in which centres and corners of cells
        have whole coordinates.
        """
        # 1e-9: robots of 7 cm on cells of 1 cm touch at 7 cells, whatever 0.07 / 0.01 rounds to
        return math.floor((self.diameter_m / self.cell_m) ** 2 + 1e-9)

    @property
    def walls(self) -> np.ndarray:
        """(M, 4) int64, the obstacles as few rectangles left, bottom, right, top, in cells."""
        return _rectangles(set(self.obstacles))

    @property
    def forbidden(self) -> np.ndarray:
        """(N, F, 4) float64, rectangles as of `walls` that each robot's centre may not enter.

        They are the other robots' targets: static obstacles of Section III-A, although nothing
        stands there. If `zone_is_obstacle`, the cells of the zone are forbidden too, except for the
        robot's own target. Rectangles are infinitely far where a robot has fewer.
        """
        return self._forbidden({*self.targets, *self._closed})

    @property
    def closed(self) -> np.ndarray:
        """(N, F, 4) float64, of `forbidden` those in the zone, if that is an obstacle."""
        return self._forbidden(self._closed)

    @property
    def parking(self) -> tuple[np.ndarray, np.ndarray]:
        """The rest of `forbidden`: each target once, in the order of columns, then rows.

        Returns:
            (N, 4) float64, rectangles as of `walls`, infinitely far for a target in `closed`; and
            (N,) int64, the robot that may enter each.
        """
        owners = np.array(sorted(range(self.robots), key=self.targets.__getitem__))
        corners = np.array(self.targets, dtype=np.float64)[owners]
        rectangles, closed = np.hstack([corners, corners + 1]), self._closed
        rectangles[[self.targets[owner] in closed for owner in owners]] = np.inf
        return rectangles, owners

    @property
    def _closed(self) -> set[Cell]:
        """Cells of the zone if it is an obstacle, else none."""
        left, bottom, right, top = self.zone
        columns, rows = range(left, right + 1), range(bottom, top + 1)
        return set(product(columns, rows)) if self.zone_is_obstacle else set()

    def _forbidden(self, cells: set[Cell]) -> np.ndarray:
        """(N, F, 4) rectangles of cells without each robot's own target, padded with infinity."""
        of_robots = [_rectangles(cells - {target}) for target in self.targets]
        padded = np.full((self.robots, max(map(len, of_robots)), 4), np.inf)
        for robot, rectangles in enumerate(of_robots):
            padded[robot, : len(rectangles)] = rectangles
        return padded

    def blocks(self, x: Any, y: Any) -> Any:
        """Return whether a robot at (x, y), in half cells, touches an obstacle; also arrays."""
        return touches_obstacle(x, y, self.squared_contact, 2 * self.walls)

    @property
    def size_m(self) -> tuple[float, float]:
        """Width and height of the board in m."""
        return self.columns * self.cell_m, self.rows * self.cell_m

    def centre_m(self, cell: Cell) -> tuple[float, float]:
        """Centre of a cell in the board's frame, in m."""
        return (cell[0] + 0.5) * self.cell_m, (cell[1] + 0.5) * self.cell_m

    def digest(self) -> str:
        """Hash (16 hex digits) of the geometry, without name and title."""
        geometry = asdict(self) | {"robot_diameter_m": self.diameter_m}
        del geometry["name"], geometry["title"]
        if not self.zone_is_obstacle:
            del geometry["zone_is_obstacle"]  # as before there was this field
        return digest_of(geometry)


def sides(columns: int, rows: int) -> dict[str, tuple[Cell, ...]]:
    """Cells along each side of a board, and along all of them."""
    cells = tuple((x, y) for y in range(rows) for x in range(columns))
    return {
        "top": tuple(c for c in cells if c[1] == rows - 1),
        "bottom": tuple(c for c in cells if c[1] == 0),
        "left": tuple(c for c in cells if c[0] == 0),
        "right": tuple(c for c in cells if c[0] == columns - 1),
        "border": tuple(c for c in cells if c[0] in {0, columns - 1} or c[1] in {0, rows - 1}),
    }


def filled(*rectangles: Rectangle) -> tuple[Cell, ...]:
    """Cells of rectangles, each once, in their order, row by row."""
    return tuple(
        dict.fromkeys(
            (x, y)
            for left, bottom, right, top in rectangles
            for y in range(bottom, top + 1)
            for x in range(left, right + 1)
        )
    )


def touching_pair(cells: Sequence[Cell], squared_contact: int) -> tuple[int, int] | None:
    """Indices of two of some cells, closer than contact, the least that there are; else None."""
    side = math.isqrt(squared_contact) + 1
    before: dict[Cell, list[int]] = {}
    for i, (x, y) in enumerate(cells):
        block = x // side, y // side
        around = [(block[0] + dx, block[1] + dy) for dx in (-1, 0, 1) for dy in (-1, 0, 1)]
        for j in sorted(k for near in around for k in before.get(near, ())):
            if (cells[j][0] - x) ** 2 + (cells[j][1] - y) ** 2 <= squared_contact:
                return j, i
        before.setdefault(block, []).append(i)
    return None


def _rectangles(cells: set[Cell]) -> np.ndarray:
    """Cells as few rectangles left, bottom, right, top, (M, 4) int64."""
    single = [[x, y, x + 1, y + 1] for x, y in cells]
    return np.array(_joined(_joined(single, 0), 1), dtype=np.int64).reshape(-1, 4)


def _joined(rectangles: list[list[int]], axis: int) -> list[list[int]]:
    """Rectangles left, bottom, right, top, those of one extent joined along x (0) or y (1)."""
    low, high, across = axis, axis + 2, slice(1 - axis, None, 2)
    joined: list[list[int]] = []
    for rectangle in sorted(rectangles, key=lambda r: (r[across], r[low])):
        last = joined[-1] if joined else None
        if last and last[across] == rectangle[across] and last[high] == rectangle[low]:
            last[high] = rectangle[high]
        else:
            joined.append(rectangle)
    return joined

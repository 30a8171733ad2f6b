"""Scenarios: a board of cells, one target and one set of start cells per robot.

A scenario is geometry only; how robots learn on it is the agent's, how they move the
co-simulation's. Cells are addressed (column, row) = (x, y) from the lower left corner; the board's
frame has its origin at that corner, x to the right, y up.
"""

import hashlib
import json
import math
from dataclasses import asdict, dataclass

from cosim.errors import UserError
from cosim.params import TABLE_I

Cell = tuple[int, int]


class ScenarioError(UserError):
    """A scenario that cannot be used; the message names the field and the mend."""


@dataclass(frozen=True)
class Scenario:
    """Board, targets and start cells of N robots, as drawn in Fig. 5.

    Attributes:
        name: what `--scenario` calls it.
        title: one line for people.
        targets: target cell of each robot, length N.
        starts: start cells of each robot, N tuples of cells.
        columns: board width in cells (30, Section V).
        rows: board height in cells (30, Section V).
        cell_m: edge of a cell in m (assumed: 1 cm, so that a target "occupies a single cell").
        zone: central zone as (first column, first row, last column, last row), inclusive
            (7 x 7 cells, Section V); it only places the targets (assumed).
        obstacles: cells that no robot may enter (none in the paper).
        robot_diameter_m: diameter of every robot (Table I).

    Raises:
        ScenarioError: a cell is off the board, or targets are closer than one diameter.
    """

    name: str
    title: str
    targets: tuple[Cell, ...]
    starts: tuple[tuple[Cell, ...], ...]
    columns: int = 30
    rows: int = 30
    cell_m: float = 0.01
    zone: tuple[int, int, int, int] = (12, 12, 18, 18)
    obstacles: tuple[Cell, ...] = ()
    robot_diameter_m: float = TABLE_I.diameter_m

    def __post_init__(self) -> None:
        if not self.targets or len(self.targets) != len(self.starts):
            raise ScenarioError(
                f"scenario {self.name}: targets and starts need one entry per robot, "
                f"got {len(self.targets)} and {len(self.starts)}"
            )
        fields = {"targets": self.targets, "obstacles": self.obstacles} | {
            f"starts[{robot}]": cells for robot, cells in enumerate(self.starts)
        }
        for field, cells in fields.items():
            for x, y in cells:
                if not (0 <= x < self.columns and 0 <= y < self.rows):
                    raise ScenarioError(
                        f"scenario {self.name}: {field} has cell ({x}, {y}), which is off the "
                        f"{self.columns} x {self.rows} board; use 0 to {self.columns - 1} and "
                        f"0 to {self.rows - 1}"
                    )
            if not cells and field.startswith("starts"):
                raise ScenarioError(f"scenario {self.name}: {field} is empty; give a start cell")
        for i, a in enumerate(self.targets):
            for j, b in enumerate(self.targets[:i]):
                if math.dist(a, b) * self.cell_m <= self.robot_diameter_m:
                    raise ScenarioError(
                        f"scenario {self.name}: targets {b} and {a} of robots {j + 1} and {i + 1} "
                        f"are {100 * math.dist(a, b) * self.cell_m:.1f} cm apart; robots of "
                        f"{100 * self.robot_diameter_m:.1f} cm cannot both park there: move them "
                        "further apart"
                    )

    @property
    def robots(self) -> int:
        """Number of robots N."""
        return len(self.targets)

    @property
    def size_m(self) -> tuple[float, float]:
        """Width and height of the board in m."""
        return self.columns * self.cell_m, self.rows * self.cell_m

    def centre_m(self, cell: Cell) -> tuple[float, float]:
        """Centre of a cell in the board's frame, in m."""
        return (cell[0] + 0.5) * self.cell_m, (cell[1] + 0.5) * self.cell_m

    def digest(self) -> str:
        """Hash (16 hex digits) of the geometry, whatever name and title are."""
        geometry = {k: v for k, v in asdict(self).items() if k not in {"name", "title"}}
        return hashlib.sha256(json.dumps(geometry, sort_keys=True).encode()).hexdigest()[:16]


_COLUMNS = _ROWS = 30
_TOP = tuple((x, _ROWS - 1) for x in range(_COLUMNS))
_BOTTOM = tuple((x, 0) for x in range(_COLUMNS))
_BORDER = tuple(
    (x, y)
    for y in range(_ROWS)
    for x in range(_COLUMNS)
    if x in {0, _COLUMNS - 1} or y in {0, _ROWS - 1}
)

# Fig. 5; target cells are a reading of the figure (assumed), see docs/decisions.md.
BUILT_IN: dict[str, Scenario] = {
    scenario.name: scenario
    for scenario in (
        Scenario("1a", "one robot from the upper side", ((15, 18),), (_TOP,)),
        Scenario("1b", "one robot from any border cell", ((15, 18),), (_BORDER,)),
        Scenario("2", "two robots, targets opposite", ((15, 18), (15, 12)), (_TOP, _BOTTOM)),
        Scenario("3", "two robots, targets beside", ((12, 15), (18, 15)), (_TOP, _BOTTOM)),
        Scenario("4", "two robots, targets swapped", ((15, 12), (15, 18)), (_TOP, _BOTTOM)),
    )
}


def find_scenario(name: str) -> Scenario:
    """Built-in scenario of that name (Fig. 5: 1a, 1b, 2, 3, 4).

    Raises:
        ScenarioError: there is no such scenario.
    """
    if name not in BUILT_IN:
        raise ScenarioError(f"unknown scenario '{name}'; choose one of {', '.join(BUILT_IN)}")
    return BUILT_IN[name]

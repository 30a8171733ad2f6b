"""Scenarios of the paper (Fig. 5), and those of this project."""

from cosim.scenarios.scenario import Cell, Scenario


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


_SIDES = sides(30, 30)
_TOP, _BOTTOM, _BORDER = _SIDES["top"], _SIDES["bottom"], _SIDES["border"]

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

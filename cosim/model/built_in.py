"""Scenarios of the paper (Fig. 5), and those of this project: obstacles, groups of robots."""

from dataclasses import replace

from cosim.model.scenario import Cell, Scenario
from cosim.model.world import Rectangle


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


_SIDES = sides(30, 30)
_TOP, _BOTTOM, _BORDER = _SIDES["top"], _SIDES["bottom"], _SIDES["border"]
_LEFT, _RIGHT = _SIDES["left"], _SIDES["right"]


def _named(*scenarios: Scenario) -> dict[str, Scenario]:
    return {scenario.name: scenario for scenario in scenarios}


# Fig. 5; target cells are read from the figure (assumed), see docs/paper.md.
PAPER = _named(
    Scenario("1a", "one robot from the upper side", ((15, 18),), (_TOP,)),
    Scenario("1b", "one robot from any border cell", ((15, 18),), (_BORDER,)),
    Scenario("2", "two robots, targets opposite", ((15, 18), (15, 12)), (_TOP, _BOTTOM)),
    Scenario("3", "two robots, targets beside", ((12, 15), (18, 15)), (_TOP, _BOTTOM)),
    Scenario("4", "two robots, targets swapped", ((15, 12), (15, 18)), (_TOP, _BOTTOM)),
)
# The same where "restricted zone" (Section V) means that robots may not enter it.
RESTRICTED = _named(
    *(
        replace(s, name=f"{s.name}-zone", title=f"{s.title}, zone forbidden", zone_is_obstacle=True)
        for s in PAPER.values()
    )
)
# Not the paper's: pairs among obstacles, see docs/scenarios.md.
AMONG_OBSTACLES = _named(
    Scenario(
        "5-corridor",
        "two robots that meet in a corridor of 14 cm",
        ((26, 15), (3, 15)),
        (_LEFT, _RIGHT),
        obstacles=filled((10, 0, 19, 7), (10, 22, 19, 29)),
    ),
    Scenario(
        "5-slalom",
        "two robots around two walls, past each of which 14 cm are free",
        ((25, 18), (28, 4)),
        (_LEFT, _LEFT),
        obstacles=filled((7, 0, 7, 15), (18, 14, 18, 29)),
    ),
    Scenario(
        "5-doorway",
        "two robots through one door of 10 cm",
        ((8, 6), (21, 6)),
        (_TOP, _TOP),
        obstacles=filled((0, 14, 9, 15), (20, 14, 29, 15)),
    ),
)
# Not the paper's either: groups, of four as in its sequel and of six, see docs/scenarios.md.
IN_GROUPS = _named(
    Scenario(
        "4-cross",
        "four robots, one from each side, whose targets are beyond the centre",
        ((15, 11), (15, 19), (19, 15), (11, 15)),
        (_TOP, _BOTTOM, _LEFT, _RIGHT),
    ),
    Scenario(
        "4-ring",
        "four robots from any border cell, targets around the zone",
        ((11, 11), (19, 11), (19, 19), (11, 19)),
        (_BORDER, _BORDER, _BORDER, _BORDER),
    ),
    Scenario(
        "6-swap",
        "three robots from the upper side and three from the lower one change sides",
        ((9, 9), (15, 9), (21, 9), (9, 21), (15, 21), (21, 21)),
        (_TOP[:10], _TOP[10:20], _TOP[20:], _BOTTOM[:10], _BOTTOM[10:20], _BOTTOM[20:]),
    ),
)
BUILT_IN = PAPER | RESTRICTED | AMONG_OBSTACLES | IN_GROUPS

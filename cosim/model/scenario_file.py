"""Scenario and world files (TOML), and scenarios found by name."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec

from cosim.base.arguments import validate_argument
from cosim.base.errors import UserError
from cosim.base.reading import Kind, naming, read_toml
from cosim.model.params import TABLE_I
from cosim.model.scenario import MAX_ROBOTS, MAX_SIDE_CELLS, Cell, Scenario, Side, filled, sides
from cosim.model.swarm import Swarm, lay_out
from cosim.model.world import IDEAL, Rectangle, World

ROUGH = Path(__file__).parent / "worlds" / "rough.toml"  # a world in which nothing is ideal
MAX_CELLS = MAX_SIDE_CELLS**2  # of a list, before those that stand there twice are left out

_FOLDER = Path(__file__).parent / "scenarios"

# Built-in scenarios. Those of Fig. 5 have target cells that are read from the figure (assumed), see
# docs/paper.md; with "-zone" the "restricted zone" (Section V) is one that no robot may enter.
PAPER = ("1a", "1b", "2", "3", "4")
# Not the paper's, see docs/scenarios.md: pairs among obstacles, and groups of robots.
AMONG_OBSTACLES = ("5-corridor", "5-slalom", "5-doorway")
IN_GROUPS = ("4-cross", "4-ring", "6-swap")
RESTRICTED = tuple(f"{name}-zone" for name in PAPER)
BUILT_IN = PAPER + RESTRICTED + AMONG_OBSTACLES + IN_GROUPS
SWARMS = ("swarm-16", "swarm-64", "swarm-256", "swarm-1024")


@cache
def _built_in(name: str) -> Scenario:
    scenario, _ = _read(_FOLDER / f"{name.removesuffix('-zone')}.toml")
    if name in RESTRICTED:
        title = f"{scenario.title}, zone forbidden"
        return replace(scenario, name=name, title=title, zone_is_obstacle=True)
    return scenario


def find_scenario(name_or_path: str | Path | Scenario, *, ideal: bool = False) -> Scenario:
    """Built-in scenario of that name, or the one in a TOML file; a record is returned as it is.

    `ideal` refuses a world of its own, of which only obstacles would have an effect.
    """
    scenario, world = find_in_world(name_or_path)
    if ideal and msgspec.structs.replace(world, obstacles=()) != IDEAL:
        raise UserError(
            f"{name_or_path}: of its table [world] only obstacles have an effect here; leave the "
            "rest out"
        )
    return scenario


def find_in_world(
    scenario: str | Path | Scenario, world: str | Path | World | Mapping[str, Any] | None = None
) -> tuple[Scenario, World]:
    """A scenario with the obstacles of its world, by default its own, and that world."""
    name, own, declared = str(scenario), IDEAL, world
    if isinstance(declared, str | Path):
        declared = read_world(Path(declared))
    declared = validate_argument("world", declared, World | None)
    if isinstance(scenario, Scenario):
        pass
    elif name in (*BUILT_IN, *SWARMS):
        scenario = _built_in(name)
    elif name.endswith(".toml"):
        scenario, own = _read(Path(name))
    else:
        raise UserError(
            f"unknown scenario '{name}'; choose one of {', '.join((*BUILT_IN, *SWARMS))} "
            "or name a .toml file"
        )
    if declared is None:
        declared = own
    elif own != IDEAL:
        raise UserError(f"{name} has a world of its own in addition to {world}; remove one")
    return in_world(scenario, declared), declared


def in_world(scenario: Scenario, world: World) -> Scenario:
    """A scenario with the obstacles of a world too."""
    for patch in world.mu_patches:
        left, bottom, right, top = patch.cells
        if not (0 <= left <= right < scenario.columns and 0 <= bottom <= top < scenario.rows):
            raise UserError(
                f"world.mu_patches has {list(patch.cells)}, not a rectangle [first column, "
                f"first row, last column, last row] of the {scenario.columns} x {scenario.rows} "
                "board; give one on it"
            )
    more = _cells("world.obstacles", world.obstacles)
    obstacles = tuple(dict.fromkeys((*scenario.obstacles, *more)))
    return replace(scenario, obstacles=obstacles) if more else scenario


class _WorldFile(msgspec.Struct, forbid_unknown_fields=True):
    world: World


def read_world(path: Path) -> World:
    """Return the world of a file that has nothing else."""
    content = read_toml(path, Kind("world file", "check the path"))
    with naming(path):
        return validate_argument("", content, _WorldFile).world


_Index = Annotated[int, msgspec.Meta(ge=0, lt=MAX_SIDE_CELLS)]


class _RobotTable(msgspec.Struct, forbid_unknown_fields=True):
    target: Cell
    starts: Literal["top", "bottom", "left", "right", "border"] | list[list[_Index]]


class _ScenarioFile(msgspec.Struct, forbid_unknown_fields=True):
    robots: Annotated[list[_RobotTable], msgspec.Meta(max_length=MAX_ROBOTS)] = []
    swarm: Swarm | None = None
    name: str | None = None
    title: str = ""
    columns: Side | None = None
    rows: Side | None = None
    cell_m: float = 0.01
    zone: Rectangle | None = None
    zone_is_obstacle: bool = False
    obstacles: list[list[_Index]] = []
    robot_diameter_m: float | None = None
    world: World = IDEAL


def _read(path: Path) -> tuple[Scenario, World]:
    """Scenario and world of a TOML file, see docs/scenarios.md for its fields.

    Start cells are a side of the board or a list, obstacles a list; a list has cells `[x, y]` and
    rectangles `[first column, first row, last column, last row]`. The zone is by default the
    7 x 7 cells in the middle, as in Section V.
    """
    content = read_toml(path, Kind("scenario file", "check the path"))
    with naming(path):
        file = validate_argument("", content, _ScenarioFile)
        if (file.swarm is None) == (not file.robots):
            raise UserError("robots: give a table [[robots]] for each robot, or one table [swarm]")
        if file.swarm is None:
            board = _board_of(file)
        else:
            diameter_m = file.robot_diameter_m or TABLE_I.diameter_m
            cells = diameter_m / file.cell_m if file.cell_m > 0.0 else math.inf
            cells = cells if 0.0 < cells < math.inf else 0.0  # refused by the scenario
            board = lay_out(file.swarm, cells, file.columns, file.rows, path.parent)
        scenario = Scenario(
            name=file.name or path.stem,
            title=file.title or path.name,
            **board,
            cell_m=file.cell_m,
            zone=file.zone or _central_zone(board["columns"], board["rows"]),
            obstacles=_cells("obstacles", file.obstacles),
            robot_diameter_m=file.robot_diameter_m,
            zone_is_obstacle=file.zone_is_obstacle,
        )
    return scenario, file.world


def _board_of(file: _ScenarioFile) -> dict[str, Any]:
    """Return columns, rows, targets and starts of robots that a file has one by one, by name."""
    columns, rows = file.columns or 30, file.rows or 30
    by_side = sides(columns, rows)
    starts = tuple(
        by_side[robot.starts]
        if isinstance(robot.starts, str)
        else _cells(f"robots[{i}].starts", robot.starts)
        for i, robot in enumerate(file.robots)
    )
    targets = tuple(robot.target for robot in file.robots)
    return {"columns": columns, "rows": rows, "targets": targets, "starts": starts}


def _cells(field: str, items: Sequence[Sequence[int]]) -> tuple[Cell, ...]:
    rectangles: list[Rectangle] = []
    for k, item in enumerate(items):
        left, bottom, right, top = (*item, *item)[:4] if len(item) in {2, 4} else (1, 1, 0, 0)
        if left > right or bottom > top:
            raise UserError(
                f"{field}[{k}]: {item} is neither a cell [x, y] nor a rectangle "
                "[first column, first row, last column, last row]"
            )
        rectangles.append((left, bottom, right, top))
    cells = sum((r[2] - r[0] + 1) * (r[3] - r[1] + 1) for r in rectangles)
    if cells > MAX_CELLS:
        raise UserError(f"{field} lists {cells} cells, more than {MAX_CELLS}; leave out some")
    return filled(*rectangles)


def _central_zone(columns: int, rows: int) -> Rectangle:
    width, height = min(7, columns), min(7, rows)
    left, bottom = (columns - width + 1) // 2, (rows - height + 1) // 2
    return left, bottom, left + width - 1, bottom + height - 1

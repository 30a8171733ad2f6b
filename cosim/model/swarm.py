"""Swarms: scenarios of many robots, by their number, spacing and formation.

Robots begin near the points of a square lattice, each anywhere within so little of its point that
no two can touch. Density does not depend on their number, so neither does what a robot meets.
"""

import math
from pathlib import Path
from typing import Annotated, Any

import msgspec
import numpy as np

from cosim.base.errors import UserError
from cosim.base.reading import Kind, parsing, read_bytes
from cosim.model.scenario import MAX_ROBOTS, MAX_SIDE_CELLS, Cell, Side, filled

FORMATIONS = ("swap", "across", "square")
_TARGETS = Kind("file of target cells", "write a line `column,row` for each robot")


class Swarm(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The table `[swarm]` of a scenario file."""

    robots: Annotated[int, msgspec.Meta(ge=1, le=MAX_ROBOTS)]
    spacing: Side = 12  # cells between neighbouring points of the lattice
    # "swap" (robots 1 and 2, 3 and 4 and so on of a row change places, and each ends just above
    # those where one began), "across" (all move to the same lattice in the right half of the
    # board), "square" (to a dense one there), a list of cells, or a file (.csv) with a line
    # `column,row` for each robot
    targets: str | list[Cell] = "swap"


def lay_out(
    swarm: Swarm,
    diameter_cells: float,
    columns: int | None = None,
    rows: int | None = None,
    folder: Path = Path(),
) -> dict[str, Any]:
    """Return columns, rows, targets and starts of a swarm's `Scenario`, by name.

    The board is by default as large as the swarm needs; a file of targets is in `folder`.
    """
    count, spacing = swarm.robots, swarm.spacing
    least = math.floor(diameter_cells + 1e-9) + 1  # at which robots do not touch
    side = math.isqrt(count - 1) + 1
    if spacing < least:
        raise UserError(
            f"swarm.spacing = {spacing} lets robots of {diameter_cells:.3g} cells touch; give more"
        )
    across = swarm.targets in ("across", "square")
    # Between the halves there is an aisle.
    width, height = (2 * side + 1 if across else side) * spacing, -(-count // side) * spacing
    # By default there is half a spacing more on every side, to pass each other there as well.
    columns, rows = columns or width + spacing, rows or height + spacing
    for field, size, needed in (("columns", columns, width), ("rows", rows, height)):
        if not needed <= size <= MAX_SIDE_CELLS:
            raise UserError(
                f"{field} = {size}: {count} robots with swarm.spacing = {spacing} need {needed} "
                f"cells, and boards have up to {MAX_SIDE_CELLS}; change one of these"
            )
    place, around = np.arange(count), (spacing - least) // 2
    column = place % side
    corner = np.array([(columns - width) // 2, (rows - height) // 2]) + spacing // 2
    points = corner + spacing * np.column_stack([column, place // side])
    if swarm.targets == "swap":
        partner = place - column + (column ^ 1)
        alone = (column ^ 1 >= side) | (partner >= count)
        targets = points[np.where(alone, place, partner)] + np.array([0, around + 1])
    elif across:
        pitch = spacing if swarm.targets == "across" else least + 1
        middle = (spacing - pitch) * (side - 1) // 2 + np.array([(side + 1) * spacing, 0])
        targets = points[0] + middle + (points - points[0]) // spacing * pitch
    elif isinstance(swarm.targets, str):
        targets = _read_targets(swarm.targets, folder)
    else:
        targets = np.array(swarm.targets).reshape(-1, 2)
    if len(targets) != count:
        raise UserError(
            f"swarm.targets has {len(targets)} cells for {count} robots; give one for each"
        )
    boxes = np.hstack([points - around, points + around]).clip(0).tolist()
    starts = tuple(filled((left, bottom, right, top)) for left, bottom, right, top in boxes)
    cells = tuple((x, y) for x, y in targets.tolist())
    return {"columns": columns, "rows": rows, "targets": cells, "starts": starts}


def _read_targets(name: str, folder: Path) -> np.ndarray:
    """(M, 2) cells of a file."""
    if not name.endswith(".csv"):
        raise UserError(
            f"swarm.targets = '{name}' is unknown; choose one of {', '.join(FORMATIONS)}, "
            "a list of cells, or a .csv file"
        )
    text = read_bytes(folder / name, _TARGETS).decode("utf-8-sig", errors="replace")
    cells: list[tuple[int, int]] = []
    for number, line in enumerate(text.splitlines(), start=1):
        with parsing(folder / name, _TARGETS):
            if line.strip():
                parts = tuple(int(part) for part in line.split(","))
                if len(parts) != 2:
                    raise ValueError(f"line {number} has {len(parts)} numbers")
                cells.append(parts)
    return np.array(cells).reshape(-1, 2)

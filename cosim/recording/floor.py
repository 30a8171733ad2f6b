"""What a policy says of each cell, drawn on the floor of the arena: values and greedy directions.

How the maps come out of a robot's table is the agent's; here they are colours, tiles and arrows.
"""

import numpy as np
import rerun as rr
from matplotlib import colormaps

from cosim.base.scenario import Scenario
from cosim.navigation.features import DIRECTIONS
from cosim.recording.file import Recording
from cosim.recording.policy_map import PolicyMap

_TILE_HEIGHT_M = -0.0004  # under the lines between cells, above nothing
_ARROW_HEIGHT_M = 0.0008
_ARROW_CELLS = 0.7
_INK = np.array([0x222222FF], dtype=np.uint32)


def map_colours(values: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Colours (columns, rows, 3) uint8 from the least to the greatest known value; black else."""
    low, high = (values[known].min(), values[known].max()) if known.any() else (0.0, 1.0)
    scaled = (values - low) / max(high - low, 1e-12)
    colours = colormaps["viridis"](scaled, bytes=True)[..., :3]
    colours[~known] = 0
    return colours


def unit_arrows(action: np.ndarray) -> np.ndarray:
    """Directions as unit vectors (..., 2), x to the right and y up."""
    steps = DIRECTIONS[action].astype(np.float64)
    return steps / np.linalg.norm(steps, axis=-1, keepdims=True)


def write_floor(file: Recording, name: str, scenario: Scenario, policy: PolicyMap) -> None:
    """Log a robot's policy at `/world/<name>/policy`: a tile and an arrow per cell it visited.

    Args:
        file: recording being written.
        name: of the robot.
        scenario: the board.
        policy: maps of the board's cells.
    """
    known = policy.visits > 0
    cells = np.argwhere(known)
    corners = np.array([(0, 0), (1, 0), (1, 1), (0, 1)])
    tiles = (cells[:, None] + corners).reshape(-1, 2) * scenario.cell_m
    first = 4 * np.arange(len(cells))[:, None, None]
    colours = map_colours(policy.value, known)[known].repeat(len(corners), axis=0)
    file.static(
        f"/world/{name}/policy/value",
        rr.Mesh3D(
            vertex_positions=np.column_stack([tiles, np.full(len(tiles), _TILE_HEIGHT_M)]),
            triangle_indices=(first + np.array([(0, 1, 2), (0, 2, 3)])).reshape(-1, 3),
            vertex_colors=colours,
        ),
    )
    vectors = _ARROW_CELLS * scenario.cell_m * unit_arrows(policy.action[known])
    origins = (cells + 0.5) * scenario.cell_m - vectors / 2.0
    file.static(
        f"/world/{name}/policy/greedy",
        rr.Arrows3D(
            origins=np.column_stack([origins, np.full(len(cells), _ARROW_HEIGHT_M)]),
            vectors=np.column_stack([vectors, np.zeros(len(cells))]),
            colors=_INK,
            radii=0.0003,
        ),
    )

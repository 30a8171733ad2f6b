"""Pictures of boards: text, or an array of pixels."""

from typing import Literal

import numpy as np

from cosim.model.scenario import Scenario

PIXELS_PER_CELL = 12
RenderMode = Literal["ansi", "rgb_array"]
# Colour-blind safe colours of robots and their targets (Okabe and Ito), used in turn.
ROBOT_COLOURS = np.array(
    [(0, 114, 178), (213, 94, 0), (0, 158, 115), (204, 121, 167), (230, 159, 0), (86, 180, 233)],
    dtype=np.uint8,
)
_BOARD, _GRID, _ZONE, _OBSTACLE = 255, 238, 222, 90


def picture(mode: str, scenario: Scenario, positions_m: np.ndarray) -> str | np.ndarray:
    """Return the board as the text or the pixels of a render mode, with robots at (N, 2) m."""
    return (board_text if mode == "ansi" else board_pixels)(scenario, positions_m)


def board_text(scenario: Scenario, positions_m: np.ndarray) -> str:
    """Return the board, top row first: robots 1, 2, …; targets a, b, …; obstacles #; zone ':'."""
    cells = np.full((scenario.columns, scenario.rows), ".")
    left, bottom, right, top = scenario.zone
    cells[left : right + 1, bottom : top + 1] = ":"
    for x, y in scenario.obstacles:
        cells[x, y] = "#"
    for robot, (x, y) in enumerate(scenario.targets):
        cells[x, y] = chr(ord("a") + robot % 26)
    limits = (scenario.columns - 1, scenario.rows - 1)
    for robot, position in enumerate(positions_m):
        x, y = np.clip((position / scenario.cell_m).astype(int), 0, limits)
        cells[x, y] = str((robot + 1) % 10)
    return "\n".join("".join(row) for row in cells.T[::-1]) + "\n"


def board_pixels(scenario: Scenario, positions_m: np.ndarray) -> np.ndarray:
    """Return (rows · 12, columns · 12, 3) uint8: robots as discs, targets as squares."""
    scale = PIXELS_PER_CELL
    picture = np.full((scenario.columns * scale, scenario.rows * scale, 3), _BOARD, dtype=np.uint8)
    picture[::scale] = picture[:, ::scale] = _GRID
    left, bottom, right, top = scenario.zone
    picture[left * scale : (right + 1) * scale, bottom * scale : (top + 1) * scale] = _ZONE
    for x, y in scenario.obstacles:
        picture[x * scale : (x + 1) * scale, y * scale : (y + 1) * scale] = _OBSTACLE
    for robot, (x, y) in enumerate(scenario.targets):
        colour = ROBOT_COLOURS[robot % len(ROBOT_COLOURS)]
        picture[x * scale : (x + 1) * scale, y * scale : (y + 1) * scale] = colour
    centres = (np.indices(picture.shape[:2]) + 0.5) * scenario.cell_m / scale
    for robot, position in enumerate(positions_m):
        squared = ((centres - position[:, None, None]) ** 2).sum(axis=0)
        disc = squared <= (scenario.diameter_m / 2.0) ** 2
        colour = ROBOT_COLOURS[robot % len(ROBOT_COLOURS)]
        picture[disc] = picture[disc] // 2 + colour // 2
    return np.ascontiguousarray(picture.transpose(1, 0, 2)[::-1])

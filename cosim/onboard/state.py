"""Arrays that robots decide by: what each knows, and the floor under them; no behaviour.

Robot r of episode e of N robots each has row e N + r of B, of K episodes; float64 unless said
otherwise. Annotations give the shape, see `cosim.coupling.signals`.
"""

from typing import Annotated, NamedTuple

import numpy as np

from cosim.onboard.camera import CAMERA_SIZE, FRAME_SIZE, NOISE
from cosim.onboard.estimation import ESTIMATE_SIZE
from cosim.onboard.steering import COMMAND_SIZE
from cosim.physics.neighbours import LISTS

# Layout of what the shield knows of one robot.
PARKED = 0  # 1.0: it has arrived, and does not retreat
REFERENCE = 1  # room when its retreat began, without the error of estimates, m
FAILURES = 2  # retreats given up since it had room
STOPS = 3  # moves and retreats that the shield has ended
SHIELD_SIZE = 4


class Onboard(NamedTuple):
    """What robots know and want."""

    # Where robots think they are, layout in cosim.onboard.estimation
    estimates: Annotated[np.ndarray, "B", ESTIMATE_SIZE]
    cameras: Annotated[np.ndarray, "B", CAMERA_SIZE]  # layout in cosim.onboard.camera
    frames: Annotated[np.ndarray, "B", 0, FRAME_SIZE]  # of the camera, under way
    sight: Annotated[np.ndarray, 0, "B", NOISE]  # what the camera makes of robots in next frames
    commands: Annotated[np.ndarray, "B", COMMAND_SIZE]  # layout in cosim.onboard.steering
    shields: Annotated[np.ndarray, "B", SHIELD_SIZE]
    # near_robots, near_targets, near_zone: room for `cosim.physics.neighbours`
    near_robots: Annotated[np.ndarray, LISTS, "B", np.int64]
    near_targets: Annotated[np.ndarray, LISTS, "B", np.int64]
    near_zone: Annotated[np.ndarray, LISTS, "B", np.int64]


class Floor(NamedTuple):
    """Boards of the episodes; rectangles left, bottom, right, top in m.

    They are infinitely far where there are fewer than room is for.
    """

    boards: Annotated[np.ndarray, "K", 2]  # extent in m, its corner at the origin
    margins_m: Annotated[np.ndarray, "K"]  # from the edge, within which feet would be beyond it
    cells_m: Annotated[np.ndarray, "K"]  # edge of the cells
    obstacles: Annotated[np.ndarray, "K", 0, 4]
    forbidden: Annotated[np.ndarray, "B", 0, 4]  # which each robot's centre may not enter
    # Which no robot's centre may enter but one's, in an order of each episode's own; and the
    # columns of those robots
    targets: Annotated[np.ndarray, "B", 4]
    owners: Annotated[np.ndarray, "B", np.int64]
    # Rectangles and their friction coefficients; later ones cover earlier ones
    patches: Annotated[np.ndarray, "K", 0, 5]

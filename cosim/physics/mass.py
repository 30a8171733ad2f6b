"""Mass, centre and inertia of a robot with its payload; no kernels.

The payload is a point mass at the height of the robot's centre of mass. The common centre of mass
is (x, y) from the robot's axis; only the equations of motion know it.
"""

from typing import NamedTuple

import numpy as np

from cosim.model.params import RobotParams, cylinder_inertia
from cosim.model.world import IDEAL, World
from cosim.physics.rotation import Vector


class Mass(NamedTuple):
    """Mass properties of a robot's equations of motion; body frame."""

    total: float  # in kg
    centre: tuple[float, float]  # x and y of the common centre of mass from the robot's axis in m
    # inertia, inverse_inertia: moments about it in kg m², and the diagonal of the inverse tensor
    inertia: Vector
    inverse_inertia: Vector
    # product, inverse_product: elements xy of both tensors; the others are zero
    product: float
    inverse_product: float

    def inverse_tensor(self) -> np.ndarray:
        """Inverse of the inertia tensor, shape (3, 3), 1/(kg m²)."""
        tensor = np.diag(self.inverse_inertia)
        tensor[0, 1] = tensor[1, 0] = self.inverse_product
        return tensor


def mass_of(robot: RobotParams, world: World = IDEAL) -> Mass:
    """Mass of a uniform cylinder with the payload of a world, by the parallel axes theorem.

    The cylinder's moments are taken about its own centre of mass, which may be off the axis.
    """
    payload = 1e-3 * world.payload_g
    x, y = (1e-3 * offset for offset in world.payload_offset_mm)
    x, y = x - robot.com_x_m, y - robot.com_y_m  # from the cylinder's centre of mass
    total = robot.mass_kg + payload
    reduced = payload * robot.mass_kg / total
    i_xx, i_yy, i_zz = cylinder_inertia(robot)
    i_xx, i_yy = i_xx + reduced * y * y, i_yy + reduced * x * x
    i_zz += reduced * (x * x + y * y)
    against = reduced * x * y  # minus the element xy
    return Mass(
        total=total,
        centre=(robot.com_x_m + payload / total * x, robot.com_y_m + payload / total * y),
        inertia=(i_xx, i_yy, i_zz),
        inverse_inertia=(
            1.0 / (i_xx - against * against / i_yy),
            1.0 / (i_yy - against * against / i_xx),
            1.0 / i_zz,
        ),
        product=-against,
        inverse_product=against / (i_xx * i_yy - against * against),
    )

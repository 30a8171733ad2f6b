"""What an episode draws: numbers of children of its seed, and the values of its world.

Uniform numbers only, which have the same bits on every machine, and what is made of them.
"""

from collections.abc import Sequence

import msgspec
import numpy as np

from cosim.model.params import MotorParams, motor_names
from cosim.model.world import World
from cosim.physics.trig import normals

# Limit of drawn factors, in standard deviations from 1.
_MOST_DEVIATIONS = 3.0
# Children of an episode's seed: motors' noise has the first ones.
_WORLD_CHILD, CAMERA_CHILD = 1_000_000, 2_000_000  # of the camera's noise, the first robot's
DETOUR_CHILD = 3_000_000


class Drawn(msgspec.Struct, frozen=True):
    """Values that an episode has drawn from its world."""

    motors: tuple[tuple[MotorParams, ...], ...]  # of every robot, with their own K_T, R, J and r
    tilt_direction_deg: float  # where the floor falls, counter-clockwise from +x

    def table(self) -> dict[str, dict[str, float]]:
        """Return what summaries list: K_T, R, J and r of every motor, and the slope."""
        return {
            f"r{robot + 1}.{name}": {key: getattr(motor, key) for key in ("K_T", "R", "J", "r")}
            for robot, motors in enumerate(self.motors)
            for name, motor in zip(motor_names(len(motors)), motors, strict=True)
        } | {"floor": {"tilt_direction_deg": self.tilt_direction_deg}}


def generator(seed: np.random.SeedSequence, child: int) -> np.random.Generator:
    """Generator of a child of a seed; the seed stays as it is, unlike with `seed.spawn`."""
    return np.random.default_rng(
        np.random.SeedSequence(seed.entropy, spawn_key=(*seed.spawn_key, child))
    )


def draw_world(
    world: World, motors: Sequence[MotorParams], robots: int, seed: np.random.SeedSequence
) -> Drawn:
    """Draw the values of an episode, of robots with some motors each."""
    rng = generator(seed, _WORLD_CHILD)
    normal = normals(rng.random((robots, len(motors), 4)))
    factors = 1.0 + (world.motor_spread or 0.0) * np.clip(
        normal, -_MOST_DEVIATIONS, _MOST_DEVIATIONS
    )
    direction_deg = round(360.0 * rng.random(), 6) if world.floor_tilt_deg else 0.0

    def own(motor: MotorParams, row: np.ndarray) -> MotorParams:
        if not world.motor_spread:
            return motor
        k_t, r, j, mr = row.tolist()
        return motor._replace(K_T=motor.K_T * k_t, R=motor.R * r, J=motor.J * j, r=motor.r * mr)

    drawn = (tuple(map(own, motors, rows)) for rows in factors)
    return Drawn(tuple(drawn), direction_deg)

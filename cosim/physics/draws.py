"""What an episode draws: numbers of children of its seed, and the values of its world.

Uniform numbers only, which have the same bits on every machine, and what is made of them.
"""

from collections.abc import Sequence

import msgspec
import numpy as np

from cosim.base.jit import kernel
from cosim.model.params import MotorParams, motor_names
from cosim.model.world import World
from cosim.physics.trig import make_normal

# Limit of drawn factors, in standard deviations from 1.
_MOST_DEVIATIONS = 3.0
# Children of an episode's seed: motors' noise has the first ones.
WORLD_CHILD, CAMERA_CHILD = 1_000_000, 2_000_000  # of the camera's noise, the first robot's
DETOUR_CHILD = 3_000_000
VARIED = 4  # parameters of a motor that differ: K_T, R, J and r


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


@kernel
def make_factors(uniforms: np.ndarray, spread: float) -> None:
    """Make factors of motors' parameters of an even number of uniform ones in [0, 1), in place."""
    make_normal(uniforms)
    for k in range(len(uniforms)):
        limited = min(max(uniforms[k], -_MOST_DEVIATIONS), _MOST_DEVIATIONS)
        uniforms[k] = 1.0 + spread * limited


@kernel
def direction_of(uniform: float) -> float:
    """Return the direction in deg in which the floor falls, six decimals of it."""
    return np.rint(360.0e6 * uniform) / 1.0e6


def generator(seed: np.random.SeedSequence, child: int) -> np.random.Generator:
    """Generator of a child of a seed; the seed stays as it is, unlike with `seed.spawn`."""
    return np.random.default_rng(
        np.random.SeedSequence(seed.entropy, spawn_key=(*seed.spawn_key, child))
    )


def draw_world(
    world: World, motors: Sequence[MotorParams], robots: int, seed: np.random.SeedSequence
) -> Drawn:
    """Draw the values of an episode, of robots with some motors each."""
    rng = generator(seed, WORLD_CHILD)
    factors = rng.random(robots * len(motors) * VARIED)
    make_factors(factors, world.motor_spread or 0.0)
    factors = factors.reshape(robots, len(motors), VARIED)
    direction_deg = direction_of(rng.random()) if world.floor_tilt_deg else 0.0

    def own(motor: MotorParams, row: np.ndarray) -> MotorParams:
        if not world.motor_spread:
            return motor
        k_t, r, j, mr = row.tolist()
        return motor._replace(K_T=motor.K_T * k_t, R=motor.R * r, J=motor.J * j, r=motor.r * mr)

    drawn = (tuple(map(own, motors, rows)) for rows in factors)
    return Drawn(tuple(drawn), direction_deg)

"""A co-simulation's parts made from its parameters: plant, motors, speed noise.

What episodes on a board and trials of single robots have in common; nothing here advances time.
"""

import math

import numpy as np

from cosim.base.config import CoSimConfig
from cosim.base.params import TABLE_II
from cosim.coupling.fmu import Motor, MotorFmu
from cosim.coupling.interface import check_use
from cosim.coupling.plant import Plant
from cosim.physics.body import body_params
from cosim.physics.collision import PairParams
from cosim.physics.forces import motor_mounts

MOTOR_NAMES = ("D", "E")


def new_plant(config: CoSimConfig, size_m: tuple[float, float], *, end_on_collision: bool) -> Plant:
    """Constants of the coupled system on a board of the given extent, its corner at the origin."""
    return Plant(
        body_params(config.robot, config.motor, config.timing.dt_s),
        *motor_mounts(config.robot, config.motor),
        config.steering,
        PairParams(config.robot.diameter_m, config.robot.mu_robots),
        end_on_collision,
        *size_m,
        config.ticks_per_period,
        config.ticks_per_step,
        config.order == "jacobi",
        config.reaction,
        config.timing.exchange_tolerance_rad,
    )


def check_motors(
    fmu: MotorFmu, config: CoSimConfig, robots: int, *, adaptive: bool = False
) -> None:
    """Refuse an FMU that cannot do what a run asks of it.

    Args:
        fmu: of every motor.
        config: all parameters.
        robots: their number.
        adaptive: whether communication steps vary, from dt upwards, and are taken back.

    Raises:
        FmuError: it lacks a capability.
        ConfigError: its internal step does not divide the communication step.
    """
    timing = config.timing
    least_step_s = timing.dt_s if adaptive else timing.communication_step_s
    motors = robots * len(MOTOR_NAMES)
    check_use(fmu.path, fmu.interface, motors, least_step_s, adaptive=adaptive)


def new_motors(fmu: MotorFmu, config: CoSimConfig, robots: int) -> list[Motor]:
    """FMU instances of all robots, D before E, with the parameters that differ from Table II.

    Raises:
        FmuError: the FMU refuses to load, a parameter, or initialisation.
    """
    parameters = {
        name: value
        for name, value in config.motor._asdict().items()
        if value != getattr(TABLE_II, name)
    }
    names = [f"r{robot + 1}.{motor}" for robot in range(robots) for motor in MOTOR_NAMES]
    return [fmu.instantiate(name, parameters) for name in names]


def noise_generators(seed: np.random.SeedSequence, robots: int) -> list[np.random.Generator]:
    """One generator of speed noise for every motor, each with a child of the seed."""
    return [np.random.default_rng(child) for child in seed.spawn(robots * len(MOTOR_NAMES))]


def draw_noise(
    config: CoSimConfig,
    generators: list[np.random.Generator],
    nominal_rad_s: np.ndarray | float,
    periods: int,
) -> np.ndarray:
    """Speed noise of N robots (Section V), shape (periods, N, 2), rad/s.

    Args:
        config: amplitude, and time for which a value holds.
        generators: 2 N, see `noise_generators`; each is drawn from.
        nominal_rad_s: nominal motor speed, of all or (N,) of each robot.
        periods: control periods.
    """
    hold = config.periods_per_noise_value
    draws, motors = math.ceil(periods / hold), len(MOTOR_NAMES)
    values = np.empty((len(generators), draws))
    for generator, row in zip(generators, values, strict=True):
        generator.random(out=row)
    values *= 2.0
    values -= 1.0
    amplitude = config.noise.relative_amplitude * np.asarray(nominal_rad_s)
    noise = np.empty((draws, hold, len(generators) // motors, motors))
    np.multiply(values.T.reshape(draws, 1, -1, motors), amplitude.reshape(-1, 1), out=noise)
    return noise.reshape(-1, *noise.shape[2:])[:periods]

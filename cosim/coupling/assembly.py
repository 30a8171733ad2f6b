"""A co-simulation's parts made from its parameters: plant, motors, speed noise.

What episodes on a board and trials of single robots have in common; nothing here advances time.
"""

import math
from collections.abc import Sequence

import numpy as np

from cosim.base.jit import kernel
from cosim.coupling.plant import Plant
from cosim.fmi.motor import SAMPLED, MotorFmu
from cosim.model.config import CoSimConfig, whole_ratio
from cosim.model.params import (
    SHIELD,
    MotorParams,
    motors_of,
    open_loop_voltage,
)
from cosim.physics.collision import FASTEST_M_S, PairParams
from cosim.physics.draws import generator
from cosim.physics.feet import paired
from cosim.physics.forces import motor_mounts
from cosim.physics.properties import body_params, properties_of
from cosim.physics.rotation import Vector


def new_plant(
    config: CoSimConfig,
    robots: int,
    *,
    end_on_collision: bool,
    motors: Sequence[MotorParams] | None = None,
) -> Plant:
    """Constants of the coupled system for episodes of some robots each.

    Args:
        motors: of a robot, by default those of the configuration.
    """
    steering = config.steering
    if "heading" in config.open_loop:
        steering = steering._replace(max_difference_rad_s=0.0, turn_again_rad=math.inf)
    robot = config.robot
    each = motors or motors_of(robot, config.motor)
    mounts = motor_mounts(robot._replace(com_height_m=0.0), each)
    pairing = paired([mount.place_m[:2] for mount in robot.motors])
    return Plant(
        robots=robots,
        body=body_params(config.robot, config.motor, config.timing.dt_s),
        motors=pairing,
        mounts=tuple(mounts[k] for k in pairing.order),
        steering=steering,
        estimator=config.estimator,
        shield=config.shield or SHIELD,
        shielded=config.shield is not None,
        pair=PairParams(
            config.robot.diameter_m,
            config.robot.mu_robots,
            near=2.0 * FASTEST_M_S * config.timing.control_period_s,
        ),
        end_on_collision=end_on_collision,
        ticks_per_period=config.ticks_per_period,
        ticks_per_step=config.ticks_per_step,
        reaction=config.reaction,
        open_loop=config.voltage_driven,
        voltages=tuple(map(open_loop_voltage, each)),
    )


def robot_properties(
    config: CoSimConfig,
    gravity: Vector | None = None,
    motors: Sequence[MotorParams] | None = None,
) -> np.ndarray:
    """Return a robot's column of `Bodies.properties`; gravity (m/s²) in the frame of the floor."""
    robot, dt_s = config.robot, config.timing.dt_s
    motors = motors or motors_of(robot, config.motor)
    return properties_of(
        body_params(robot, config.motor, dt_s, gravity=gravity, world=config.world),
        motor_mounts(robot, motors),
    )


def check_motors(fmu: MotorFmu, config: CoSimConfig, robots: int) -> None:
    """Refuse an FMU without a capability that a run of some robots needs."""
    motors, can = robots * len(config.robot.motors), fmu.interface
    if motors > 1 and can.canBeInstantiatedOnlyOncePerProcess:
        raise fmu.refusal(
            f"has canBeInstantiatedOnlyOncePerProcess, and {motors} motors are needed at once; "
            "export it without"
        )
    if can.fixedInternalStepSize is not None:
        internal_s, name = float(can.fixedInternalStepSize), "fixedInternalStepSize"
        if not internal_s > 0.0:
            raise fmu.refusal(f"has {name} = {internal_s:g}; export it with a positive one")
        step_s = config.timing.communication_step_s
        whole_ratio("communication_step_s", step_s, f"{name} of motor FMU {fmu.path}", internal_s)


def why_not_fmpy(fmu: MotorFmu, config: CoSimConfig) -> str | None:
    """Return why motors cannot be stepped once per control period; None if they can."""
    if config.reaction:
        return "with --reaction motors and bodies act on each other in every communication step"
    if not fmu.samples:
        return f"motor FMU {fmu.path} has no {', '.join(SAMPLED)} for it"
    step_s, internal_s = config.timing.communication_step_s, fmu.internal_step_s or math.inf
    if step_s > internal_s and abs(math.remainder(step_s / internal_s, 1.0)) > 1e-6:
        return (
            f"its communication step {step_s:g} s is not a multiple of step_size = {internal_s:g} s"
        )
    return None


class SpeedNoise:
    """Speed noise of N robots over their motors' set points (Section V), drawn as time passes."""

    def __init__(self, config: CoSimConfig, seed: np.random.SeedSequence, robots: int) -> None:
        """Give every motor a generator with a child of the seed."""
        self._motors = len(config.robot.motors)
        children = range(robots * self._motors)
        self._generators = [generator(seed, child) for child in children]
        self.amplitude = config.noise.relative_amplitude
        self.hold = round(config.noise.hold_s / config.timing.control_period_s)
        self._values, self._left = np.zeros(len(children)), np.zeros(1, dtype=np.int64)

    def draw(self, periods: int) -> np.ndarray:
        """Return the noise of the next control periods, shape (periods, N, M)."""
        draws = max(0, math.ceil((periods - self._left[0]) / self.hold))
        uniforms = np.empty((len(self._values), draws))
        for rng, row in zip(self._generators, uniforms, strict=True):
            rng.random(out=row)
        noise = np.empty((periods, len(self._values) // self._motors, self._motors))
        write_noise(noise, uniforms, self.amplitude, self.hold, self._values, self._left)
        return noise


@kernel
def write_noise(
    noise: np.ndarray,
    uniforms: np.ndarray,
    amplitude: float,
    hold: int,
    values: np.ndarray,
    left: np.ndarray,
) -> None:
    """Write the speed noise of the next control periods.

    Args:
        noise: (periods, N or more, M).
        uniforms: (N M, draws) in [0, 1), as many as are needed.
        hold: control periods that a value lasts.
        values: (N M,) in force; updated.
        left: (1,) int64, control periods that they have left; updated.
    """
    periods, motors = noise.shape[0], noise.shape[2]
    rest = left[0]
    for k in range(len(values)):
        value, rest, drawn = values[k], left[0], 0
        for period in range(periods):
            if rest == 0:
                value, rest = (2.0 * uniforms[k, drawn] - 1.0) * amplitude, hold
                drawn += 1
            noise[period, k // motors, k % motors] = value
            rest -= 1
        values[k] = value
    left[0] = rest

"""How far robots go until they rest, measured: what the shield's margin rests on (docs/shield.md).

Robots drive every which way, motors at speeds up to the largest that the steering asks for, changed
at random times, and are stopped at random times.
"""

from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np

from cosim.base.config import CoSimConfig
from cosim.base.params import TIMING
from cosim.base.progress import Progress, silent, under_way
from cosim.base.provenance import digest_of
from cosim.base.reached_code import code_digest
from cosim.base.storage import cache_dir, cached, write_json
from cosim.base.world import World, draw_world, gravity
from cosim.calibration.speed_map import CalibrationError
from cosim.calibration.trial import Trial
from cosim.control.steering import DIRECT, HOLD, MODE, OMEGA_D, OMEGA_E
from cosim.coupling.fmu import MotorFmu

ROBOTS, TRIALS = 64, 4
RESERVE = 2.0  # assumed: over the largest of all that were measured
_LONGEST_S, _CHANGE_S, _REST_S = 1.5, 0.4, 0.3


def stopping_distances(
    config: CoSimConfig, fmu: MotorFmu, robots: int, seed: int
) -> tuple[np.ndarray, np.ndarray]:
    """How far robots come from where they were last seen before they were stopped.

    Args:
        config: machine, floor and steering; its world's motor spread and slope are drawn.
        fmu: of the motors.
        robots: how many.
        seed: of what they do, and of the noise.

    Returns:
        (N,) largest distance in m of each robot, from one control period before the stop on, and
        (N,) time in s after which it moved less than a micrometre.
    """
    rng, sequence = np.random.default_rng(seed), np.random.SeedSequence(seed)
    period_s, steering = config.timing.control_period_s, config.steering
    largest = steering.max_speed_rad_s + steering.dither_rad_s
    drawn = draw_world(config.world, config.motor, robots, sequence)
    slope = gravity(config.world, drawn, config.motor.g)
    headings = rng.uniform(-np.pi, np.pi, robots)
    kind = rng.integers(4, size=robots)[:, None]
    with Trial(fmu, config, headings, sequence, motors=drawn.motors, gravity=slope) as trial:
        trial.commands[:, MODE] = DIRECT
        left = round(rng.uniform(0.2, 1.0) * _LONGEST_S / period_s)
        before = trial.bodies[:2].copy()
        while left > 0:
            # Any two speeds; driving; turning; the largest speeds.
            speeds = rng.uniform(-largest, largest, (robots, 2))
            sign = rng.choice([-1.0, 1.0], (robots, 1))
            fast = sign * rng.uniform(0.7, 1.0, (robots, 1)) * largest
            choices = [fast * [-1.0, 1.0], fast * [1.0, 1.0], np.sign(speeds) * largest]
            for number, chosen in enumerate(choices, 1):
                speeds = np.where(kind == number, chosen, speeds)
            trial.commands[:, OMEGA_D], trial.commands[:, OMEGA_E] = speeds.T
            periods = min(left, 1 + round(rng.uniform(0.0, _CHANGE_S) / period_s))
            left -= periods
            if periods > 1:
                trial.advance(periods - 1)
            before = trial.bodies[:2].copy()
            trial.advance(1)
        trial.commands[:, MODE] = HOLD
        at = trial.advance(round(_REST_S / period_s)).position[:, :, :2]
    moved = np.hypot(*(at - before.T).transpose(2, 0, 1))
    restless = np.hypot(*(at - at[-1]).transpose(2, 0, 1)) > 1e-6
    return moved.max(axis=0), period_s * restless.sum(axis=0)


def _on_slippery_floor(config: CoSimConfig) -> CoSimConfig:
    """What decides how a robot stops, and nothing else."""
    world, clock = config.world, ("dt_s", "communication_step_s", "control_period_s")
    floor = min([config.robot.mu, *(patch.mu for patch in world.mu_patches)])
    brought = ("motor_spread", "restitution", "floor_tilt_deg", "payload_g", "payload_offset_mm")
    return CoSimConfig(
        robot=config.robot._replace(mu=floor),
        motor=config.motor,
        noise=config.noise,
        timing=TIMING._replace(**{name: getattr(config.timing, name) for name in clock}),
        steering=config.steering,
        order=config.order,
        reaction=config.reaction,
        open_loop=config.open_loop,
        world=World(**{name: getattr(world, name) for name in brought}),
    )


def shielded(config: CoSimConfig, motor_fmu: Path, progress: Progress = silent) -> CoSimConfig:
    """A calibrated configuration with the shield for its machine and world.

    The stopping distance is measured once and kept in the cache. On a floor of patches it is that
    of the most slippery one.

    Raises:
        CalibrationError: robots do not come to rest.
        FmuError: the FMU cannot be used, or failed.
    """
    code = code_digest(__name__)
    slippery = _on_slippery_floor(config)
    key = digest_of(slippery, motor_fmu, code)

    def make() -> float:
        with under_way(progress, "measuring stopping distances"):
            fmu = MotorFmu(motor_fmu)
            found = [stopping_distances(slippery, fmu, ROBOTS, k) for k in range(TRIALS)]
        if max(restless_s.max() for _, restless_s in found) > 0.9 * _REST_S:
            raise CalibrationError(
                "robots that are stopped slide on, on this floor; leave out --shield, or make the "
                "floor less steep or less slippery"
            )
        return float(max(moved.max() for moved, _ in found))

    def load(path: Path) -> float:
        return msgspec.json.decode(path.read_bytes(), type=float)

    def save(distance_m: float, path: Path) -> None:
        write_json(path, distance_m)

    distance_m = cached(cache_dir("calibrations") / f"{key}.json", load, make, save)
    stopping_m = RESERVE * distance_m
    return replace(config, shielding=config.shielding._replace(stopping_m=stopping_m))

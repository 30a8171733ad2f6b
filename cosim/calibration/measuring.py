"""Calibrations: trials of single robots at many motor speeds, found again in the cache.

What the trials say is `cosim.calibration.speed_map`; the command line is `minirobots calibrate`.
"""

import functools
import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from cosim.base.progress import Progress, silent
from cosim.base.provenance import digest_of
from cosim.base.storage import cache_dir, cached
from cosim.calibration.primitives import find_primitives, steered
from cosim.calibration.speed_map import DRIVES, MANOEUVRES, Calibration, load_calibration
from cosim.calibration.trial import Trial, mean_motion
from cosim.fmi.motor import MotorFmu, with_motor
from cosim.model.config import CoSimConfig
from fmus.build import identity_of_fmu

VERSION = 3  # of calibrations: raise it when their bits change

# Motor speeds of the trials as shares of the lift-off speed, closest where robots drive.
SPEEDS = (0.5, 0.6, 0.7, 0.78, 0.85, 0.9, 0.94, 0.955, 0.97)
PHASE_SPEEDS = (0.7, 0.85, 0.94)  # those at which trials without dither show what phases do
DITHERED_PHASES, PHASES = 4, 8
DIFFERENCES_RAD_S = (-100.0, -50.0, 50.0, 100.0)
SETTLE_S = 0.5  # motors reach 98 % of the set point; the map has the speed they really had
ROUNDS = 2  # of the dither, there and back
UNDITHERED_ROUND_S = 0.3
BATCH = 16  # trials that are co-simulated together
AHEAD, TURNING, AIRBORNE = 2, 4, 5  # columns of `measure_batch`: speed, yaw rate, share of time


class Point(NamedTuple):
    """Commands of one trial; fields as in `Calibration`."""

    omega_d: float
    omega_e: float
    phase: float
    dithered: bool


def points(config: CoSimConfig) -> list[Point]:
    """All trials of a calibration."""
    top = config.lift_off_rad_s
    some, many = (
        (2.0 * math.pi * np.arange(n) / n - math.pi).tolist() for n in (DITHERED_PHASES, PHASES)
    )
    found: list[Point] = []
    for share in SPEEDS:
        speed = share * top
        for name, (d, e) in MANOEUVRES.items():
            found += [Point(d * speed, e * speed, phase, True) for phase in some]
            # Without dither, by symmetry, one drive and one turn: what the phase does.
            if name in ("forwards", "left") and share in PHASE_SPEEDS:
                found += [Point(d * speed, e * speed, phase, False) for phase in many]
            if name in DRIVES and speed + max(DIFFERENCES_RAD_S) < top:
                speeds = ((c + d * speed, c + e * speed) for c in DIFFERENCES_RAD_S)
                found += [Point(*pair, 0.0, True) for pair in speeds]
    return found


def measure(
    config: CoSimConfig, motor_fmu: Path, jobs: int = 2, progress: Progress = silent
) -> Calibration:
    """Co-simulate all trials, in some threads; `config`'s motor and drive speeds do not matter."""
    todo, fmu = points(config), MotorFmu(motor_fmu)
    batches = [todo[k : k + BATCH] for k in range(0, len(todo), BATCH)]
    rows: list[np.ndarray] = []
    task = "calibrating speeds"
    progress(task, 0, len(todo))
    with ThreadPoolExecutor(jobs) as threads:
        seeds = (np.random.SeedSequence(0, spawn_key=(k,)) for k in range(len(batches)))
        for result in threads.map(functools.partial(measure_batch, config, fmu), batches, seeds):
            rows += list(result)
            progress(task, len(rows), len(todo))
    table = np.array(rows)
    return Calibration(
        np.array([(p.omega_d, p.omega_e) for p in todo]),
        table[:, :2],
        np.array([p.phase for p in todo]),
        np.array([p.dithered for p in todo]),
        *table[:, 2:].T,
        restitution=np.array(config.world.restitution or 0.0),
    )


def measure_batch(
    config: CoSimConfig, fmu: MotorFmu, batch: list[Point], seed: np.random.SeedSequence
) -> np.ndarray:
    """Co-simulate trials together.

    Returns:
        (trials, 7): mean ω_D and ω_E in rad/s, speed along the heading and to its left in m/s, yaw
        rate in rad/s, shares of the time without any foot on the floor and with a foot off it.
    """
    set_points = np.array([(p.omega_d, p.omega_e) for p in batch])
    dither = config.steering.dither_rad_s * np.array([p.dithered for p in batch])
    # A difference of both magnitudes: opposite signs while turning, equal ones while driving.
    direction = np.where(set_points[:, 0] * set_points[:, 1] > 0.0, 1.0, -1.0)
    unequal = np.column_stack([-direction, np.ones(len(batch))])
    period_s = config.timing.control_period_s
    settle = math.ceil(SETTLE_S / period_s)
    rate = 2.0 * config.steering.dither_rad_s  # at which it changes the phase
    half = math.ceil((2.0 * math.pi / rate if rate > 0.0 else 0.5 * UNDITHERED_ROUND_S) / period_s)
    with Trial(fmu, config, np.zeros(len(batch)), seed) as trial:
        phase_rate = np.array([p.phase for p in batch]) / (settle * period_s)
        ahead = np.sign(set_points[:, 1]) * phase_rate
        trial.set_motors(set_points + np.outer(ahead, (0.0, 1.0)))
        trial.advance(settle)
        before, samples = trial.poses, []
        for k in range(2 * ROUNDS):
            change = (dither if k % 2 == 0 else -dither)[:, None] * unequal
            trial.set_motors(set_points + change)
            samples.append(trial.advance(half))
    omega, airborne, lifted = (
        np.mean([getattr(part, name).mean(axis=0) for part in samples], axis=0)
        for name in ("omega", "airborne_share", "lifted_share")
    )
    return np.column_stack([omega, mean_motion(before, samples, period_s), airborne, lifted])


def digest(config: CoSimConfig, motor_fmu: Path) -> str:
    """Hash (16 hex digits) of what a calibration depends on: robot, motors, clock, noise."""
    timing = config.timing
    clock = (timing.dt_s, timing.communication_step_s, timing.control_period_s)
    pulses = config.steering.pulse_s, config.steering.pause_s
    further = [given for given in config.motor_parameters if given[0] not in config.motor._fields]
    return digest_of(
        config.robot,
        config.motor,
        config.noise,
        clock,
        config.steering.dither_rad_s,
        config.reaction,
        (config.world.restitution or 0.0, config.world.payload_g, config.world.payload_offset_mm),
        identity_of_fmu(motor_fmu),
        VERSION,
        *([further] if further else []),
        *([pulses] if any(pulses) else []),
    )


def find_calibration(
    config: CoSimConfig,
    motor_fmu: Path,
    progress: Progress = silent,
    *,
    jobs: int = 2,
    again: bool = False,
) -> Calibration:
    """The calibration of a configuration: found in the cache, or measured and kept there."""
    config = replace(config, open_loop=())  # speeds are those of motors under control
    MotorFmu(motor_fmu)  # a missing or foreign file is named before anything is hashed
    path = cache_dir("calibrations") / f"{digest(config, motor_fmu)}.npz"
    make = functools.partial(measure, config, motor_fmu, jobs, progress)
    return cached(path, load_calibration, make, Calibration.save, again=again)


def calibrated(
    config: CoSimConfig,
    motor_fmu: Path,
    progress: Progress = silent,
    *,
    slower: bool = False,
) -> CoSimConfig:
    """The configuration with the motor speeds that realise its drive speed and turn rate.

    Args:
        slower: limit the drive speed to the largest one without hopping, instead of refusing it.
    """
    config = with_motor(config, motor_fmu)
    if not config.steering.given:
        return steered(config, find_primitives(config, motor_fmu, progress))
    return find_calibration(config, motor_fmu, progress).resolved(config, slower=slower)

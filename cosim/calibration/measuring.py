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

from cosim.base.errors import UserError
from cosim.base.progress import Progress, silent
from cosim.base.storage import cache_dir, cached
from cosim.calibration.measured import LOAD, key_of, reduced
from cosim.calibration.primitives import find_primitives, steered
from cosim.calibration.speed_map import (
    BOUNCING_SHARE,
    DIRECTIONS,
    DRIVES,
    MAY_HOP_SHARE,
    Calibration,
    load_calibration,
)
from cosim.calibration.trial import FALLEN, Trial, mean_motion, without_falls
from cosim.coupling.signals import Samples
from cosim.fmi.motor import MotorFmu, with_motor
from cosim.model.config import CoSimConfig

VERSION = 4  # of calibrations: raise it when their bits change

# Motor speeds of the trials as shares of the largest one, closest where robots drive.
SPEEDS = (0.5, 0.6, 0.7, 0.78, 0.85, 0.9, 0.94, 0.955, 0.97)
PHASE_SPEEDS = (0.7, 0.85, 0.94)  # those at which trials without dither show what phases do
DITHERED_PHASES, PHASES = 4, 8
DIFFERENCES_RAD_S = (-100.0, -50.0, 50.0, 100.0)
SETTLE_S = 0.5  # motors reach 98 % of the set point; with dither, the map has their real speed
ROUNDS = 2  # of the dither, there and back
UNDITHERED_ROUND_S = 1.0  # so long that motors turn as they do after minutes
BATCH = 16  # trials that are co-simulated together
AIRBORNE = 3  # column of `measure_batch`: share of time


class Point(NamedTuple):
    """Commands of one trial; fields as in `Calibration`."""

    primitive: str
    set_speed: float
    difference: float = 0.0
    phase: float = 0.0
    dithered: bool = True


def points(config: CoSimConfig) -> list[Point]:
    """All trials of a calibration."""
    some, many = (
        (2.0 * math.pi * np.arange(n) / n - math.pi).tolist() for n in (DITHERED_PHASES, PHASES)
    )
    dithers = config.steering.dither_rad_s > 0.0
    found: list[Point] = []
    for share in SPEEDS:
        for name in DIRECTIONS:
            tops = zip(config.top_speeds_rad_s, shares_of(config, name), strict=True)
            top = min((top / abs(own) for top, own in tops if own), default=0.0)
            if not top:
                continue
            speed = share * top
            found += [Point(name, speed, phase=phase) for phase in some]
            # Without dither, by symmetry, one drive and one turn: what the phase does.
            if dithers and name in ("forwards", "left_turn") and share in PHASE_SPEEDS:
                found += [Point(name, speed, phase=phase, dithered=False) for phase in many]
            if name in DRIVES and speed + max(DIFFERENCES_RAD_S) < top:
                found += [Point(name, speed, change) for change in DIFFERENCES_RAD_S]
    return found


def shares_of(config: CoSimConfig, name: str) -> list[float]:
    """Shares of the motors in a primitive."""
    return [getattr(own, name) for own in config.steering.shares]


def measure(
    config: CoSimConfig, motor_fmu: Path, jobs: int = 2, progress: Progress = silent
) -> Calibration:
    """Co-simulate all trials, in some threads; `config`'s motor and drive speeds do not matter."""
    todo, fmu, motors = points(config), MotorFmu(motor_fmu), len(config.robot.motors)
    if not todo:
        raise UserError(
            "the motors are too weak to move the robot: they reach 0 rad/s; give stronger ones by "
            "--motor-fmu or --motor-parameter"
        )
    batches = [todo[k : k + BATCH] for k in range(0, len(todo), BATCH)]
    rows: list[np.ndarray] = []
    task = "calibrating speeds"
    progress(task, 0, len(todo))
    with ThreadPoolExecutor(jobs) as threads:
        seeds = (np.random.SeedSequence(0, spawn_key=(k,)) for k in range(len(batches)))
        for result in threads.map(functools.partial(measure_batch, config, fmu), batches, seeds):
            rows += list(result)
            progress(task, len(rows), len(todo))
    motion, omega = np.split(np.array(rows), [-motors], axis=1)
    hops = BOUNCING_SHARE if config.world.restitution else 0.0
    return Calibration(
        np.array([list(DIRECTIONS).index(p.primitive) for p in todo]),
        np.array([p.set_speed for p in todo]),
        np.array([p.difference for p in todo]),
        np.array([p.phase for p in todo]),
        np.array([p.dithered for p in todo]),
        omega,
        *motion.T,
        hopping_share=np.array(MAY_HOP_SHARE if config.hops else hops),
    )


def measure_batch(
    config: CoSimConfig, fmu: MotorFmu, batch: list[Point], seed: np.random.SeedSequence
) -> np.ndarray:
    """Co-simulate trials together.

    Returns:
        (trials, 5 + M): speed along the heading and to its left in m/s, yaw rate in rad/s, shares
        of the time without any foot on the floor and with a foot off it, and `omega_rad_s` of
        `Calibration`.
    """
    steering, period_s = config.steering, config.timing.control_period_s
    shares = np.array([shares_of(config, p.primitive) for p in batch])
    speeds, differences, phases = np.array([p[1:4] for p in batch]).T[:, :, None]
    none = (0.0,) * shares.shape[1]
    own = dict(zip(DRIVES, [drive.difference for drive in steering.drives], strict=True))
    set_points = speeds * shares + differences * [own.get(p.primitive, none) for p in batch]
    names = ["dither" if p.primitive in DRIVES else "turn_dither" for p in batch]
    dither = steering.dither_rad_s * np.array([[p.dithered] for p in batch])
    change = dither * [shares_of(config, name) for name in names]
    settle = math.ceil(SETTLE_S / period_s)
    rate = 2.0 * steering.dither_rad_s  # at which it changes the phase
    half = math.ceil((2.0 * math.pi / rate if rate > 0.0 else 0.5 * UNDITHERED_ROUND_S) / period_s)
    ahead = phases / (settle * period_s) * np.arange(shares.shape[1])

    def drive(driven: np.ndarray) -> tuple[np.ndarray, list[Samples]]:
        moves = driven.any(axis=1, keepdims=True)
        with Trial(fmu, config, np.zeros(len(batch)), seed) as trial:
            trial.set_motors(driven + np.sign(driven) * ahead)
            trial.advance(settle)
            before, samples = trial.poses, []
            for k in range(2 * ROUNDS):
                trial.set_motors(driven + moves * (change if k % 2 == 0 else -change))
                samples.append(trial.advance(half))
        return before, samples

    (before, samples), falls = without_falls(drive, set_points)
    omega, airborne, lifted = (
        np.mean([getattr(part, name).mean(axis=0) for part in samples], axis=0)
        for name in ("omega", "airborne_share", "lifted_share")
    )
    omega = omega if rate > 0.0 else speeds * shares
    sizes = np.abs(shares)
    fastest = np.where(sizes == sizes.max(axis=1, keepdims=True), sizes, np.nan)
    motion = mean_motion(before, samples, period_s)
    airborne[[error.column for error in falls]] = FALLEN
    return np.column_stack([motion, airborne, lifted, omega / fastest])


def digest(config: CoSimConfig, motor_fmu: Path) -> str:
    """Hash (16 hex digits) of what a calibration depends on: robot, motors, clock, noise, load."""
    driven = ("dither_rad_s", "pulse_s", "pause_s", "shares", "drives")
    own = reduced(config, LOAD)
    return key_of("calibration", VERSION, own, motor_fmu, steering=driven)


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

    Where no drive speed is asked of a machine whose primitives are found, it drives as found.

    Args:
        slower: limit the drive speed to the largest one without hopping, instead of refusing it.
    """
    config = with_motor(config, motor_fmu)
    asked = config.steering
    if not asked.given:
        config = steered(config, find_primitives(config, motor_fmu, progress))
        if not (asked.drive_speed_m_s or asked.turn_rate_rad_s):
            return config
        slower = slower or not asked.drive_speed_m_s
    return find_calibration(config, motor_fmu, progress).resolved(config, slower=slower)

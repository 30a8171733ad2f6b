"""Configurations with the shield: what it keeps is measured for their machine and world, once.

The shield's margin follows from measured stopping distances (docs/shield.md): robots drive every
which way, motors at speeds up to the largest that the steering asks for, changed at random times,
and are stopped at random times. Where there is a camera, so is the error of its estimates.
"""

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.stats import chi2

from cosim.base.errors import UserError
from cosim.base.progress import Progress, silent, under_way
from cosim.calibration.measured import LOAD, key_of, measured, reduced
from cosim.calibration.straying import best_filter
from cosim.calibration.trial import corners, heading_angles, trial_in_world
from cosim.fmi.motor import MotorFmu
from cosim.model.config import CoSimConfig
from cosim.model.params import SHIELD
from cosim.onboard.shield import stopping_gap
from cosim.onboard.steering import HOLD, MODE
from cosim.physics.body_state import PLANE, QUATERNION
from cosim.physics.contact.elastic import settling_s
from cosim.physics.mass import mass_of
from cosim.physics.trig import sine_cosine, sines_cosines

VERSION = 3  # of stopping distances and errors of estimates: raise it when their bits change
MOST_GAP = 0.5  # assumed: of the robots' diameter; with more there is no way past each other
_FLOOR = (*LOAD, "motor_spread", "floor_tilt_deg")
ROBOTS, TRIALS, ROUNDS = 64, 4, 8  # 2048 stops
EXCEEDED, CONFIDENCE = 1e-5, 0.99  # share of the stops that come further, and how sure that is
_TAIL = 0.05  # share of the stops that the bound is extrapolated from
RESERVE = 1.25  # assumed: over that bound, for motion that was not measured
REST_S = 0.1
_DRIVE_S, _CHANGE_S, _TICKS_S, _HELD_S = (0.05, 0.4), 0.2, 0.05, 0.25
_SWINGS = 3.0  # times as long as legs need to rest: masses that hang still swing on them
_BOUNCING_S = 10.0  # assumed: feet bounce as high as they ever do after this time at one speed
_OPEN_LOOP = 4.0  # times as long, because these motors take as long to speed up and down
_TURNS, _TURN, _LOOK_S = 16, 1.5, 0.05  # robots, half turns at the calibrated rate, between looks
_WIDTHS = 32  # directions in which a path is measured
SLIDES = (
    "robots that are stopped slide {} in this world; leave out --shield, or make the floor less "
    "steep or less slippery"
)


class Stops(NamedTuple):
    """Stops of N robots, n of each."""

    path_m: np.ndarray  # (N, n) diameter of the path from the look before the stop until rest
    rest_s: np.ndarray  # (N, n) time after which a robot moved less than a micrometre
    creep_m_s: np.ndarray  # (N,) mean speed of a robot that is held after the last stop


def stopping_paths(config: CoSimConfig, fmu: MotorFmu, robots: int, seed: int) -> Stops:
    """Measure how far robots come from one look until they rest, if the next look stops them.

    Motor spread and slope are drawn from the configuration's world. Where it has patches, up to
    four of their friction coefficients meet near every robot.
    """
    rng, sequence = np.random.default_rng(seed), np.random.SeedSequence(seed)
    period_s, steering = config.timing.control_period_s, config.steering
    speeds = steering.turn_speed_rad_s, steering.forward_speed_rad_s, steering.backward_speed_rad_s
    largest = max(steering.max_speed_rad_s, *speeds) + steering.dither_rad_s
    headings = rng.uniform(-np.pi, np.pi, robots)
    periods_of_ticks, slower = round(_TICKS_S / period_s), _slower(config)
    shares = np.array(steering.shares)  # of driving and of turning: columns 0 and 4
    with trial_in_world(fmu, config, headings, sequence) as trial:
        trial.lay(corners(config, trial.origins_m, rng))
        first, rest = (trial.ticks(n * config.ticks_per_period) for n in (1, periods_of_ticks))
        path_m, rest_s = np.zeros((2, robots, ROUNDS))
        for stop in range(ROUNDS):
            kind = rng.integers(4, size=robots)[:, None]
            steady_s = _BOUNCING_S if config.world.restitution and stop == 0 else 0.0
            left = round((slower * rng.uniform(*_DRIVE_S) + steady_s) / period_s)
            before = trial.bodies[PLANE].T.copy()
            while left > 0:
                # Any two speeds; driving; turning; the largest speeds.
                speeds = rng.uniform(-largest, largest, (robots, len(shares)))
                sign = rng.choice([-1.0, 1.0], (robots, 1))
                fast = sign * rng.uniform(0.7, 1.0, (robots, 1)) * largest
                choices = [fast * shares[:, 0], fast * shares[:, 4], np.sign(speeds) * largest]
                for number, chosen in enumerate(choices, 1):
                    speeds = np.where(kind == number, chosen, speeds)
                trial.set_motors(speeds)
                same_s = slower * rng.uniform(0.0, _CHANGE_S) + steady_s
                periods = min(left, 1 + round(same_s / period_s))
                left, steady_s = left - periods, 0.0
                if periods > 1:
                    trial.advance(periods - 1)
                before = trial.bodies[PLANE].T.copy()
                trial.advance(1, first)
            trial.commands[:, MODE] = HOLD
            at = trial.advance(round(_resting_s(config) / period_s), rest).position[:, :, :2]
            ticks = [raw.position[:, :robots, :2] for raw in (first, rest)]
            path_m[:, stop] = path_diameter(np.concatenate([before[None], *ticks, at]))
            restless = np.linalg.norm(at - at[-1], axis=2) > 1e-6
            rest_s[:, stop] = period_s * restless.sum(axis=0)
        held_s = _SWINGS * _resting_s(config) if config.robot.elastic else _HELD_S
        held = trial.advance(round(held_s / period_s)).position[[0, -1], :, :2]
    return Stops(path_m, rest_s, np.linalg.norm(held[1] - held[0], axis=1) / held_s)


def _slower(config: CoSimConfig) -> float:
    return _OPEN_LOOP if "motors" in config.open_loop else 1.0


def _resting_s(config: CoSimConfig) -> float:
    """Time that robots are given to come to rest, on legs until these have stopped swinging."""
    robot, usual_s = config.robot, _slower(config) * REST_S
    if not robot.elastic:
        return usual_s
    return max(usual_s, settling_s(robot, mass_of(robot, config.world)))


def path_diameter(path: np.ndarray) -> np.ndarray:
    """Return an upper bound (N,) on the diameter of paths (n, N, 2), at most 0.2 % above it."""
    angles = sines_cosines(np.pi * np.arange(_WIDTHS) / _WIDTHS).T
    widths = [np.ptp(c * path[..., 0] + s * path[..., 1], axis=0) for s, c in angles]
    return np.max(widths, axis=0) / sine_cosine(0.5 * np.pi / _WIDTHS)[1]


def bound_of(path_m: np.ndarray) -> float:
    """Return the length that at most EXCEEDED of all stops exceed, with CONFIDENCE.

    An exponential tail, with the upper limit of its mean, is fitted to how far the longest paths
    exceed a threshold. Measured tails end earlier (docs/shield.md), which makes the bound larger
    than it needs to be.

    Args:
        path_m: (N, n) of N robots; the number of robots in the tail limits how sure its mean is.
    """
    paths = np.sort(path_m, axis=None)
    longest = round(_TAIL * len(paths))
    threshold = paths[-longest - 1]
    robots = max(1, np.count_nonzero((path_m > threshold).any(axis=1)))
    excess = paths[-longest:] - threshold
    tail = max(excess.mean(), excess.std()) * 2.0 * robots
    tail /= chi2.ppf(1.0 - CONFIDENCE, 2 * robots)
    return float(threshold + tail * math.log(_TAIL / EXCEEDED))


def stopping_distance(config: CoSimConfig, fmu: MotorFmu) -> tuple[float, float]:
    """Return the bound on the stopping distance in m, and the creep of held robots in m/s."""
    found = [stopping_paths(config, fmu, ROBOTS, seed) for seed in range(TRIALS)]
    if max(stops.rest_s.max() for stops in found) > 0.9 * _resting_s(config):
        raise UserError(SLIDES.format("on"))
    bound_m = bound_of(np.concatenate([stops.path_m for stops in found]))
    return bound_m, float(max(stops.creep_m_s.max() for stops in found))


def turning_path(config: CoSimConfig, fmu: MotorFmu) -> tuple[float]:
    """Return how far a robot's centre comes in m, at most, from where half a turn began."""
    period_s, rate = config.timing.control_period_s, config.steering.turn_rate_rad_s
    shares = np.array([(own.left_turn, own.right_turn) for own in config.steering.shares])
    speeds = config.steering.turn_speed_rad_s * shares.T[np.arange(_TURNS) % 2]
    headings, sequence = np.zeros(_TURNS), np.random.SeedSequence(0)
    with trial_in_world(fmu, config, headings, sequence) as trial:
        trial.lay(corners(config, trial.origins_m, np.random.default_rng(0)))
        trial.set_motors(speeds)
        poses = [trial.poses]
        for _ in range(math.ceil(_TURN * math.pi / rate / _LOOK_S)):
            trial.advance(round(_LOOK_S / period_s))
            poses.append(trial.poses)
    angles = np.abs(heading_angles(np.array(poses)[..., QUATERNION]))
    if angles[-1].min() < math.pi:
        raise UserError(
            "robots that cannot drive backwards turn too slowly in this world to retreat; leave "
            "out --shield, or make the floor less steep or more slippery"
        )
    moved_m = np.linalg.norm(np.array(poses)[..., :2] - poses[0][:, :2], axis=2)
    return (float(moved_m[angles <= math.pi].max()),)


def _kept(
    measure: Callable[[CoSimConfig, MotorFmu], tuple[float, ...]],
    config: CoSimConfig,
    motor_fmu: Path,
) -> tuple[float, ...]:
    """Return the measurements for a configuration, from the cache if they are there."""
    key = key_of(measure.__name__, VERSION, config, motor_fmu)
    return measured(key, tuple[float, ...], lambda: measure(config, MotorFmu(motor_fmu)))


def with_stopping_distance(
    config: CoSimConfig, motor_fmu: Path, progress: Progress = silent
) -> CoSimConfig:
    """Return a calibrated configuration with the shield for its machine and world.

    The stopping distance is measured once and kept in the cache; on a floor of patches on the most
    slippery one, and across their edges. So is the error of estimates where there is a camera.
    """
    world, shield = config.world, config.shield or SHIELD
    least_mu = min([config.robot.mu, *(patch.mu for patch in world.mu_patches)])
    slippery = reduced(replace(config, robot=config.robot._replace(mu=least_mu)), _FLOOR)
    patchy = reduced(config, (*_FLOOR, "mu_patches"))
    with under_way(progress, "measuring stopping distances"):
        floors = [slippery, patchy] if world.mu_patches else [slippery]
        stops = [_kept(stopping_distance, floor, motor_fmu) for floor in floors]
        reverses = config.steering.backward_speed_rad_s > 0.0
        turns = [(0.0,) if reverses else _kept(turning_path, floor, motor_fmu) for floor in floors]
    bound_m, creep_m_s = map(max, zip(*stops, strict=True))
    stopping_m = math.ceil(1e6 * RESERVE * bound_m) / 1e6
    if creep_m_s * config.timing.episode_limit_s > stopping_m - bound_m:
        raise UserError(SLIDES.format(f"on, by {3.6e6 * creep_m_s:.2g} mm in an hour"))
    config = replace(config, shield=shield).having("measured", stopping_m=stopping_m)
    if not reverses:  # they turn before they retreat
        turned_m = math.ceil(1e6 * RESERVE * max(turns)[0]) / 1e6
        config = config.having("measured: room to turn", room_m=shield.room_m + turned_m)
        if turned_m > MOST_GAP * config.robot.diameter_m:
            raise UserError(
                f"machine {config.preset} cannot drive backwards, and its centre moves by up to "
                f"{1e3 * turned_m:.1f} mm while it turns around, more than {MOST_GAP:g} of its "
                "diameter, so that it could not retreat; leave out --shield, or change motors or "
                "feet"
            )
    if not world.camera.rate_hz:
        return config
    seen = reduced(config, (*_FLOOR, "mu_patches", "sensor"))
    with under_way(progress, "measuring errors of estimates"):
        drift, deviations, deviation_m = _kept(best_filter, seen, motor_fmu)
    config = config.having(
        "measured", deviations=math.ceil(100.0 * deviations) / 100.0, position_drift_m2_s=drift
    )
    assert config.shield is not None
    gap_m = stopping_gap(math.sqrt(2.0) * deviation_m, config.shield)
    if gap_m > MOST_GAP * config.robot.diameter_m:
        raise UserError(
            f"positions are too uncertain in this world: the shield stops robots {1e3 * gap_m:.0f} "
            f"mm apart, more than {MOST_GAP:g} of their diameter; leave out --shield, or change "
            "world.sensor, world.floor_tilt_deg or world.mu_patches"
        )
    return config

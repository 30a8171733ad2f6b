"""Measured errors of estimates, from which the shield's bound follows.

Robots of a world drive, turn and wait in it, and are steered by what its camera shows. Of the error
of an estimate one part is the noise of the frames, which is Gaussian with at most the filter's
variance. The other part, the bias, is the motion that was not commanded: on slopes, on patches, of
unequal motors. It is found by running the filter again over the same motion with frames without
noise, for several drifts of its motion model.
"""

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from cosim.base.jit import kernel
from cosim.calibration.trial import corners, heading_angles, trial_in_world
from cosim.fmi.motor import MotorFmu
from cosim.model.config import CoSimConfig
from cosim.model.params import EstimatorParams
from cosim.onboard.camera import (
    FRAME_SIZE,
    NOISE,
    camera_of,
    draw_sight,
    frames_in_flight,
    frames_within,
    update_estimate,
)
from cosim.onboard.estimation import ESTIMATE_SIZE, ODOMETRY, POSE
from cosim.onboard.shield import variance_of
from cosim.onboard.steering import DIRECTION, GOAL_X, GOAL_Y, HOLD, MODE, START, THROUGH
from cosim.physics.body_state import PLANE
from cosim.physics.draws import CAMERA_CHILD, generator
from cosim.physics.trig import sines_cosines

ROBOTS, LENGTH_S = 48, 12.0
RESERVE = 1.25  # assumed: over the largest bias that was measured
NOISE_DEVIATIONS = 5.0  # assumed: they bound the noise of the frames
_PERIODS = 10  # between two rows of what is commanded
_SAMPLED = 20  # periods between two looks that are judged
_LEAST_M = 1e-6  # error that counts as none
_HOLDS = 0.2
_COMMAND_S, _LINE_M = (0.1, 6.0), (0.003, 0.04)
_OCTAVES = range(-5, 7)  # of drifts that are tried
_ENOUGH = 1.1  # room over the least


class Tracks(NamedTuple):
    """Motion of N robots in T control periods."""

    poses: np.ndarray  # (T, N, 3) at the start of each period, m and rad
    commanded: np.ndarray  # (T, N, 4) until then, see `cosim.onboard.estimation.odometry`
    found: np.ndarray  # (M, N, NOISE) frames of the camera without noise


def drive_about(config: CoSimConfig, fmu: MotorFmu, robots: int, seed: int) -> Tracks:
    """Simulate robots on an endless floor that drive lines, half of them always the same way."""
    rng, sequence = np.random.default_rng(seed), np.random.SeedSequence(seed)
    period_s, sensor = config.timing.control_period_s, config.world.camera
    headings = rng.uniform(-np.pi, np.pi, robots)
    frames = frames_within(sensor, LENGTH_S)
    of_each = [generator(sequence, CAMERA_CHILD + robot) for robot in range(robots)]
    sight = np.stack([draw_sight(sensor, own, frames) for own in of_each], axis=1)
    usual, same = rng.uniform(-np.pi, np.pi, robots), rng.random(robots) < 0.5
    until = np.zeros(robots)
    with trial_in_world(fmu, config, headings, sequence, sight) as trial:
        trial.lay(corners(config, trial.origins_m, rng))
        trial.commands[:, THROUGH] = rng.random(robots) < 0.5
        poses = [np.concatenate([trial.bodies[PLANE], headings[None]]).T[None]]
        commanded = [np.zeros((robots, 4))]
        for k in range(round(LENGTH_S / (_PERIODS * period_s))):
            due = np.flatnonzero(until <= trial.time_s)
            until[due] = trial.time_s + rng.uniform(*_COMMAND_S, len(due))
            direction = np.where(same[due], usual[due], rng.uniform(-np.pi, np.pi, len(due)))
            along = rng.uniform(*_LINE_M, len(due)) * sines_cosines(direction)[::-1]
            place = trial.estimates[due, POSE : POSE + 2] if k else trial.bodies[PLANE, due].T
            trial.commands[due, DIRECTION] = direction
            trial.commands[due, GOAL_X : GOAL_Y + 1] = place + along.T
            trial.commands[due, MODE] = np.where(rng.random(len(due)) < _HOLDS, HOLD, START)
            samples = trial.advance(_PERIODS)
            angles = heading_angles(samples.quaternion)[..., None]
            poses.append(np.concatenate([samples.position[:, :, :2], angles], axis=2))
            commanded.append(trial.estimates[:, ODOMETRY : ODOMETRY + 4].copy())
    rows = np.array(commanded)
    shares = np.arange(_PERIODS)[:, None, None] / _PERIODS
    steps = rows[:-1, None] + shares * np.diff(rows, axis=0)[:, None]
    sight[:, :, : NOISE - 1] = 0.0
    return Tracks(np.concatenate(poses)[:-1], steps.reshape(-1, robots, 4), sight)


@kernel
def _replay(
    tracks: Tracks, camera: np.ndarray, flying: int, every: int, params: EstimatorParams
) -> np.ndarray:
    """Return (T / every, N, 3) errors in m and variances in m² of estimates without noise."""
    periods, robots, _ = tracks.poses.shape
    found = np.zeros((periods // every, robots, 3))
    for robot in range(robots):
        own, estimate = camera.copy(), np.zeros(ESTIMATE_SIZE)
        frames, sight = np.zeros((flying, FRAME_SIZE)), tracks.found[:, robot]
        for period in range(periods):
            for k in range(4):
                estimate[ODOMETRY + k] = tracks.commanded[period, robot, k]
            pose = tracks.poses[period, robot]
            update_estimate(own, frames, estimate, sight, (pose[0], pose[1], pose[2]), params)
            if period % every == 0:
                row = found[period // every, robot]
                row[0], row[1] = estimate[POSE] - pose[0], estimate[POSE + 1] - pose[1]
                row[2] = variance_of(estimate)
    return found


def bias_of(tracks: Tracks, config: CoSimConfig) -> tuple[float, float]:
    """Return the largest bias of an estimate, or of the difference of two, in standard deviations.

    And the standard deviation in m that a tenth of the looks has.
    """
    sensor = config.world.camera
    camera = camera_of(sensor, config.timing.control_period_s)
    found = _replay(tracks, camera, frames_in_flight(sensor), _SAMPLED, config.estimator)
    error, variance = found[..., :2], found[..., 2] + _LEAST_M**2
    alone = (error**2).sum(axis=2) / variance
    between = ((error[:, None] - error[:, :, None]) ** 2).sum(axis=3)
    together = between / (variance[:, None] + variance[:, :, None])
    bias = math.sqrt(max(alone.max(), together.max()))
    return bias, math.sqrt(np.quantile(variance, 0.9))


def best_filter(config: CoSimConfig, fmu: MotorFmu) -> tuple[float, float, float]:
    """Find the filter of a world's camera: the usual one, or one that needs clearly less room.

    Returns:
        Its drift of positions in m²/s; how many standard deviations bound its errors; and the
        standard deviation in m that a tenth of its estimates has.
    """
    tracks = drive_about(config, fmu, ROBOTS, seed=0)

    def judged(drift_m2_s: float) -> tuple[float, float, float]:
        estimator = config.estimator._replace(position_drift_m2_s=drift_m2_s)
        bias, deviation_m = bias_of(tracks, replace(config, estimator=estimator))
        return drift_m2_s, NOISE_DEVIATIONS + RESERVE * bias, deviation_m

    # The usual drift first, then those that are closer to it.
    usual = config.estimator.position_drift_m2_s
    found = [judged(usual * 2.0**k) for k in sorted(_OCTAVES, key=abs)]
    rooms_m = [deviations * deviation_m for _, deviations, deviation_m in found]
    return next(f for f, m in zip(found, rooms_m, strict=True) if m <= _ENOUGH * min(rooms_m))

"""The filter against the textbook's matrices, and what it knows of a robot that is seen late."""

import math
from typing import NamedTuple

import numpy as np
import pytest
from scipy.stats import chi2

from cosim.model.params import ESTIMATOR, EstimatorParams
from cosim.model.world import Sensor
from cosim.onboard import camera as cameras
from cosim.onboard import estimation
from cosim.onboard.camera import CAMERA_SIZE, FRAME_SIZE, camera_of, draw_sight, frames_in_flight
from cosim.onboard.estimation import COVARIANCE, ESTIMATE_SIZE, ODOMETRY, POSE

PERIOD_S = 1e-3
EXACT = EstimatorParams(0.0, 0.0)
ROUGH = Sensor(30.0, 50.0, 0.5, 1.0)


class Track(NamedTuple):
    """A robot that obeys but for noise: true and estimated poses, and covariances, by period."""

    truth: np.ndarray
    estimate: np.ndarray
    covariance: np.ndarray


def drive(sensor: Sensor, params: EstimatorParams, noise: EstimatorParams, seed=0, periods=4000):
    """Drive a curve of 5 mm/s and 0.3 rad/s, disturbed as a filter with `noise` expects."""
    rng = np.random.default_rng(seed)
    camera, estimate = camera_of(sensor, PERIOD_S), np.zeros(ESTIMATE_SIZE)
    frames = np.zeros((frames_in_flight(sensor), FRAME_SIZE))
    sight = draw_sight(sensor, rng, math.ceil(sensor.rate_hz * periods * PERIOD_S) + 1)
    x, y, heading = 0.1, 0.2, 0.5
    rows = []
    for _ in range(periods):
        cameras.look(camera, frames, estimate, sight, (x, y, heading), params)
        rows.append(np.concatenate([(x, y, heading), estimate[POSE : COVARIANCE + 9]]))
        speed, yaw_rate = 5e-3, 0.3
        estimation.take_command(estimate, speed, yaw_rate, True, PERIOD_S, params)
        middle = heading + 0.5 * yaw_rate * PERIOD_S
        spread = np.sqrt(PERIOD_S * np.array([noise.position_drift_m2_s] * 2))
        dx, dy = spread * rng.standard_normal(2)
        x += speed * PERIOD_S * math.cos(middle) + dx
        y += speed * PERIOD_S * math.sin(middle) + dy
        heading += yaw_rate * PERIOD_S
        heading += math.sqrt(noise.heading_drift_rad2_s * PERIOD_S) * rng.standard_normal()
    table = np.array(rows)
    return Track(table[:, :3], table[:, 3:6], table[:, 6:].reshape(-1, 3, 3))


def error(track: Track) -> np.ndarray:
    difference = track.estimate - track.truth
    difference[:, 2] = (difference[:, 2] + math.pi) % (2.0 * math.pi) - math.pi
    return difference


def test_a_frame_is_the_textbooks_correction():
    rng = np.random.default_rng(1)
    estimate = np.zeros(ESTIMATE_SIZE)
    variances = np.array([4e-7, 4e-7, 3e-4])
    estimation.start_estimate(estimate, (0.1, 0.2, 3.0), variances[0], variances[2])
    mean, sigma = np.array([0.1, 0.2, 3.0]), np.diag(variances)
    drift = np.diag([ESTIMATOR.position_drift_m2_s] * 2 + [ESTIMATOR.heading_drift_rad2_s])
    reference = np.zeros(4)
    for _ in range(20):
        here = reference + np.append(rng.normal(size=3) * (0.01, 0.01, 0.3), 0.04)
        turn = np.array(
            [
                [math.cos(reference[2]), math.sin(reference[2])],
                [-math.sin(reference[2]), math.cos(reference[2])],
            ]
        )
        along = turn @ (here - reference)[:2]
        c, s = math.cos(mean[2]), math.sin(mean[2])
        step = np.array([c * along[0] - s * along[1], s * along[0] + c * along[1]])
        jacobian = np.eye(3)
        jacobian[:2, 2] = -step[1], step[0]
        mean = mean + np.append(step, here[2] - reference[2])
        sigma = jacobian @ sigma @ jacobian.T + 0.04 * drift
        seen = mean + rng.normal(size=3) * np.sqrt(variances)
        gain = sigma @ np.linalg.inv(sigma + np.diag(variances))
        mean = mean + gain @ (seen - mean)
        sigma = (np.eye(3) - gain) @ sigma
        reference = here
        estimation.correct(
            estimate, tuple(seen), tuple(here), variances[0], variances[2], ESTIMATOR
        )
        estimate[ODOMETRY : ODOMETRY + 4] = here
        estimation.estimate_now(estimate, ESTIMATOR)
        off = estimate[POSE : POSE + 3] - mean
        off[2] = (off[2] + math.pi) % (2.0 * math.pi) - math.pi
        np.testing.assert_allclose(off, 0.0, atol=1e-12)
        covariance = estimate[COVARIANCE : COVARIANCE + 9].reshape(3, 3)
        np.testing.assert_allclose(covariance, sigma, rtol=1e-9, atol=1e-18)


def test_errors_are_as_large_as_the_filter_says():
    squared = []
    for seed in range(12):
        track = drive(ROUGH, ESTIMATOR, ESTIMATOR, seed)
        late = slice(1000, None, 300)  # far enough apart to be almost independent
        for e, sigma in zip(error(track)[late], track.covariance[late], strict=True):
            squared.append(e @ np.linalg.solve(sigma, e))
    low, high = chi2.ppf([0.0005, 0.9995], 3 * len(squared))
    assert low < sum(squared) < high


def test_it_knows_more_than_single_frames():
    track = drive(ROUGH, ESTIMATOR, ESTIMATOR)
    rms = np.sqrt((error(track)[1000:] ** 2).mean(axis=0))
    assert (rms[:2] < 0.6 * 0.5e-3).all()
    assert rms[2] < 0.9 * math.radians(1.0)  # of frames that are 50 to 83 ms old


@pytest.mark.parametrize("delay_ms", [0.0, 35.0, 500.0])
def test_late_frames_of_an_obedient_robot_leave_no_error(delay_ms):
    track = drive(Sensor(rate_hz=20.0, delay_ms=delay_ms), EXACT, EXACT)
    np.testing.assert_allclose(error(track), 0.0, atol=1e-12)


def test_what_no_frame_shows_grows_unsure():
    seen = drive(ROUGH, ESTIMATOR, ESTIMATOR)
    lost = drive(Sensor(30.0, 50.0, 0.5, 1.0, dropout=0.95), ESTIMATOR, ESTIMATOR)
    assert lost.covariance[-1, 0, 0] > 2.0 * seen.covariance[-1, 0, 0]


def test_frames_come_at_their_rate_whatever_the_control_period():
    sensor = Sensor(rate_hz=30.0, delay_ms=50.0)
    camera, estimate = camera_of(sensor, PERIOD_S), np.zeros(ESTIMATE_SIZE)
    frames, sight = np.zeros((frames_in_flight(sensor), FRAME_SIZE)), np.ones((91, 4))
    for _ in range(3000):
        cameras.look(camera, frames, estimate, sight, (0.0, 0.0, 0.0), ESTIMATOR)
    assert camera[cameras.SIGHT] == 90
    assert len(camera) == CAMERA_SIZE


def test_a_robot_that_stands_is_known_better_with_every_frame():
    camera, estimate = camera_of(ROUGH, PERIOD_S), np.zeros(ESTIMATE_SIZE)
    frames = np.zeros((frames_in_flight(ROUGH), FRAME_SIZE))
    sight = draw_sight(ROUGH, np.random.default_rng(0), 200)
    variance = []
    for period in range(4000):
        cameras.look(camera, frames, estimate, sight, (0.1, 0.2, 0.5), ESTIMATOR)
        variance.append(estimate[COVARIANCE])
        driven = 1000 <= period < 2000
        estimation.take_command(estimate, 0.0, 0.0, driven, PERIOD_S, ESTIMATOR)
    frame, settled = (1e-3 * ROUGH.position_noise_mm) ** 2, 1000 * ESTIMATOR.settle_s
    assert variance[999] == pytest.approx(frame / 30, rel=0.1)  # of as many frames in a second
    assert max(variance[1100:2000]) > 2.0 * variance[999]
    assert variance[2000 + round(settled) + 150] > variance[-1]
    assert variance[-1] < 2.0 * frame / 57
    assert np.hypot(*(estimate[POSE : POSE + 2] - (0.1, 0.2))) < 4.0 * math.sqrt(variance[-1])


def test_without_a_camera_the_pose_is_the_true_one():
    estimate = np.zeros(ESTIMATE_SIZE)
    pose = (0.123456789, 0.2, -1.0)
    nothing = np.zeros((0, FRAME_SIZE)), estimate, np.zeros((0, 4))
    cameras.look(camera_of(Sensor(), PERIOD_S), *nothing, pose, ESTIMATOR)
    assert tuple(estimate[POSE : POSE + 3]) == pose
    assert not estimate[COVARIANCE:].any()

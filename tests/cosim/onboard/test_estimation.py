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
from cosim.onboard.camera import FRAME_SIZE, camera_of, draw_sight, frames_in_flight
from cosim.onboard.estimation import COVARIANCE, ESTIMATE_SIZE, POSE

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
        cameras.update_estimate(camera, frames, estimate, sight, (x, y, heading), params)
        rows.append(np.concatenate([(x, y, heading), estimate[POSE : COVARIANCE + 9]]))
        speed, yaw_rate = 5e-3, 0.3
        estimation.take_command(estimate, speed, 0.0, yaw_rate, True, PERIOD_S, params)
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


class Textbook(NamedTuple):
    """Mean and covariance of the extended Kalman filter, in matrices."""

    mean: np.ndarray
    sigma: np.ndarray

    def moved(self, before: np.ndarray, after: np.ndarray) -> "Textbook":
        """Predict by commanded poses, with the seconds of driving behind them."""
        c, s = math.cos(before[2]), math.sin(before[2])
        along = np.array([[c, s], [-s, c]]) @ (after - before)[:2]
        c, s = math.cos(self.mean[2]), math.sin(self.mean[2])
        step = np.array([[c, -s], [s, c]]) @ along
        jacobian = np.eye(3)
        jacobian[:2, 2] = -step[1], step[0]
        drift = np.diag([ESTIMATOR.position_drift_m2_s] * 2 + [ESTIMATOR.heading_drift_rad2_s])
        mean = self.mean + np.append(step, after[2] - before[2])
        return Textbook(mean, jacobian @ self.sigma @ jacobian.T + (after - before)[3] * drift)

    def corrected(self, seen: np.ndarray, noise: np.ndarray) -> "Textbook":
        """Correct by a pose that is seen with a noise of that covariance."""
        gain = self.sigma @ np.linalg.inv(self.sigma + noise)
        off = wrapped(seen - self.mean)
        return Textbook(self.mean + gain @ off, (np.eye(3) - gain) @ self.sigma)

    def agrees(self, estimate: np.ndarray) -> None:
        off = wrapped(estimate[POSE : POSE + 3] - self.mean)
        np.testing.assert_allclose(off, 0.0, atol=1e-12)
        covariance = estimate[COVARIANCE : COVARIANCE + 9].reshape(3, 3)
        np.testing.assert_allclose(covariance, self.sigma, rtol=1e-9, atol=1e-18)


def wrapped(pose: np.ndarray) -> np.ndarray:
    return np.append(pose[:2], (pose[2] + math.pi) % (2.0 * math.pi) - math.pi)


@pytest.mark.parametrize(
    "sensor",
    [
        Sensor(30.0, 50.0, 0.5, 1.0, 0.3),
        Sensor(25.0, 0.0, 2.0, 0.2),
        Sensor(40.0, 120.0, 0.0, 3.0),
        Sensor(7.0, 333.0, 1.0, 0.0),
        Sensor(90.0, 120.0, 0.4, 0.3),  # of which a dozen frames are under way
    ],
)
def test_an_estimate_is_the_textbooks_of_the_frames_that_have_arrived(sensor):
    """Of each frame the pose at its time, its noise, and the motion since; none before its time."""
    rng, periods = np.random.default_rng(1), 1000
    camera, estimate = camera_of(sensor, PERIOD_S), np.zeros(ESTIMATE_SIZE)
    frames = np.zeros((frames_in_flight(sensor), FRAME_SIZE))
    sight = draw_sight(sensor, rng, 100)
    noise = np.diag([(1e-3 * sensor.position_noise_mm) ** 2] * 2 + [0.0])
    noise[2, 2] = math.radians(sensor.heading_noise_deg) ** 2
    taken = [math.ceil(k * (1.0 / (sensor.rate_hz * PERIOD_S))) for k in range(100)]
    delay = round(sensor.delay_ms)
    poses = np.array([0.1, 0.2, 3.0]) + np.cumsum(rng.normal(size=(periods, 3)) * 1e-4, axis=0)
    commanded, still_s = np.zeros((periods + 1, 4)), math.inf
    speed, yaw_rate, driven = 0.0, 0.0, False
    known = Textbook(poses[0], noise)
    reference, arrived = commanded[0], 0
    for now in range(periods):
        cameras.update_estimate(camera, frames, estimate, sight, tuple(poses[now]), ESTIMATOR)
        while taken[arrived] + delay <= now:
            if sight[arrived, 3]:
                at = taken[arrived]
                known, reference = known.moved(reference, commanded[at]), commanded[at]
                seen = poses[at] + sight[arrived, :3]
                known = known.corrected(seen, noise + 1e-30 * np.eye(3))
            arrived += 1
        known.moved(reference, commanded[now]).agrees(estimate)
        if now % 200 == 0:
            speed, yaw_rate, driven = rng.normal() * 5e-3, rng.normal(), now % 400 == 0
            speed, yaw_rate = speed * driven, yaw_rate * driven
        estimation.take_command(estimate, speed, 0.0, yaw_rate, driven, PERIOD_S, ESTIMATOR)
        still_s = 0.0 if driven else still_s + PERIOD_S
        x, y, heading, driving_s = commanded[now]
        middle = heading + 0.5 * yaw_rate * PERIOD_S
        x, y = x + speed * PERIOD_S * math.cos(middle), y + speed * PERIOD_S * math.sin(middle)
        driving_s += PERIOD_S * (still_s < ESTIMATOR.settle_s)
        commanded[now + 1] = x, y, heading + yaw_rate * PERIOD_S, driving_s


def test_the_noise_of_a_camera_is_what_its_world_says():
    sensor = Sensor(30.0, 50.0, 2.0, 3.0, 0.2)
    sight = draw_sight(sensor, np.random.default_rng(0), 20_000)
    assert sight[:, :3].std(axis=0) == pytest.approx([2e-3, 2e-3, math.radians(3.0)], rel=0.02)
    assert sight[:, 3].mean() == pytest.approx(0.8, abs=0.01)
    assert np.abs(np.corrcoef(sight.T) - np.eye(4)).max() < 0.03


def test_errors_are_as_large_as_the_filter_says():
    squared = []
    for seed in range(12):
        track = drive(ROUGH, ESTIMATOR, ESTIMATOR, seed)
        late = slice(1000, None, 300)  # far enough apart to be almost independent
        for e, sigma in zip(error(track)[late], track.covariance[late], strict=True):
            squared.append(e @ np.linalg.solve(sigma, e))
    low, high = chi2.ppf([0.0005, 0.9995], 3 * len(squared))
    assert low < sum(squared) < high


@pytest.mark.parametrize("delay_ms", [0.0, 35.0, 500.0])
def test_late_frames_of_an_obedient_robot_leave_no_error(delay_ms):
    track = drive(Sensor(rate_hz=20.0, delay_ms=delay_ms), EXACT, EXACT)
    np.testing.assert_allclose(error(track), 0.0, atol=1e-12)


def test_without_a_camera_the_pose_is_the_true_one():
    estimate = np.zeros(ESTIMATE_SIZE)
    pose = (0.123456789, 0.2, -1.0)
    nothing = np.zeros((0, FRAME_SIZE)), estimate, np.zeros((0, 4))
    cameras.update_estimate(camera_of(Sensor(), PERIOD_S), *nothing, pose, ESTIMATOR)
    assert tuple(estimate[POSE : POSE + 3]) == pose
    assert not estimate[COVARIANCE:].any()

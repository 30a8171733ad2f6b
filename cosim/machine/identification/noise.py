"""Tracks against simulations: errors from frame to frame, and how large they are alone.

A camera's errors are independent from frame to frame. A robot's are not: what speed noise and motor
phases do to it stays, and its track walks away from any simulation. So a scalar Kalman filter each
follows heading and position with the simulated steps, and its innovations, over their standard
deviations, are the residuals: independent, of variance 1, if the parameters are right.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import minimize_scalar

_RATIOS = (-8.0, 2.0)  # of drift in 1 s and camera noise, variances: decadic logarithms
# Of a frame in m and rad: no simulation is closer to a robot, which vibrates with other phases.
LEAST_POSITION_M, LEAST_HEADING_RAD = 5e-5, 1e-3


class Noise(NamedTuple):
    """Model of the difference of tracks (n, 3) from a simulation with the right parameters."""

    # position_m, heading_rad: standard deviations of the camera, x and y each
    position_m: float
    heading_rad: float
    # position_drift_m2_s, heading_drift_rad2_s: growth of the variance of a driven pose
    position_drift_m2_s: float
    heading_drift_rad2_s: float


# Before anything is known: drifts so large that a simulation with wrong parameters is followed.
FIRST_NOISE = Noise(5e-4, math.radians(1.0), 1e-6, 1e-2)


def _gains(times: np.ndarray, ratio: float) -> tuple[np.ndarray, np.ndarray]:
    """Kalman gains (n − 1,) of a random walk, and variances of innovations over that of a frame.

    Args:
        ratio: growth of the walk's variance in 1/s over the variance of a frame.
    """
    gains, variance = np.empty(len(times) - 1), 1.0
    for k, interval in enumerate(np.diff(times)):
        variance += ratio * interval
        variance = gains[k] = variance / (variance + 1.0)
    return gains, 1.0 / (1.0 - gains)


def _followed(
    measured: np.ndarray, steps: np.ndarray, gains: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Innovations (n − 1, C) and filtered values (n − 1, C) before each of the steps (n − 1, C)."""
    innovations, filtered = np.empty_like(steps), np.empty_like(steps)
    value = np.full(steps.shape[1], measured[0])
    for k, gain in enumerate(gains):
        filtered[k] = value
        value = value + steps[k]
        innovations[k] = measured[k + 1] - value
        value += gain * innovations[k]
    return innovations, filtered


def _turned_steps(simulated: np.ndarray, headings: np.ndarray) -> np.ndarray:
    """Simulated steps as complex numbers, turned to where the robot really heads before them."""
    places = simulated[..., 0] + 1j * simulated[..., 1]
    return np.diff(places, axis=0) * np.exp(1j * (headings - simulated[:-1, :, 2]))


def residuals(
    times: np.ndarray, measured: np.ndarray, simulated: np.ndarray, noise: Noise
) -> np.ndarray:
    """Innovations (n − 1, 3, C) of x, y and heading over their standard deviations.

    Args:
        measured: (n, 3) x and y in m, heading in rad, continuous.
        simulated: (n, C, 3) the same of C simulations, from any pose.
    """
    gains, variances = _gains(times, noise.heading_drift_rad2_s / noise.heading_rad**2)
    turned, headings = _followed(measured[:, 2], np.diff(simulated[..., 2], axis=0), gains)
    turned /= noise.heading_rad * np.sqrt(variances)[:, None]
    gains, variances = _gains(times, noise.position_drift_m2_s / noise.position_m**2)
    places = measured[:, 0] + 1j * measured[:, 1]
    moved, _ = _followed(places, _turned_steps(simulated, headings), gains)
    moved /= noise.position_m * np.sqrt(variances)[:, None]
    return np.stack([np.real(moved), np.imag(moved), turned], axis=1)


def deviance(times: np.ndarray, errors: np.ndarray, noise: Noise) -> float:
    """Return −2 times the log-likelihood of residuals (n − 1, 3), less a constant."""
    of_place, of_heading = (
        np.log(deviation**2 * _gains(times, drift / deviation**2)[1]).sum()
        for deviation, drift in (
            (noise.position_m, noise.position_drift_m2_s),
            (noise.heading_rad, noise.heading_drift_rad2_s),
        )
    )
    return float((errors**2).sum() + 2.0 * of_place + of_heading)


def likeliest_noise(times: np.ndarray, measured: np.ndarray, simulated: np.ndarray) -> Noise:
    """The noise of largest likelihood if the simulation (n, 3) has the right parameters."""
    simulated = simulated[:, None]
    turns = np.diff(simulated[..., 2], axis=0)
    heading_rad, heading_drift = _likeliest(times, measured[:, 2], turns, 1, LEAST_HEADING_RAD)
    gains, _ = _gains(times, heading_drift / heading_rad**2)
    _, headings = _followed(measured[:, 2], turns, gains)
    places = measured[:, 0] + 1j * measured[:, 1]
    steps = _turned_steps(simulated, headings)
    position_m, position_drift = _likeliest(times, places, steps, 2, LEAST_POSITION_M)
    return Noise(position_m, heading_rad, position_drift, heading_drift)


def _likeliest(
    times: np.ndarray, measured: np.ndarray, steps: np.ndarray, components: int, least: float
) -> tuple[float, float]:
    """Standard deviation of frames and growth of the walk's variance, by number of components."""

    def variance_at(decades: float) -> tuple[float, float]:
        gains, variances = _gains(times, 10.0**decades)
        innovations, _ = _followed(measured, steps, gains)
        of_frames = np.mean(np.abs(innovations[:, 0]) ** 2 / variances) / components
        of_frames = max(float(of_frames), least**2)
        return of_frames, math.log(of_frames) + float(np.mean(np.log(variances)))

    found: Any = minimize_scalar(
        lambda decades: variance_at(decades)[1], bounds=_RATIOS, method="bounded"
    )
    variance, _ = variance_at(found.x)
    return math.sqrt(variance), float(10.0**found.x * variance)

"""The camera over the board, robot by robot: frames that are taken, travel, and arrive.

At a frame rate of 0 there is none: poses are known exactly in every control period.
"""

import math

import numpy as np

from cosim.base.jit import inlined, kernel
from cosim.model.params import EstimatorParams
from cosim.model.world import Sensor
from cosim.onboard.estimation import POSE, Pose, correct, estimate_now, odometry, start_estimate
from cosim.physics.trig import make_normal

# Layout of one robot's camera, float64; times in control periods.
INTERVAL = 0  # between frames, 0 without a camera
DELAY = 1  # of a frame
POSITION_VARIANCE, HEADING_VARIANCE = 2, 3  # m², rad²
_NOW = 4  # control periods since the start
_TAKEN, _USED = 5, 6  # frames so far
SIGHT = 7  # frames since the noise was drawn
_ROOM = 8  # for frames in flight
CAMERA_SIZE = 9

# Layout of a frame under way.
_AT, _FOUND, _SEEN, _REFERENCE = 0, 1, 2, 5
FRAME_SIZE = 9

NOISE = 4  # of a frame: x, y in m, heading in rad, and whether the robot is found
SIGHT_DRAWS = NOISE + 1  # uniform numbers for them


def camera_of(sensor: Sensor, control_period_s: float) -> np.ndarray:
    """The camera of a robot at the start, shape (CAMERA_SIZE,)."""
    camera = np.zeros(CAMERA_SIZE)
    if sensor.rate_hz:
        camera[INTERVAL] = max(1.0, 1.0 / (sensor.rate_hz * control_period_s))
        camera[DELAY] = round(1e-3 * sensor.delay_ms / control_period_s)
        camera[_ROOM] = frames_in_flight(sensor)
        camera[POSITION_VARIANCE] = np.square(1e-3 * sensor.position_noise_mm)
        camera[HEADING_VARIANCE] = np.square(math.radians(sensor.heading_noise_deg))
    return camera


def frames_in_flight(sensor: Sensor) -> int:
    """Return the largest number of frames in flight at once."""
    return math.ceil(1e-3 * sensor.delay_ms * sensor.rate_hz) + 2 if sensor.rate_hz else 0


def frames_within(sensor: Sensor, seconds: float) -> int:
    """Most frames that are taken within some time."""
    return math.ceil(sensor.rate_hz * seconds) + 1 if sensor.rate_hz else 0


def draw_sight(sensor: Sensor, rng: np.random.Generator, frames: int) -> np.ndarray:
    """Draw the camera's noise of one robot in some frames, shape (frames, NOISE)."""
    sight = np.empty((frames, NOISE))
    write_sight(sight, rng.random(frames * SIGHT_DRAWS), *spread_of(sensor))
    return sight


def spread_of(sensor: Sensor) -> tuple[float, float, float]:
    """Return the standard deviations in m and rad of a frame, and the share of lost ones."""
    deviation_m, deviation_rad = 1e-3 * sensor.position_noise_mm, sensor.heading_noise_deg
    return deviation_m, math.radians(deviation_rad), sensor.dropout


@kernel
def write_sight(
    sight: np.ndarray,
    uniforms: np.ndarray,
    deviation_m: float,
    deviation_rad: float,
    dropout: float,
) -> None:
    """Write the camera's noise of one robot in some frames, (frames, NOISE).

    `uniforms`, (frames SIGHT_DRAWS,) in [0, 1), is used up.
    """
    normal = uniforms[: len(sight) * NOISE]
    make_normal(normal)
    for k in range(len(sight)):
        sight[k, 0], sight[k, 1] = deviation_m * normal[4 * k], deviation_m * normal[4 * k + 1]
        sight[k, 2] = deviation_rad * normal[4 * k + 2]
        sight[k, 3] = uniforms[len(normal) + k] >= dropout


@inlined
def update_estimate(
    camera: np.ndarray,
    frames: np.ndarray,
    estimate: np.ndarray,
    sight: np.ndarray,
    pose: Pose,
    params: EstimatorParams,
) -> None:
    """Bring a robot's estimate to the start of a control period.

    Args:
        frames: (F, FRAME_SIZE), at least `frames_in_flight` rows, for them.
        sight: (M, NOISE) of frames since it was drawn.
    """
    if camera[INTERVAL] == 0.0:
        estimate[POSE], estimate[POSE + 1], estimate[POSE + 2] = pose
        return
    now = camera[_NOW]
    if now == 0.0:
        start_estimate(estimate, pose, camera[POSITION_VARIANCE], camera[HEADING_VARIANCE])
    if now >= camera[INTERVAL] * camera[_TAKEN]:
        frame = frames[int(camera[_TAKEN] % camera[_ROOM])]
        noise = sight[int(camera[SIGHT])]
        frame[_AT], frame[_FOUND] = now, noise[3]
        reference = odometry(estimate)
        for k in range(3):
            frame[_SEEN + k] = pose[k] + noise[k]
            frame[_REFERENCE + k] = reference[k]
        frame[_REFERENCE + 3] = reference[3]
        camera[_TAKEN] += 1.0
        camera[SIGHT] += 1.0
    while camera[_USED] < camera[_TAKEN]:
        frame = frames[int(camera[_USED] % camera[_ROOM])]
        if frame[_AT] + camera[DELAY] > now:
            break
        camera[_USED] += 1.0
        if frame[_FOUND] > 0.0:
            correct(
                estimate,
                (frame[_SEEN], frame[_SEEN + 1], frame[_SEEN + 2]),
                odometry(frame, _REFERENCE),
                camera[POSITION_VARIANCE],
                camera[HEADING_VARIANCE],
                params,
            )
    estimate_now(estimate, params)
    camera[_NOW] = now + 1.0

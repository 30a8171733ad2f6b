"""Pose estimation: extended Kalman filter over camera poses and commanded motion.

The filter lives at the time of the last frame that has arrived (frames are late): there it is
predicted from frame to frame by the commanded motion in between, and corrected. What steers is
that estimate moved on by the motion commanded since. Equations (K1) to (K5) are those of table 3.3
of Thrun, Burgard and Fox, Probabilistic Robotics (2005); the camera sees the state itself, so that
C is the identity and a frame is three scalar corrections. Poses are (x, y, heading) in m and rad.
"""

import math

import numpy as np

from cosim.base.jit import inlined
from cosim.model.params import EstimatorParams
from cosim.physics.rotation import wrapped
from cosim.physics.trig import sine_cosine

# Layout of one robot's estimate, float64.
POSE = 0  # now
COVARIANCE = 3  # of it, 3 x 3 row by row, m², m rad, rad²
_STATE, _SIGMA = 12, 15  # pose and covariance at the last frame that has arrived
ODOMETRY = 24  # commanded motion summed up since the start, a pose and seconds of driving
_REFERENCE = 28  # that sum at the last frame that has arrived
_STILL = 32  # seconds since the motors were driven
ESTIMATE_SIZE = 33

Pose = tuple[float, float, float]
Commanded = tuple[float, float, float, float]


@inlined
def _pose(estimate: np.ndarray, at: int) -> Pose:
    return estimate[at], estimate[at + 1], estimate[at + 2]


@inlined
def _put(estimate: np.ndarray, at: int, pose: Pose) -> None:
    estimate[at], estimate[at + 1], estimate[at + 2] = pose


@inlined
def _between(first: Commanded, second: Commanded) -> Commanded:
    """Return the motion from one pose to another in the frame of the first, and its seconds."""
    s, c = sine_cosine(first[2])
    dx, dy = second[0] - first[0], second[1] - first[1]
    return c * dx + s * dy, c * dy - s * dx, second[2] - first[2], second[3] - first[3]


@inlined
def _predict(estimate: np.ndarray, to: int, motion: Commanded, params: EstimatorParams) -> None:
    """Write the filter's pose after a motion, and its covariance behind it, to `to`.

    Only a robot that is driven strays from what is commanded: at rest its variance does not grow.
    """
    x, y, heading = _pose(estimate, _STATE)
    s, c = sine_cosine(heading)
    dx, dy = c * motion[0] - s * motion[1], s * motion[0] + c * motion[1]
    # Eq. (K1): the pose after the commanded motion
    _put(estimate, to, (x + dx, y + dy, wrapped(heading + motion[2])))
    # Eq. (K2): G Σ Gᵀ + Q; G differs from the identity in how the heading turns the motion
    for i in range(9):
        estimate[to + 3 + i] = estimate[_SIGMA + i]
    after = estimate[to + 3 : to + 12]
    for k in range(3):
        after[k] -= dy * after[6 + k]
        after[3 + k] += dx * after[6 + k]
    for k in range(0, 9, 3):
        after[k] -= dy * after[k + 2]
        after[k + 1] += dx * after[k + 2]
    after[0] += params.position_drift_m2_s * motion[3]
    after[4] += params.position_drift_m2_s * motion[3]
    after[8] += params.heading_drift_rad2_s * motion[3]


@inlined
def start_estimate(
    estimate: np.ndarray, pose: Pose, position_variance: float, heading_variance: float
) -> None:
    """Begin at the robot's start pose, with the uncertainty of one frame."""
    for k in range(ESTIMATE_SIZE):
        estimate[k] = 0.0
    _put(estimate, _STATE, pose)
    estimate[_SIGMA] = estimate[_SIGMA + 4] = position_variance
    estimate[_SIGMA + 8] = heading_variance
    for k in range(12):
        estimate[POSE + k] = estimate[_STATE + k]
    estimate[_STILL] = math.inf


@inlined
def odometry(estimate: np.ndarray, at: int = ODOMETRY) -> Commanded:
    """Return the commanded motion since the start, which is kept with a frame."""
    return estimate[at], estimate[at + 1], estimate[at + 2], estimate[at + 3]


@inlined
def take_command(
    estimate: np.ndarray,
    speed: float,
    course: float,
    yaw_rate: float,
    driven: bool,
    seconds: float,
    params: EstimatorParams,
) -> None:
    """Add up the commanded motion of a control period: m/s, rad from the heading, rad/s, and s.

    `driven` says whether a motor has a set point.
    """
    estimate[_STILL] = 0.0 if driven else estimate[_STILL] + seconds
    if estimate[_STILL] < params.settle_s:
        estimate[ODOMETRY + 3] += seconds
    x, y, heading = _pose(estimate, ODOMETRY)
    # by the heading in the middle: exact to third order
    middle = heading + 0.5 * yaw_rate * seconds
    s, c = sine_cosine(middle + course)
    x += speed * seconds * c
    y += speed * seconds * s
    _put(estimate, ODOMETRY, (x, y, heading + yaw_rate * seconds))


@inlined
def correct(
    estimate: np.ndarray,
    seen: Pose,
    reference: Commanded,
    position_variance: float,
    heading_variance: float,
    params: EstimatorParams,
) -> None:
    """Take a frame that has arrived.

    Args:
        reference: `odometry` when it was taken.
        position_variance, heading_variance: of the camera, m² and rad².
    """
    motion = _between(odometry(estimate, _REFERENCE), reference)
    _predict(estimate, _STATE, motion, params)
    for k in range(4):
        estimate[_REFERENCE + k] = reference[k]
    sigma = estimate[_SIGMA : _SIGMA + 9]
    for row in range(3):
        variance = heading_variance if row == 2 else position_variance
        spread = sigma[4 * row] + variance
        if spread <= 0.0:
            continue
        innovation = seen[row] - estimate[_STATE + row]
        if row == 2:
            innovation = wrapped(innovation)
        # Eq. (K3): the gain, a column; kept apart from Σ, because its row is used until the end
        gain = sigma[row] / spread, sigma[3 + row] / spread, sigma[6 + row] / spread
        ahead = sigma[3 * row], sigma[3 * row + 1], sigma[3 * row + 2]
        for i in range(3):
            # Eq. (K4)
            estimate[_STATE + i] += gain[i] * innovation
            for k in range(3):
                # Eq. (K5)
                sigma[3 * i + k] -= gain[i] * ahead[k]
    estimate[_STATE + 2] = wrapped(estimate[_STATE + 2])


@inlined
def estimate_now(estimate: np.ndarray, params: EstimatorParams) -> None:
    """Predict the present estimate from the last frame that has arrived."""
    motion = _between(odometry(estimate, _REFERENCE), odometry(estimate))
    _predict(estimate, POSE, motion, params)

"""Arrays that a co-simulation lives in: its state, and the signals that are sampled from it.

Records of numpy arrays for the kernels of `cosim.coupling.plant`; no behaviour.
"""

from typing import NamedTuple

import numpy as np

from cosim.coupling.steering import COMMAND_SIZE
from cosim.physics.body import STATE_SIZE

MOTORS = 2  # D, E
FEET = 3  # A, B, C


class State(NamedTuple):
    """Variables of the coupled system; float64 arrays for N robots.

    Attributes:
        bodies: (N, STATE_SIZE), layout in cosim.physics.body.
        commands: (N, COMMAND_SIZE), layout in cosim.coupling.steering.
        inputs: (N, 2, 3) omega_des, omega_noise, d of motors D and E.
        outputs: (N, 2, 3) theta, omega, omega_dot.
        held: (N, 2, 3) the outputs at the start of the communication step.
        held_velocities: (N, 6) velocity (world) and angular velocity (body) at that time.
        electrical: (N, 2, 2) V_s, i.
        normal_peak: (N, 3) largest normal impulse of each foot in this control period, N s.
        friction_peak: (N, 3) largest friction impulse, squared, N² s².
        slipping: (N, 3) ticks of this period in which each foot slid.
        lifted: (N,) ticks of this period in which a foot carried nothing.
        touching: (N,) ticks of this period in which another robot was touched.
        near: (N (N − 1) / 2, 2) int64, pairs that may touch in this period.
        near_count: (1,) int64, how many they are.
        events: (N,) int64, what became of each robot in this period, see cosim.coupling.plant.
        obstacles: (M, 4) rectangles left, bottom, right, top in m, which stay.
    """

    bodies: np.ndarray
    commands: np.ndarray
    inputs: np.ndarray
    outputs: np.ndarray
    held: np.ndarray
    held_velocities: np.ndarray
    electrical: np.ndarray
    normal_peak: np.ndarray
    friction_peak: np.ndarray
    slipping: np.ndarray
    lifted: np.ndarray
    touching: np.ndarray
    near: np.ndarray
    near_count: np.ndarray
    events: np.ndarray
    obstacles: np.ndarray


class Samples(NamedTuple):
    """Signals sampled at the end of each of n control periods; float64, SI units.

    Attributes:
        omega, omega_des, theta, voltage, current: (n, N, 2), motors D and E.
        disturbance: (n, N, 2) torque of input d in N m.
        position: (n, N, 3) centre of mass in the world.
        quaternion: (n, N, 4) world from body, (w, x, y, z).
        velocity: (n, N, 3) in the world.
        yaw_rate: (n, N).
        normal_max, friction_max: (n, N, 3) largest forces of feet A, B, C in the period, N.
        slipping_share: (n, N, 3) share of the period in which feet A, B, C slid: they carried
            weight and friction was at its limit.
        lifted_share: (n, N) share of the period in which a foot carried nothing.
        touching_share: (n, N) share of the period in which another robot was touched.
        heading_error: (n, N), rad.
        mode: (n, N) of the steering.
    """

    omega: np.ndarray
    omega_des: np.ndarray
    theta: np.ndarray
    voltage: np.ndarray
    current: np.ndarray
    disturbance: np.ndarray
    position: np.ndarray
    quaternion: np.ndarray
    velocity: np.ndarray
    yaw_rate: np.ndarray
    normal_max: np.ndarray
    friction_max: np.ndarray
    slipping_share: np.ndarray
    lifted_share: np.ndarray
    touching_share: np.ndarray
    heading_error: np.ndarray
    mode: np.ndarray


class RawSamples(NamedTuple):
    """Signals at every tick of a short burst of m ticks; float64, SI units.

    Attributes:
        omega, theta: (m, N, 2), motors D and E.
        position: (m, N, 3) of the centre of mass.
        normal: (m, N, 3) normal forces of A, B, C in N.
        friction: (m, N, 6) friction forces, x and y in the body frame of A, B, C in N.
    """

    omega: np.ndarray
    theta: np.ndarray
    position: np.ndarray
    normal: np.ndarray
    friction: np.ndarray


def new_state(robots: int, obstacles_m: np.ndarray | None = None) -> State:
    """Zero state of N robots, by default without obstacles."""
    exchanged, feet = (MOTORS, 3), (FEET,)
    shapes = [(STATE_SIZE,), (COMMAND_SIZE,), exchanged, exchanged, exchanged, (6,), (MOTORS, 2)]
    arrays = [np.zeros((robots, *shape)) for shape in [*shapes, feet, feet, feet, (), ()]]
    near = np.zeros((robots * (robots - 1) // 2, 2), dtype=np.int64)
    events = np.zeros(robots, dtype=np.int64)
    return State(
        *arrays,
        near=near,
        near_count=np.zeros(1, dtype=np.int64),
        events=events,
        obstacles=np.empty((0, 4)) if obstacles_m is None else obstacles_m,
    )


def new_samples(periods: int, robots: int) -> Samples:
    """Room for the samples of `periods` control periods."""
    motors, feet = (MOTORS,), (FEET,)
    shapes = [motors] * 6 + [(3,), (4,), (3,), (), feet, feet, feet, (), (), (), ()]
    return Samples(*(np.zeros((periods, robots, *shape)) for shape in shapes))


def new_raw_samples(ticks: int, robots: int) -> RawSamples:
    """Room for a burst of `ticks` ticks."""
    shapes = [(MOTORS,), (MOTORS,), (3,), (FEET,), (2 * FEET,)]
    return RawSamples(*(np.zeros((ticks, robots, *shape)) for shape in shapes))

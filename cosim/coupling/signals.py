"""Arrays that a co-simulation lives in: its state, and the signals that are sampled from it.

Records of numpy arrays for the kernels of `cosim.coupling.plant` and `sampling`; no behaviour.
"""

from typing import NamedTuple

import numpy as np

from cosim.onboard.camera import CAMERA_SIZE, FRAME_SIZE, NOISE
from cosim.onboard.estimation import ESTIMATE_SIZE
from cosim.onboard.shield import SHIELD_SIZE
from cosim.onboard.steering import COMMAND_SIZE
from cosim.physics.body_state import BODY_SIGNALS, QUATERNION, STATE_SIZE
from cosim.physics.neighbours import LISTS
from cosim.physics.properties import PROPERTIES

_LINE = 8  # float64 of a cache line, and most lanes of a vector
_MANY_COLUMNS = 128
MOTORS = 2  # D, E
FEET = 3  # A, B, C


def _of_motors(*names: str) -> tuple[str, ...]:
    return tuple(f"{name} of motor {motor}" for name in names for motor in "DE")


# Names of the rows of inputs, outputs and bodies, see `State`.
SIGNALS = (
    *_of_motors("the set point", "the speed noise", "the torque d"),
    *_of_motors("theta", "omega", "omega_dot"),
    *(f"the {name}" for name, size in BODY_SIGNALS for _ in range(size)),
)

# Rows of the statistics of a control period, see `State.statistics`.
NORMAL, IMPACT, SLIPPING, FRICTION = 0, FEET, 2 * FEET, 3 * FEET  # of feet A, B, C each
LIFTED, AIRBORNE = 5 * FEET, 5 * FEET + 1
LANDING = AIRBORNE + 1  # rows from here on outlast the period
STATISTICS = LANDING + FEET


class State(NamedTuple):
    """Variables of K episodes of N robots each; float64 unless said otherwise.

    Robot r of episode e has column e N + r of B; columns beyond are idle, so that B is a whole
    number of vectors. Rows that motors have are those of D, then of E, one signal after the other.
    """

    # (B, ESTIMATE_SIZE) where robots think they are, layout in cosim.onboard.estimation
    estimates: np.ndarray
    cameras: np.ndarray  # (B, CAMERA_SIZE), layout in cosim.onboard.camera
    frames: np.ndarray  # (B, F, FRAME_SIZE) of the camera, under way
    sight: np.ndarray  # (M, B, NOISE) what the camera makes of the robots in the next frames
    bodies: np.ndarray  # (STATE_SIZE, B), layout in cosim.physics.body_state
    properties: np.ndarray  # (PROPERTIES, B), layout in cosim.physics.properties
    commands: np.ndarray  # (B, COMMAND_SIZE), layout in cosim.onboard.steering
    shields: np.ndarray  # (B, SHIELD_SIZE), layout in cosim.onboard.shield
    set_points: np.ndarray  # (2, B) motor speeds that the steering asks for
    inputs: np.ndarray  # (6, B) omega_des (or V_in where motors are in open loop), omega_noise, d
    outputs: np.ndarray  # (6, B) theta, omega, omega_dot
    held: np.ndarray  # (6, B) the outputs at the start of the communication step
    held_velocities: np.ndarray  # (6, B) velocity (world) and angular velocity (body) at that time
    electrical: np.ndarray  # (8, B) V_s, i, u, integral; NaN what an FMU does not have
    # (STATISTICS, B) of this control period: of each foot the sum of normal impulses in N s, the
    # part of it in impacts, ticks in which it slid, and the sums of friction impulses along x and y
    # of the body; ticks in which a foot carried nothing, and in which no foot carried anything;
    # whether a foot landed in this tick. A foot that lands closes its gap in one tick and stops in
    # the next: an impact is both
    statistics: np.ndarray
    # (B,) ticks of this period in which another robot or an obstacle was touched
    touching: np.ndarray
    touched: np.ndarray  # (B,) int64, whether that is so in this tick
    near: np.ndarray  # (K N (N − 1) / 2, 2) int64, columns of pairs that may touch in this period
    # near_robots, near_targets, near_zone: (LISTS, B) int64, room for `cosim.physics.neighbours`
    near_robots: np.ndarray
    near_targets: np.ndarray
    near_zone: np.ndarray
    near_walls: np.ndarray  # (B M, 2) int64, columns and obstacles that may touch in this period
    near_count: np.ndarray  # (2,) int64, how many pairs and how many of the latter there are
    # (B,) int64, of the first column of every vector, whether an episode runs in it
    busy: np.ndarray
    running: np.ndarray  # (K,) int64, whether an episode is running
    periods: np.ndarray  # (K,) int64, control periods that an episode has done in this advance
    # (B,) int64, what became of each robot in its last period, see cosim.coupling.sampling
    events: np.ndarray
    ended: np.ndarray  # (STATE_SIZE, B) bodies of episodes that have ended, as they were then
    boards: np.ndarray  # (K, 2) extent of each episode's board in m, its corner at the origin
    margins_m: np.ndarray  # (K,) distance from the board's edge at which the shield keeps robots
    cells_m: np.ndarray  # (K,) edge of the board's cells
    # (K, M, 4) rectangles left, bottom, right, top in m, which stay; infinitely far where an
    # episode has fewer
    obstacles: np.ndarray
    # (B, F, 4) rectangles likewise, in which the centre of a robot is a collision
    forbidden: np.ndarray
    # (B, 4) rectangles in which the centre of any robot but one is a collision, of each episode in
    # an order of their own
    targets: np.ndarray
    owners: np.ndarray  # (B,) int64, columns of those robots
    # (K, P, 5) rectangles of the floor and their friction coefficients, likewise; later ones cover
    # earlier ones
    patches: np.ndarray


class Samples(NamedTuple):
    """Signals sampled at the end of each of n control periods; float64, SI units.

    N is the number of robots of an episode, or of the columns of a state.

    Attributes:
        omega, omega_des, theta, voltage, current: (n, N, 2), motors D and E.
        omega_dot: (n, N, 2), rad/s².
        noise: (n, N, 2) in each motor's measured speed, rad/s.
        command: (n, N, 2) u of Eq. (14) before saturation, V; NaN if the FMU does not tell.
        integral: (n, N, 2) of the speed error in the controller, rad; likewise.
        disturbance: (n, N, 2) torque of input d in N m.
        position: (n, N, 3) centre of mass in the world.
        quaternion: (n, N, 4) world from body, (w, x, y, z).
        velocity: (n, N, 3) in the world.
        yaw_rate: (n, N).
        normal_mean, friction_mean: (n, N, 3) forces of feet A, B, C, mean over the period, N;
            friction is the size of the mean vector.
        impact: (n, N, 3) normal impulse of feet A, B, C as they landed in the period, N s.
        slipping_share: (n, N, 3) share of the period in which feet A, B, C slid: they carried
            weight and friction was at its limit.
        lifted_share: (n, N) share of the period in which a foot carried nothing.
        airborne_share: (n, N) share of the period in which no foot carried anything.
        touching_share: (n, N) share of the period in which another robot or an obstacle was
            touched.
        heading_error: (n, N), rad.
        mode: (n, N) of the steering.
        estimate: (n, N, 3) where the robot thought it was in the period: x, y in m, heading in rad.
        covariance: (n, N, 6) of the estimate: xx, xy, yy in m², x and y with the heading in m rad,
            and that of the heading in rad²; zeros without a camera.
    """

    omega: np.ndarray
    omega_des: np.ndarray
    theta: np.ndarray
    voltage: np.ndarray
    current: np.ndarray
    omega_dot: np.ndarray
    noise: np.ndarray
    command: np.ndarray
    integral: np.ndarray
    disturbance: np.ndarray
    position: np.ndarray
    quaternion: np.ndarray
    velocity: np.ndarray
    yaw_rate: np.ndarray
    normal_mean: np.ndarray
    friction_mean: np.ndarray
    impact: np.ndarray
    slipping_share: np.ndarray
    lifted_share: np.ndarray
    airborne_share: np.ndarray
    touching_share: np.ndarray
    heading_error: np.ndarray
    mode: np.ndarray
    estimate: np.ndarray
    covariance: np.ndarray


class RawSamples(NamedTuple):
    """Signals at every tick of a short burst of m ticks; float64, SI units.

    Attributes:
        omega, theta: (m, N, 2), motors D and E.
        position: (m, N, 3) of the centre of mass.
        normal: (m, N, 3) normal forces of A, B, C in N, mean over the tick: of a foot that lands,
            its impulse divided by dt.
        friction: (m, N, 6) friction forces, x and y in the body frame of A, B, C in N.
    """

    omega: np.ndarray
    theta: np.ndarray
    position: np.ndarray
    normal: np.ndarray
    friction: np.ndarray


def new_state(episodes: int, robots: int, columns: int) -> State:
    """State without running episodes, on endless floors without obstacles; robots have no mass yet.

    Args:
        episodes: K.
        robots: N of each.
        columns: B, at least K N.
    """

    def whole(*shape: int) -> np.ndarray:
        return np.zeros(shape, dtype=np.int64)

    bodies = aligned(STATE_SIZE, columns)
    bodies[QUATERNION.start] = 1.0
    state = State(
        estimates=np.zeros((columns, ESTIMATE_SIZE)),
        cameras=np.zeros((columns, CAMERA_SIZE)),
        frames=np.zeros((columns, 0, FRAME_SIZE)),
        sight=np.zeros((0, columns, NOISE)),
        bodies=bodies,
        properties=aligned(PROPERTIES, columns),
        commands=np.zeros((columns, COMMAND_SIZE)),
        shields=np.zeros((columns, SHIELD_SIZE)),
        set_points=aligned(MOTORS, columns),
        inputs=aligned(3 * MOTORS, columns),
        outputs=aligned(3 * MOTORS, columns),
        held=aligned(3 * MOTORS, columns),
        held_velocities=aligned(6, columns),
        electrical=aligned(4 * MOTORS, columns),
        statistics=aligned(STATISTICS, columns),
        touching=np.zeros(columns),
        touched=whole(columns),
        near=whole(episodes * robots * (robots - 1) // 2, 2),
        near_robots=whole(LISTS, columns),
        near_targets=whole(LISTS, columns),
        near_zone=whole(LISTS, columns),
        near_walls=whole(0, 2),
        near_count=whole(2),
        busy=whole(columns),
        running=whole(episodes),
        periods=whole(episodes),
        events=whole(columns),
        ended=bodies.copy(),
        boards=np.full((episodes, 2), np.inf),
        margins_m=np.zeros(episodes),
        cells_m=np.ones(episodes),
        obstacles=np.empty((episodes, 0, 4)),
        forbidden=np.empty((columns, 0, 4)),
        targets=np.full((columns, 4), np.inf),
        owners=whole(columns),
        patches=np.empty((episodes, 0, 5)),
    )
    state.electrical[:] = np.nan
    return state


def with_room(
    state: State, obstacles: int = 0, patches: int = 0, forbidden: int = 0, frames: int = 0
) -> State:
    """Copy of a state with room for more rectangles and frames.

    Args:
        state: to be enlarged.
        obstacles, patches: least number of every episode.
        forbidden, frames: least number of every robot.
    """

    def enlarged(array: np.ndarray, count: int, empty: float = np.inf) -> np.ndarray:
        rows, present, size = array.shape
        missing = np.full((rows, max(0, count - present), size), empty)
        return np.concatenate([array, missing], axis=1)

    walls = enlarged(state.obstacles, obstacles)
    return state._replace(
        obstacles=walls,
        near_walls=np.zeros((state.bodies.shape[1] * walls.shape[1], 2), dtype=np.int64),
        patches=enlarged(state.patches, patches),
        forbidden=enlarged(state.forbidden, forbidden),
        frames=enlarged(state.frames, frames, 0.0),
    )


def columns_of(robots: int, lanes: int) -> int:
    """Return the columns of a state of some robots in all, whole vectors of `lanes`.

    Many are an odd number of cache lines: rows at a distance of a power of two would have the
    same few places in the processor's caches.
    """
    columns = -(-robots // lanes) * lanes
    return columns if columns < _MANY_COLUMNS else _LINE * (-(-columns // _LINE) | 1)


def aligned(rows: int, columns: int) -> np.ndarray:
    """Zeros in whole cache lines: a vector across two of them takes twice as long."""
    memory = np.zeros(rows * columns + _LINE - 1)
    first = -(memory.ctypes.data // memory.itemsize) % _LINE
    return memory[first : first + rows * columns].reshape(rows, columns)


def new_samples(periods: int, robots: int) -> Samples:
    """Room for the samples of `periods` control periods."""
    of_motors = ("omega", "omega_des", "theta", "voltage", "current", "omega_dot", "noise")
    of_motors += ("command", "integral", "disturbance")
    of_feet = ("normal_mean", "friction_mean", "impact", "slipping_share")
    shapes = dict.fromkeys(of_motors, (MOTORS,)) | dict.fromkeys(of_feet, (FEET,))
    shapes |= {"position": (3,), "quaternion": (4,), "velocity": (3,)}
    shapes |= {"estimate": (3,), "covariance": (6,)}
    return Samples._make(
        np.zeros((periods, robots, *shapes.get(name, ()))) for name in Samples._fields
    )


def new_raw_samples(ticks: int, robots: int) -> RawSamples:
    """Room for a burst of `ticks` ticks."""
    sizes = {"omega": MOTORS, "theta": MOTORS, "position": 3, "normal": FEET, "friction": 2 * FEET}
    return RawSamples(**{k: np.zeros((ticks, robots, size)) for k, size in sizes.items()})

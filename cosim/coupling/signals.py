"""Arrays that a co-simulation lives in: its state, and the signals that are sampled from it.

Records of numpy arrays for the kernels of `cosim.coupling.plant` and `period`; no behaviour.
"""

import functools
from collections.abc import Callable
from typing import Annotated, Any, NamedTuple, get_type_hints

import numpy as np

from cosim.onboard.state import Floor, Onboard
from cosim.physics.body_state import OF_LEG, QUATERNION, body_signals, legs_row, state_size
from cosim.physics.properties import properties_size

_LINE = 8  # float64 of a cache line, and most lanes of a vector
_MANY_COLUMNS = 128

Sizes = tuple[int, int, int]  # numbers of a robot's motors, of its feet and of its elastic legs
PAPERS: Sizes = 2, 3, 0


def signal_names(motors: str, feet: int, legs: int) -> tuple[str, ...]:
    """Names of the rows of inputs, outputs and bodies, see `State`, of robots with named motors."""
    of_motors = "the set point", "the speed noise", "the torque d", "theta", "omega", "omega_dot"
    return (
        *(f"{name} of motor {motor}" for name in of_motors for motor in motors),
        *(f"the {name}" for name, size in body_signals(feet, legs) for _ in range(size)),
    )


# Rows of the statistics of a control period, see `Bodies.statistics`: of the robot, then of each
# foot at `FOOT * k` from the first ones.
LIFTED, AIRBORNE, UNSOLVED = 0, 1, 2
NORMAL, IMPACT, SLIPPING, FRICTION_X, FRICTION_Y, LANDING = range(3, 9)
FOOT = 6


class MotorSignals(NamedTuple):
    """Rows of the motors: those of D, E and so on, one signal after the other."""

    set_points: Annotated[np.ndarray, "motors", "B"]  # motor speeds that the steering asks for
    # omega_des (or V_in where motors are in open loop), omega_noise, d
    inputs: Annotated[np.ndarray, "3 motors", "B"]
    outputs: Annotated[np.ndarray, "3 motors", "B"]  # theta, omega, omega_dot
    held: Annotated[np.ndarray, "3 motors", "B"]  # outputs at the start of the communication step
    electrical: Annotated[np.ndarray, "4 motors", "B"]  # V_s, i, u, integral; NaN without them


class Bodies(NamedTuple):
    """Bodies of the robots, and what is counted of their feet."""

    motion: Annotated[np.ndarray, "body", "B"]  # layout in cosim.physics.body_state
    properties: Annotated[np.ndarray, "properties", "B"]  # layout in cosim.physics.properties
    # Velocities (world) and angular ones (body) at the start of the communication step
    held_velocities: Annotated[np.ndarray, 6, "B"]
    # Of this control period: ticks in which a foot carried nothing, in which no foot carried
    # anything, and in which contacts were not solved; of each foot the sum of normal impulses in
    # N s, the part of it in impacts, ticks in which it slid, the sums of friction impulses along x
    # and y of the body, and whether it landed in this tick. A foot that lands closes its gap in one
    # tick and stops in the next: an impact is both
    statistics: Annotated[np.ndarray, "statistics", "B"]
    # Ticks since the start in which contacts were not solved, less a share of all ticks
    unsolved: Annotated[np.ndarray, "B"]
    ended: Annotated[np.ndarray, "body", "B"]  # motion of ended episodes, as it was then


class Contacts(NamedTuple):
    """Robots that may touch each other or obstacles in this period."""

    pairs: Annotated[np.ndarray, "pairs", 2, np.int64]  # columns of robots
    walls: Annotated[np.ndarray, 0, 2, np.int64]  # columns of robots, and obstacles
    counts: Annotated[np.ndarray, 2, np.int64]  # how many pairs, and how many of the latter
    touching: Annotated[np.ndarray, "B"]  # ticks of this period with a robot or obstacle touched
    touched: Annotated[np.ndarray, "B", np.int64]  # whether that is so in this tick


class Episodes(NamedTuple):
    """State of the places for episodes."""

    running: Annotated[np.ndarray, "K", np.int64]  # whether an episode is running
    periods: Annotated[np.ndarray, "K", np.int64]  # control periods that it did in this advance
    # What became of each robot in its last period, see `cosim.model.outcome`; or a fault
    events: Annotated[np.ndarray, "B", np.int64]
    # Of the first column of every vector, whether an episode runs in it
    busy: Annotated[np.ndarray, "B", np.int64]


class State(NamedTuple):
    """Variables of K episodes of N robots each; float64 unless said otherwise.

    Robot r of episode e has column e N + r of B; columns beyond are idle, so that B is a whole
    number of vectors. Annotations give the shape; a size of 0 grows by `with_room`.
    """

    motors: MotorSignals
    bodies: Bodies
    contacts: Contacts
    onboard: Onboard
    floor: Floor
    episodes: Episodes


class Samples(NamedTuple):
    """Signals at the end of each of n control periods; float64, SI units.

    Arrays are (n, N) and an axis of the annotated size, if any: motors D, E …, or feet A, B, C …. N
    is the number of robots of an episode, or of the columns of a state.
    """

    omega: Annotated[np.ndarray, "motors"]
    omega_des: Annotated[np.ndarray, "motors"]
    theta: Annotated[np.ndarray, "motors"]
    voltage: Annotated[np.ndarray, "motors"]
    current: Annotated[np.ndarray, "motors"]
    omega_dot: Annotated[np.ndarray, "motors"]
    noise: Annotated[np.ndarray, "motors"]  # in the measured speed, rad/s
    command: Annotated[np.ndarray, "motors"]  # u of Eq. (14) before saturation; NaN if not known
    integral: Annotated[np.ndarray, "motors"]  # of the speed error in the controller; likewise
    disturbance: Annotated[np.ndarray, "motors"]  # torque of input d
    # of the robot's axis at the height of the centre of mass, in the world
    position: Annotated[np.ndarray, 3]
    quaternion: Annotated[np.ndarray, 4]  # world from body, (w, x, y, z)
    velocity: Annotated[np.ndarray, 3]  # of the same, in the world
    yaw_rate: Annotated[np.ndarray, None]
    # normal_mean, friction_mean: forces over the period; friction is the size of the mean vector
    normal_mean: Annotated[np.ndarray, "feet"]
    friction_mean: Annotated[np.ndarray, "feet"]
    impact: Annotated[np.ndarray, "feet"]  # normal impulse of feet as they landed in the period
    # Deflection of the tips of elastic legs at the end of the period, body frame (x, y, z) of each
    deflection: Annotated[np.ndarray, "3 legs"]
    # Share of the period in which feet carried weight and friction was at its limit
    slipping_share: Annotated[np.ndarray, "feet"]
    lifted_share: Annotated[np.ndarray, None]  # of the period in which a foot carried nothing
    airborne_share: Annotated[np.ndarray, None]  # in which no foot carried anything
    touching_share: Annotated[np.ndarray, None]  # in which a robot or an obstacle was touched
    heading_error: Annotated[np.ndarray, None]
    mode: Annotated[np.ndarray, None]  # of the steering
    estimate: Annotated[np.ndarray, 3]  # where the robot thought it was: x, y and heading
    # Of the estimate: xx, xy, yy, x and y with the heading, and heading; zeros without a camera
    covariance: Annotated[np.ndarray, 6]


class RawSamples(NamedTuple):
    """Signals at every tick of a short burst of m ticks: (m, N, annotated size), SI units."""

    omega: Annotated[np.ndarray, "motors"]
    theta: Annotated[np.ndarray, "motors"]
    position: Annotated[np.ndarray, 3]  # as of `Samples`
    # Mean over the tick: of a foot that lands, its impulse divided by dt
    normal: Annotated[np.ndarray, "feet"]
    friction: Annotated[np.ndarray, "2 feet"]  # x and y in the body frame of each foot


@functools.cache
def _annotated(record: type) -> dict[str, tuple[Any, ...]]:
    """Return what the annotations of a record's fields say of their shapes."""
    hints = get_type_hints(record, include_extras=True)
    return {name: hint.__metadata__ for name, hint in hints.items()}


def _numbers(sizes: Sizes) -> dict[Any, Any]:
    motors, feet, legs = sizes
    numbers = {"motors": motors, "3 motors": 3 * motors, "4 motors": 4 * motors, "feet": feet}
    return numbers | {"2 feet": 2 * feet, "3 legs": 3 * legs}


def new_state(episodes: int, robots: int, columns: int, sizes: Sizes = PAPERS) -> State:
    """State without running episodes, on endless floors without obstacles, robots without mass."""
    motors, feet, legs = sizes
    numbers = _numbers(sizes) | {
        "K": episodes,
        "B": columns,
        "pairs": episodes * robots * (robots - 1) // 2,
        "body": state_size(feet, legs),
        "properties": properties_size(feet, motors),
        "statistics": NORMAL + FOOT * feet,
    }
    state = State(*(_zeros(record, numbers) for record in get_type_hints(State).values()))
    state.bodies.motion[QUATERNION.start] = state.bodies.ended[QUATERNION.start] = 1.0
    state.floor.cells_m[:] = 1.0
    state.floor.boards[:] = state.floor.targets[:] = np.inf
    state.motors.electrical[:] = np.nan
    return state


def _zeros(record: type[Any], numbers: dict[Any, Any]) -> Any:
    arrays = []
    for marks in _annotated(record).values():
        shape = tuple(numbers.get(mark, mark) for mark in marks if mark is not np.int64)
        if np.int64 in marks:
            arrays.append(np.zeros(shape, dtype=np.int64))
        else:
            arrays.append(aligned(*shape) if marks[1:] == ("B",) else np.zeros(shape))
    return record._make(arrays)


def each_array(function: Callable[..., np.ndarray], *states: State) -> State:
    """Return the state whose arrays a function makes from those of one or more states."""
    records = zip(*states, strict=True)
    return State(*(type(parts[0])(*map(function, *parts)) for parts in records))


def with_sight(state: State, sight: np.ndarray) -> State:
    """Return a state whose cameras see other frames, (M, B, NOISE)."""
    return state._replace(onboard=state.onboard._replace(sight=sight))


def with_room(
    state: State, obstacles: int = 0, patches: int = 0, forbidden: int = 0, frames: int = 0
) -> State:
    """Copy of a state with room for more rectangles and frames.

    Args:
        obstacles, patches: least number of every episode.
        forbidden, frames: least number of every robot.
    """

    def enlarged(array: np.ndarray, count: int, empty: float = np.inf) -> np.ndarray:
        rows, present, size = array.shape
        missing = np.full((rows, max(0, count - present), size), empty)
        return np.concatenate([array, missing], axis=1)

    walls = enlarged(state.floor.obstacles, obstacles)
    may_touch = np.zeros((len(state.contacts.touched) * walls.shape[1], 2), dtype=np.int64)
    return state._replace(
        contacts=state.contacts._replace(walls=may_touch),
        onboard=state.onboard._replace(frames=enlarged(state.onboard.frames, frames, 0.0)),
        floor=state.floor._replace(
            obstacles=walls,
            patches=enlarged(state.floor.patches, patches),
            forbidden=enlarged(state.floor.forbidden, forbidden),
        ),
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


def sizes_of(state: State) -> Sizes:
    """Return those of a state's robots."""
    motors, bodies = state.motors.set_points.shape[0], state.bodies
    feet = (bodies.statistics.shape[0] - NORMAL) // FOOT
    return motors, feet, (bodies.motion.shape[0] - legs_row(feet)) // OF_LEG


def _room(record: type[Any], rows: int, robots: int, sizes: Sizes) -> Any:
    numbers, axes = _numbers(sizes), (mark for (mark,) in _annotated(record).values())
    return record._make(
        np.zeros((rows, robots) if mark is None else (rows, robots, numbers.get(mark, mark)))
        for mark in axes
    )


def new_samples(periods: int, robots: int, sizes: Sizes = PAPERS) -> Samples:
    """Room for the samples of `periods` control periods."""
    return _room(Samples, periods, robots, sizes)


def new_raw_samples(ticks: int, robots: int, sizes: Sizes = PAPERS) -> RawSamples:
    """Room for a burst of `ticks` ticks."""
    return _room(RawSamples, ticks, robots, sizes)

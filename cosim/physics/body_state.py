"""State of a robot, as a column of an array and as numbers; no equations."""

from typing import NamedTuple

import numpy as np

from cosim.base.jit import inlined, unrolled
from cosim.model.params import RobotParams
from cosim.physics.feet import Impulse, LegState
from cosim.physics.lanes import Width, load, store
from cosim.physics.rotation import Quaternion, Vector, rotation_matrix
from cosim.physics.trig import sine_cosine

# Layout of a body's state, one float64 vector; of many bodies, the rows of an array with a column
# for each.
X, Y, Z = 0, 1, 2  # position of the axis at the height of the centre of mass, world frame, m
Q_W, Q_X, Q_Y, Q_Z = 3, 4, 5, 6  # quaternion, world from body
V_X, V_Y, V_Z = 7, 8, 9  # velocity of the centre of mass, world frame, m/s
W_X, W_Y, W_Z = 10, 11, 12  # angular velocity, body frame, rad/s
NORMALS = 13  # normal impulses of M feet in the last step, N s
# After them: friction impulses of these feet, body frame (x, y, z) each, N s; then of each elastic
# leg its deflection, body frame (x, y, z), and the place (x, y) of its tip, world frame, m
OF_LEG = 5
POSITION, QUATERNION = slice(X, Q_W), slice(Q_W, V_X)
PLANE = slice(X, Z)  # x and y of the position
VELOCITY, ANGULAR_VELOCITY = slice(V_X, W_X), slice(W_X, NORMALS)
# A robot whose axis is more than 60° off the vertical does not return to its feet.
LEAST_UPRIGHT = 0.5


def state_size(feet: int, legs: int = 0) -> int:
    """Length of a state of a body with some feet, of which some are elastic legs."""
    return legs_row(feet) + OF_LEG * legs


def body_signals(feet: int, legs: int = 0) -> tuple[tuple[str, int], ...]:
    """Name and size of each signal of a state, in their order."""
    return (
        ("position", 3),
        ("orientation", 4),
        ("velocity", 3),
        ("angular velocity", 3),
        ("normal impulse", feet),
        ("friction impulse", 3 * feet),
        ("deflection or tip of a leg", OF_LEG * legs),
    )


@inlined
def frictions(feet: int) -> int:
    """First row of the friction impulses of some feet."""
    return NORMALS + feet


@inlined
def legs_row(feet: int) -> int:
    """First row of what elastic legs remember."""
    return NORMALS + 4 * feet


@inlined
def stand(state: np.ndarray, height_m: float, x_m: float, y_m: float, heading_rad: float) -> None:
    """Write the state of a robot at rest on its feet, with its centre of mass at a height.

    Args:
        x_m, y_m: place of its axis.
    """
    for row in range(len(state)):
        state[row] = 0.0
    state[X], state[Y], state[Z] = x_m, y_m, height_m
    sine, cosine = sine_cosine(heading_rad / 2.0)
    state[Q_W], state[Q_Z] = cosine, sine


def standing_state(robot: RobotParams, x_m: float, y_m: float, heading_rad: float) -> np.ndarray:
    """State of a robot at rest on its feet, shape (state_size(M),); elastic legs are not bent."""
    state = np.empty(state_size(len(robot.feet), robot.sizes[2]))
    stand(state, robot.com_height_m, x_m, y_m, heading_rad)
    return state


class Body(NamedTuple):
    """State of one robot, or of the robots in the lanes of a vector; see the layout above."""

    position: Vector  # of the axis at the height of the centre of mass, world frame, m
    orientation: Quaternion  # world from body
    velocity: Vector  # of the centre of mass, world frame, m/s
    omega: Vector  # body frame, rad/s
    impulses: tuple[Impulse, ...]  # impulses of the feet in the last step, body frame, N s
    legs: tuple[LegState, ...]  # of elastic feet, at the end of that step; else none


@inlined
def read_body(
    bodies: np.ndarray, column: int, width: Width, order: tuple[int, ...], legs: tuple
) -> Body:
    """Bodies of (S, B) from a column on, one for every lane; feet in an order.

    Args:
        legs: as many as feet that are elastic.
    """
    impulses, of_legs = _read_feet(bodies, column, width, len(order), order, legs)
    return Body(
        read_vector(bodies, X, column, width),
        (load(bodies, Q_W, column, width), *read_vector(bodies, Q_X, column, width)),
        read_vector(bodies, V_X, column, width),
        read_vector(bodies, W_X, column, width),
        impulses,
        of_legs,
    )


@inlined
def orientation_of(body: np.ndarray) -> Quaternion:
    """Orientation of one body, world from body, by its state (STATE_SIZE,)."""
    return body[Q_W], body[Q_X], body[Q_Y], body[Q_Z]


@inlined
def is_upright(body: np.ndarray) -> bool:
    """Return whether one body has not fallen, by its state (STATE_SIZE,)."""
    return body[Z] >= 0.0 and rotation_matrix(orientation_of(body))[2][2] >= LEAST_UPRIGHT


@unrolled
def _read_feet(
    bodies: np.ndarray, column: int, width: Width, feet: int, order: tuple[int, ...], legs: tuple
) -> tuple[tuple[Impulse, ...], tuple[LegState, ...]]:
    if len(order) == 0:
        return (), ()
    impulses, others = _read_feet(bodies, column, width, feet, order[1:], legs[1:])
    normal = load(bodies, NORMALS + order[0], column, width)
    impulse = normal, read_vector(bodies, frictions(feet) + 3 * order[0], column, width)
    if len(legs) == 0:
        return (impulse, *impulses), ()
    row = legs_row(feet) + OF_LEG * order[0]
    tip = load(bodies, row + 3, column, width), load(bodies, row + 4, column, width)
    return (impulse, *impulses), ((read_vector(bodies, row, column, width), tip), *others)


@inlined
def read_vector(rows: np.ndarray, row: int, column: int, width: Width) -> Vector:
    """Vector of which three rows have the components, from a column on, one for every lane."""
    return (
        load(rows, row, column, width),
        load(rows, row + 1, column, width),
        load(rows, row + 2, column, width),
    )


@inlined
def write_body(
    bodies: np.ndarray, column: int, width: Width, order: tuple[int, ...], body: Body
) -> None:
    """Put bodies back to where `read_body` took them from."""
    _write_vector(bodies, X, column, width, body.position)
    store(bodies, Q_W, column, width, body.orientation[0])
    _write_vector(bodies, Q_X, column, width, body.orientation[1:])
    _write_vector(bodies, V_X, column, width, body.velocity)
    _write_vector(bodies, W_X, column, width, body.omega)
    _write_feet(bodies, column, width, len(order), order, body.impulses, body.legs)


@unrolled
def _write_feet(
    bodies: np.ndarray,
    column: int,
    width: Width,
    feet: int,
    order: tuple[int, ...],
    impulses: tuple[Impulse, ...],
    legs: tuple[LegState, ...],
) -> None:
    if len(order) > 0:
        store(bodies, NORMALS + order[0], column, width, impulses[0][0])
        _write_vector(bodies, frictions(feet) + 3 * order[0], column, width, impulses[0][1])
        if len(legs) > 0:
            row = legs_row(feet) + OF_LEG * order[0]
            _write_vector(bodies, row, column, width, legs[0][0])
            store(bodies, row + 3, column, width, legs[0][1][0])
            store(bodies, row + 4, column, width, legs[0][1][1])
        _write_feet(bodies, column, width, feet, order[1:], impulses[1:], legs[1:])


@inlined
def _write_vector(bodies: np.ndarray, row: int, column: int, width: Width, vector: Vector) -> None:
    store(bodies, row, column, width, vector[0])
    store(bodies, row + 1, column, width, vector[1])
    store(bodies, row + 2, column, width, vector[2])

"""State of a robot, as a column of an array and as numbers; no equations."""

import math
from typing import NamedTuple

import numpy as np

from cosim.base.jit import inlined
from cosim.model.params import RobotParams
from cosim.physics.contact import Impulse
from cosim.physics.lanes import Width, load, store
from cosim.physics.rotation import Quaternion, Vector

# Layout of a body's state, one float64 vector; of many bodies, the rows of an array with a column
# for each.
X, Y, Z = 0, 1, 2  # position of the centre of mass, world frame, m
Q_W, Q_X, Q_Y, Q_Z = 3, 4, 5, 6  # quaternion, world from body
V_X, V_Y, V_Z = 7, 8, 9  # velocity of the centre of mass, world frame, m/s
W_X, W_Y, W_Z = 10, 11, 12  # angular velocity, body frame, rad/s
NORMALS = 13  # normal impulses of feet A, B, C in the last step, N s
FRICTIONS = 16  # friction impulses of A, B, C, body frame (x, y, z) each, N s
STATE_SIZE = 25
POSITION, QUATERNION = slice(X, Q_W), slice(Q_W, V_X)
PLANE = slice(X, Z)  # x and y of the position
VELOCITY, ANGULAR_VELOCITY = slice(V_X, W_X), slice(W_X, NORMALS)
NORMAL_IMPULSE, FRICTION_IMPULSE = slice(NORMALS, FRICTIONS), slice(FRICTIONS, STATE_SIZE)
BODY_SIGNALS = (  # name and size of each
    ("position", 3),
    ("orientation", 4),
    ("velocity", 3),
    ("angular velocity", 3),
    ("normal impulse", 3),
    ("friction impulse", 9),
)


def standing_state(robot: RobotParams, x_m: float, y_m: float, heading_rad: float) -> np.ndarray:
    """State of a robot at rest on its feet, shape (STATE_SIZE,)."""
    state = np.zeros(STATE_SIZE)
    state[POSITION] = x_m, y_m, robot.com_height_m
    state[QUATERNION] = math.cos(heading_rad / 2.0), 0.0, 0.0, math.sin(heading_rad / 2.0)
    return state


class Body(NamedTuple):
    """State of one robot, or of the robots in the lanes of a vector; see the layout above."""

    # position, velocity: of the centre of mass, world frame, m and m/s
    position: Vector
    orientation: Quaternion  # world from body
    velocity: Vector
    omega: Vector  # body frame, rad/s
    # at_a, at_b, at_c: impulses of the last step, body frame, N s
    at_a: Impulse
    at_b: Impulse
    at_c: Impulse


@inlined
def read_body(bodies: np.ndarray, column: int, width: Width) -> Body:
    """Bodies of (STATE_SIZE, B) from a column on, one for every lane."""
    return Body(
        read_vector(bodies, X, column, width),
        (load(bodies, Q_W, column, width), *read_vector(bodies, Q_X, column, width)),
        read_vector(bodies, V_X, column, width),
        read_vector(bodies, W_X, column, width),
        _read_impulse(bodies, 0, column, width),
        (
            load(bodies, NORMALS + 1, column, width),
            read_vector(bodies, FRICTIONS + 3, column, width),
        ),
        (
            load(bodies, NORMALS + 2, column, width),
            read_vector(bodies, FRICTIONS + 6, column, width),
        ),
    )


@inlined
def orientation_of(body: np.ndarray) -> Quaternion:
    """Orientation of one body, world from body, by its state (STATE_SIZE,)."""
    return body[Q_W], body[Q_X], body[Q_Y], body[Q_Z]


@inlined
def _read_impulse(bodies: np.ndarray, foot: int, column: int, width: Width) -> Impulse:
    normal = load(bodies, NORMALS + foot, column, width)
    return normal, read_vector(bodies, FRICTIONS + 3 * foot, column, width)


@inlined
def read_vector(rows: np.ndarray, row: int, column: int, width: Width) -> Vector:
    """Vector of which three rows have the components, from a column on, one for every lane."""
    return (
        load(rows, row, column, width),
        load(rows, row + 1, column, width),
        load(rows, row + 2, column, width),
    )


@inlined
def write_body(bodies: np.ndarray, column: int, width: Width, body: Body) -> None:
    """Put bodies back to where `read_body` took them from."""
    _write_vector(bodies, X, column, width, body.position)
    store(bodies, Q_W, column, width, body.orientation[0])
    _write_vector(bodies, Q_X, column, width, body.orientation[1:])
    _write_vector(bodies, V_X, column, width, body.velocity)
    _write_vector(bodies, W_X, column, width, body.omega)
    normal = (body.at_a[0], body.at_b[0], body.at_c[0])
    _write_vector(bodies, NORMALS, column, width, normal)
    _write_vector(bodies, FRICTIONS, column, width, body.at_a[1])
    _write_vector(bodies, FRICTIONS + 3, column, width, body.at_b[1])
    _write_vector(bodies, FRICTIONS + 6, column, width, body.at_c[1])


@inlined
def _write_vector(bodies: np.ndarray, row: int, column: int, width: Width, vector: Vector) -> None:
    store(bodies, row, column, width, vector[0])
    store(bodies, row + 1, column, width, vector[1])
    store(bodies, row + 2, column, width, vector[2])

"""Vectors and unit quaternions as tuples of floats: numba kernels and nothing else.

A quaternion (w, x, y, z) and its matrix turn body-frame components into world-frame ones.
"""

import math

import numpy as np

from cosim.base.jit import inlined, kernel
from cosim.physics.lanes import select
from cosim.physics.trig import angle_of

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]
Matrix = tuple[Vector, Vector, Vector]


@inlined
def dot(a: Vector, b: Vector) -> float:
    """Scalar product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@inlined
def cross(a: Vector, b: Vector) -> Vector:
    """Vector product."""
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


@inlined
def plus(a: Vector, scale: float, b: Vector) -> Vector:
    """The sum a + scale·b."""
    return a[0] + scale * b[0], a[1] + scale * b[1], a[2] + scale * b[2]


@inlined
def scaled(scale: float, v: Vector) -> Vector:
    """The vector times a number."""
    return scale * v[0], scale * v[1], scale * v[2]


@inlined
def either(condition: bool, yes: Vector, no: Vector) -> Vector:
    """One of two vectors, in each lane."""
    return (
        select(condition, yes[0], no[0]),
        select(condition, yes[1], no[1]),
        select(condition, yes[2], no[2]),
    )


@inlined
def rotation_matrix(q: Quaternion) -> Matrix:
    """Rotation matrix world_from_body, row by row, of a unit quaternion."""
    w, x, y, z = q
    return (
        (1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)),
        (2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)),
        (2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)),
    )


@inlined
def to_world(m: Matrix, v: Vector) -> Vector:
    """World-frame components of a body-frame vector."""
    return dot(m[0], v), dot(m[1], v), dot(m[2], v)


@inlined
def to_centre(m: Matrix, centre: tuple[float, float]) -> Vector:
    """World-frame components of a place (x, y) of the body, as that of the centre of mass."""
    x, y = centre
    return m[0][0] * x + m[0][1] * y, m[1][0] * x + m[1][1] * y, m[2][0] * x + m[2][1] * y


@inlined
def to_body(m: Matrix, v: Vector) -> Vector:
    """Body-frame components of a world-frame vector."""
    return (
        m[0][0] * v[0] + m[1][0] * v[1] + m[2][0] * v[2],
        m[0][1] * v[0] + m[1][1] * v[1] + m[2][1] * v[2],
        m[0][2] * v[0] + m[1][2] * v[1] + m[2][2] * v[2],
    )


@inlined
def rotated(q: Quaternion, r: Vector) -> Quaternion:
    """Quaternion after the body-frame rotation with Cayley vector r = ω dt.

    The factor (1, r/2), normalised, is the Cayley map of r: paired with the implicit midpoint rule
    for ω it keeps the angular momentum of a free body (up to rounding).
    """
    w, x, y, z = q
    rx, ry, rz = 0.5 * r[0], 0.5 * r[1], 0.5 * r[2]
    nw = w - x * rx - y * ry - z * rz
    nx = x + w * rx + y * rz - z * ry
    ny = y + w * ry + z * rx - x * rz
    nz = z + w * rz + x * ry - y * rx
    # One Newton step for 1/√(square): the square differs from 1 by |r|²/4, the error is below |r|⁴.
    scale = 1.5 - 0.5 * (nw * nw + nx * nx + ny * ny + nz * nz)
    return nw * scale, nx * scale, ny * scale, nz * scale


@inlined
def heading(q: Quaternion) -> float:
    """Angle in rad, in [−π, π], from the world's x axis to the body's x axis seen from above."""
    w, x, y, z = q
    return angle_of(2.0 * (x * y + w * z), 1.0 - 2.0 * (y * y + z * z))


@inlined
def wrapped(angle: float) -> float:
    """The angle in rad brought into [−π, π)."""
    return angle - 2.0 * math.pi * math.floor(angle / (2.0 * math.pi) + 0.5)


def headings(quaternions: np.ndarray) -> np.ndarray:
    """Heading in rad of each of the quaternions (…, 4), with the same bits on every processor.

    numpy's trigonometric functions round otherwise where a processor has wider vectors.
    """
    flat = np.ascontiguousarray(quaternions).reshape(-1, 4)
    return _headings(flat).reshape(quaternions.shape[:-1])


@kernel
def _headings(quaternions: np.ndarray) -> np.ndarray:
    found = np.empty(len(quaternions))
    for k in range(len(quaternions)):
        q = quaternions[k]
        found[k] = heading((q[0], q[1], q[2], q[3]))
    return found

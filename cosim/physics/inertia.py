"""One rigid body without contacts: its constants, and how moments turn it (left side of Eq. 2)."""

from typing import Any, NamedTuple

from cosim.base.jit import inlined
from cosim.physics.feet import Feet
from cosim.physics.rotation import Vector, cross, plus


class BodyParams(NamedTuple):
    """Constants of one robot's equations of motion, or of those in lanes; SI units, body frame."""

    inverse_mass: float  # 1/kg
    # inertia, inverse_inertia: moments in kg m², and the diagonal of the inverse tensor
    inertia: Vector
    inverse_inertia: Vector
    # product, inverse_product: elements xy of both tensors
    product: float
    inverse_product: float
    centre: tuple[float, float]  # x and y of the centre of mass from the robot's axis in m
    off_axis: bool  # whether it is not on the axis, of any lane; products are zero where it is not
    gravity: Vector  # in the world frame, m/s²
    restitution: float  # of the feet: share of the speed of an impact with which they leave
    bounces: bool  # whether it is not zero, of any lane
    # dt, inverse_dt: step in s and its inverse
    dt: float
    inverse_dt: float
    feet: Feet
    contact: Any  # parameters of a law of contact, see `cosim.physics.contact`


@inlined
def about_centre(moment: Vector, force: Vector, params: BodyParams) -> Vector:
    """Moment about the centre of mass, from that about the robot's axis at its height: − s × f."""
    x, y = params.centre
    if params.off_axis:
        moment = (
            moment[0] - y * force[2],
            moment[1] + x * force[2],
            moment[2] - (x * force[1] - y * force[0]),
        )
    return moment


@inlined
def at_axis(velocity: Vector, omega: Vector, params: BodyParams) -> Vector:
    """Velocity of the robot's axis at the height of the centre of mass, body frame: v − ω × s."""
    x, y = params.centre
    if params.off_axis:
        velocity = (
            velocity[0] + y * omega[2],
            velocity[1] - x * omega[2],
            velocity[2] - (y * omega[0] - x * omega[1]),
        )
    return velocity


@inlined
def times(diagonal: Vector, product: float, v: Vector, params: BodyParams) -> Vector:
    """Product of a tensor, with xy as its only other element, and a vector."""
    x, y, z = diagonal[0] * v[0], diagonal[1] * v[1], diagonal[2] * v[2]
    if params.off_axis:
        x, y = x + product * v[1], y + product * v[0]
    return x, y, z


@inlined
def spun(omega: Vector, params: BodyParams) -> Vector:
    """Angular velocity after dt without any moment: I ω̇ + ω × I ω = 0 of Eq. (2), body frame.

    Implicit midpoint rule; two fixed-point iterations leave an error of (|ω| dt)³, which is below
    rounding for any speed a robot reaches.
    """
    dt = params.dt
    middle = omega
    after = omega
    for _ in range(2):
        spin = times(params.inertia, params.product, middle, params)
        # Eq. (2), left side
        after = turned(omega, dt, cross(spin, middle), params)
        middle = (
            0.5 * (omega[0] + after[0]),
            0.5 * (omega[1] + after[1]),
            0.5 * (omega[2] + after[2]),
        )
    return after


@inlined
def turned(omega: Vector, dt: float, moment: Vector, params: BodyParams) -> Vector:
    """The angular velocity after a moment has acted for dt."""
    x, y, z = params.inverse_inertia
    inverse = (dt * x, dt * y, dt * z)
    return plus(omega, 1.0, times(inverse, dt * params.inverse_product, moment, params))

"""One rigid robot on the floor: Newton–Euler equations (Eq. 2) with contacts at its feet.

Semi-implicit Euler with step dt: velocities first (applied wrench, gyroscopic moment by the
implicit midpoint rule, contact impulses), then the pose with the new velocities. The velocity is
the centre of mass's in the world frame and the angular velocity is kept in the body frame, so that
a free body keeps its momenta to rounding. The position is that of the robot's axis, to which all
geometry refers: feet, motors, the outline and what sees it. The caller owns time and forces.
"""

from typing import Any

from cosim.base.jit import by_class, inlined
from cosim.physics.body_state import Body
from cosim.physics.contact import elastic, rigid
from cosim.physics.inertia import BodyParams, about_centre, spun, turned
from cosim.physics.rotation import (
    Vector,
    plus,
    rotated,
    rotation_matrix,
    scaled,
    to_body,
    to_centre,
    to_world,
)

_response: Any = by_class({rigid.Rigid: rigid.response, elastic.Elastic: elastic.response})


@inlined
def stepped(body: Body, params: BodyParams, force: Vector, moment: Vector) -> tuple[Body, bool]:
    """The body after dt (Eq. 2), and whether its contacts did not converge within their sweeps.

    Args:
        force: applied force without gravity and contacts, body frame, N.
        moment: applied moment about the axis at the height of the centre of mass, body frame, N m.
    """
    dt = params.dt
    world_from_body = rotation_matrix(body.orientation)

    # Eq. (2): M v̇ = R Σ f, before contacts and seen from the body.
    free_velocity = plus(
        to_body(world_from_body, plus(body.velocity, dt, params.gravity)),
        dt * params.inverse_mass,
        force,
    )
    spun_omega = spun(body.omega, params)
    free_omega = turned(spun_omega, dt, about_centre(moment, force, params), params)
    # What a free body turns by: the mean of before and after, which with the Cayley map of
    # `rotated` keeps the angular momentum. Moments and impulses act before the turn.
    half_spin = plus(body.omega, -1.0, spun_omega)

    omega, total, impulses, legs, unsolved = _response(
        params.contact, params, body, world_from_body, free_velocity, free_omega
    )
    velocity = plus(body.velocity, dt, params.gravity)
    velocity = plus(
        velocity, params.inverse_mass, to_world(world_from_body, plus(total, dt, force))
    )
    turning = plus(omega, 0.5, half_spin)
    orientation = rotated(body.orientation, scaled(dt, turning))
    position = plus(body.position, dt, velocity)
    if params.off_axis:  # the axis turns about the centre of mass
        before = to_centre(world_from_body, params.centre)
        after = to_centre(rotation_matrix(orientation), params.centre)
        position = plus(position, 1.0, plus(before, -1.0, after))
    return Body(position, orientation, velocity, omega, impulses, legs), unsolved

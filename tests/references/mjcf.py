"""Write the robots as a MuJoCo model, to compare the contact physics with another engine.

Only the mechanics: a rigid body on its feet, a floor with Coulomb friction, and six actuators per
robot that apply a wrench in the body frame, on its axis at the height of the centre of mass. MuJoCo
itself is not needed to write the text. Its contacts are soft: the settings below keep them stiff
and still resolved.
"""

import importlib
from collections.abc import Sequence
from typing import Any

import numpy as np

from cosim.base.jit import kernel
from cosim.machine.identification.simulated import Machine
from cosim.model.params import MotorParams, RobotParams, cylinder_inertia
from cosim.physics.feet import foot_positions
from cosim.physics.forces import MotorMount, motor_mounts, motor_wrench
from cosim.physics.lanes import width_of
from cosim.physics.rotation import headings

# A foot is a ball so small that its rolling does not count (0.1 mm; feet stand 23 mm apart).
FOOT_BALL_M = 1e-4
# Fraction of a constraint that MuJoCo enforces; it clips at 0.9999.
IMPEDANCE = 0.9999
# Time constant of a contact in steps. MuJoCo takes 2 and more; below some ten a landing foot is not
# resolved and mean speeds with lifting feet are up to 8 % off, at any step (docs/physics.md).
CONTACT_STEPS = 10.0
# Ratio of friction to normal stiffness: holds sticking feet as tightly as rigid friction does.
FRICTION_TO_NORMAL = 100.0
_ONE = width_of(1)


def robots_mjcf(
    robot: RobotParams, motor: MotorParams, positions_m: Sequence[tuple[float, float]], dt_s: float
) -> str:
    """MuJoCo XML model of robots at rest on the floor, heading along x.

    Every robot has a free joint and the actuators (f_X, f_Y, f_Z, n_X, n_Y, n_Z).
    """
    contact = (
        f'solref="{CONTACT_STEPS * dt_s!r} 1" solimp="{IMPEDANCE} {IMPEDANCE} 1e-6" condim="3" '
        f'priority="1"'
    )
    inertia = " ".join(repr(moment) for moment in cylinder_inertia(robot))
    feet = "\n".join(
        f'      <geom type="sphere" size="{FOOT_BALL_M!r}" '
        f'pos="{x!r} {y!r} {z + FOOT_BALL_M!r}" contype="0" conaffinity="1" {contact} '
        f'friction="{robot.mu if foot.mu is None else foot.mu!r} 0 0"/>'
        for foot, (x, y, z) in zip(robot.feet, foot_positions(robot).tolist(), strict=True)
    )
    bodies = "\n".join(
        f'    <body name="robot_{i}" pos="{x!r} {y!r} {robot.com_height_m!r}">\n'
        f"      <freejoint/>\n"
        f'      <inertial pos="{robot.com_x_m!r} {robot.com_y_m!r} 0" mass="{robot.mass_kg!r}" '
        f'diaginertia="{inertia}"/>\n'
        f'      <site name="centre_{i}"/>\n'
        f"{feet}\n"
        f"    </body>"
        for i, (x, y) in enumerate(positions_m)
    )
    actuators = "\n".join(
        f'    <motor site="centre_{i}" gear="{" ".join(str(int(k == axis)) for k in range(6))}"/>'
        for i in range(len(positions_m))
        for axis in range(6)
    )
    return f"""<mujoco model="minirobots">
  <option timestep="{dt_s!r}" gravity="0 0 {-motor.g!r}" cone="elliptic"
          impratio="{FRICTION_TO_NORMAL!r}" solver="Newton" integrator="Euler"/>
  <worldbody>
    <geom type="plane" size="1 1 1" contype="1" conaffinity="0"/>
{bodies}
  </worldbody>
  <actuator>
{actuators}
  </actuator>
</mujoco>
"""


def mujoco_track(
    machine: Machine, omega: np.ndarray, ticks: int, dt_s: float, every: int
) -> np.ndarray:
    """Track (P // every + 1, 3) of a machine in MuJoCo; arguments as of `tracks`, of one robot."""
    mujoco: Any = importlib.import_module("mujoco")  # without type information
    rollout: Any = importlib.import_module("mujoco.rollout")
    robot, motors = machine
    model = mujoco.MjModel.from_xml_string(robots_mjcf(robot, motors[0], [(0.0, 0.0)], dt_s))
    data, kind = mujoco.MjData(model), mujoco.mjtState.mjSTATE_FULLPHYSICS
    state = np.empty(mujoco.mj_stateSize(model, kind))
    mujoco.mj_getState(model, data, state, kind)
    mounts, angles = motor_mounts(robot, motors), np.zeros(len(motors))
    poses, wrenches = [state[1:8]], np.empty((every * ticks, 6))
    for first in range(0, len(omega) - every, every):
        _fill(mounts, omega[first : first + every + 1], dt_s, angles, wrenches)
        states, _ = rollout.rollout(model, data, state[None], wrenches[None])
        state = np.asarray(states)[0, -1]
        # Full physics state: time, position, quaternion, velocities.
        poses.append(state[1:8])
    found = np.array(poses)
    return np.column_stack([found[:, :2], np.unwrap(headings(found[:, 3:]))])


@kernel
def _fill(
    mounts: tuple[MotorMount, ...],
    omega: np.ndarray,
    dt_s: float,
    angles: np.ndarray,
    wrenches: np.ndarray,
) -> None:
    """Write force and moment of every tick of some periods, (ticks, 6); turn the motors' angles."""
    wrenches[:] = 0.0
    ticks = len(wrenches) // (len(omega) - 1)
    for k in range(len(wrenches)):
        start, end, share = omega[k // ticks], omega[k // ticks + 1], (k % ticks + 1) / ticks
        for motor in range(len(mounts)):
            change = (end[motor] - start[motor]) / ticks
            speed = start[motor] + share * (end[motor] - start[motor])
            angles[motor] += dt_s * (speed - 0.5 * change)
            force, moment = motor_wrench(mounts[motor], angles[motor], speed, change / dt_s)
            for axis in range(3):
                wrenches[k, axis] += force[axis]
                wrenches[k, 3 + axis] += moment[axis]

"""Write the robots as a MuJoCo model, to compare the contact physics with another engine.

Only the mechanics: a rigid body on three feet, a floor with Coulomb friction, and six actuators
per robot that apply a wrench in the body frame at the centre of mass. MuJoCo itself is not needed
to write the text. Its contacts are soft: the settings below keep them stiff and still resolved.
"""

from collections.abc import Sequence

from cosim.model.params import MotorParams, RobotParams, cylinder_inertia
from cosim.physics.contact import foot_positions

# A foot is a ball so small that its rolling does not count (0.1 mm; feet stand 23 mm apart).
FOOT_BALL_M = 1e-4
# Fraction of a constraint that MuJoCo enforces; it clips at 0.9999.
IMPEDANCE = 0.9999
# Time constant of a contact in steps. MuJoCo takes 2 and more; below some ten a landing foot is not
# resolved and mean speeds with lifting feet are up to 8 % off, at any step (docs/physics.md).
CONTACT_STEPS = 10.0
# Ratio of friction to normal stiffness: holds sticking feet as tightly as rigid friction does.
FRICTION_TO_NORMAL = 100.0


def robots_mjcf(
    robot: RobotParams, motor: MotorParams, positions_m: Sequence[tuple[float, float]], dt_s: float
) -> str:
    """MuJoCo XML model of robots at rest on the floor, heading along x.

    Every robot has a free joint and the actuators (f_X, f_Y, f_Z, n_X, n_Y, n_Z).
    """
    contact = (
        f'solref="{CONTACT_STEPS * dt_s!r} 1" solimp="{IMPEDANCE} {IMPEDANCE} 1e-6" condim="3" '
        f'friction="{robot.mu!r} 0 0" priority="1"'
    )
    inertia = " ".join(repr(moment) for moment in cylinder_inertia(robot))
    feet = "\n".join(
        f'      <geom type="sphere" size="{FOOT_BALL_M!r}" '
        f'pos="{x!r} {y!r} {z + FOOT_BALL_M!r}" contype="0" conaffinity="1" {contact}/>'
        for x, y, z in foot_positions(robot).tolist()
    )
    bodies = "\n".join(
        f'    <body name="robot_{i}" pos="{x!r} {y!r} {robot.com_height_m!r}">\n'
        f"      <freejoint/>\n"
        f'      <inertial pos="0 0 0" mass="{robot.mass_kg!r}" diaginertia="{inertia}"/>\n'
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

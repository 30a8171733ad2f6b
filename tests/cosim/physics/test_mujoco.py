"""The same robot in MuJoCo and on springs: other contact models, the same mean motion.

Three models of one contact: impulses on rigid feet (ours), MuJoCo's soft convex contacts, and
Kelvin–Voigt springs with plain Coulomb friction integrated with steps a tenth as long. While all
feet stay down all agree to 1 %. Where feet lift and land, MuJoCo stays within 3.5 % (its landings
take some ten steps; with smaller steps it comes closer), and the springs, what real stiff feet do,
still agree with ours to 1 %.
"""

import importlib
import math
from typing import Any

import numpy as np
import pytest

from benchmarks.machines import machine
from cosim.base.jit import kernel
from cosim.machine.identification.simulated import Machine, tracks
from cosim.model.params import TABLE_I, TABLE_II, motors_of
from cosim.physics.feet import foot_positions
from cosim.physics.rotation import cross, plus, rotated, rotation_matrix, to_body, to_world
from tests.references.mjcf import mujoco_track, robots_mjcf
from tests.references.prescribed import Drive, Rig, drive_wrench, mean_motion, rig

# Compiled modules without type information.
mujoco: Any = importlib.import_module("mujoco")
rollout: Any = importlib.import_module("mujoco.rollout")

DT = 5e-6
SETTLE_S = 0.1
OPERATING_POINTS = {
    "forwards in phase": Drive(-880.0, 880.0),
    "turning in phase": Drive(900.0, 900.0),
    "forwards, a quarter turn apart": Drive(-900.0, 900.0, 0.0, math.pi / 2.0),
    "turning, half a turn apart": Drive(900.0, 900.0, 0.0, math.pi),
    "forwards, feet lifting": Drive(-1050.0, 1050.0),
}
ALL_FEET_DOWN = ("forwards in phase", "turning in phase")
FEET = foot_positions(TABLE_I)


@kernel
def fill_wrenches(rig: Rig, drive: Drive, wrenches: np.ndarray) -> None:
    for k in range(wrenches.shape[0]):
        force, moment = drive_wrench(rig, drive, k + 1)
        for axis in range(3):
            wrenches[k, axis], wrenches[k, 3 + axis] = force[axis], moment[axis]


def whole_turns_s(drive: Drive, duration_s: float) -> float:
    turn_s = 2.0 * math.pi / abs(drive.omega_e)
    return round(duration_s / turn_s) * turn_s


def mujoco_means(drive: Drive, duration_s: float) -> tuple[float, float, float]:
    """Mean velocity along the heading and to its left, m/s, and yaw rate, rad/s."""
    model = mujoco.MjModel.from_xml_string(robots_mjcf(TABLE_I, TABLE_II, [(0.0, 0.0)], DT))
    data = mujoco.MjData(model)
    kind = mujoco.mjtState.mjSTATE_FULLPHYSICS
    start = np.empty(mujoco.mj_stateSize(model, kind))
    mujoco.mj_getState(model, data, start, kind)
    settle = round(SETTLE_S / DT)
    wrenches = np.empty((settle + round(whole_turns_s(drive, duration_s) / DT), 6))
    fill_wrenches(rig(TABLE_I, TABLE_II, DT), drive, wrenches)
    states, _ = rollout.rollout(model, data, start[None], wrenches[None])
    # Full physics state: time, qpos (position, quaternion), qvel (linear in the world, angular).
    w, x, y, z = np.asarray(states)[0, settle:, 4:8].T
    angle = np.unwrap(np.arctan2(2.0 * (x * y + w * z), 1.0 - 2.0 * (y * y + z * z)))
    vx, vy = np.asarray(states)[0, settle:, 8:10].T
    forward = np.mean(np.cos(angle) * vx + np.sin(angle) * vy)
    lateral = np.mean(np.cos(angle) * vy - np.sin(angle) * vx)
    turned = (angle[-1] - angle[0]) / ((len(angle) - 1) * DT)
    return float(forward), float(lateral), float(turned)


@kernel
def _sprung(
    rig: Rig,
    drive: Drive,
    settle: int,
    ticks: int,
    stiffness: float,
    damping: float,
    slow: float,
    feet: np.ndarray,
    means: np.ndarray,
) -> None:
    body = rig.body
    dt, gravity, mass = body.dt, body.gravity, 1.0 / body.inverse_mass
    position = (0.0, 0.0, -feet[0, 2] + mass * gravity[2] / (3.0 * stiffness))
    orientation, v, omega = (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    means[:] = 0.0
    for tick in range(1, settle + ticks + 1):
        force, moment = drive_wrench(rig, drive, tick)
        world_from_body = rotation_matrix(orientation)
        total = plus(to_world(world_from_body, force), mass, gravity)
        for i in range(3):
            arm = (feet[i, 0], feet[i, 1], feet[i, 2])
            gap = position[2] + to_world(world_from_body, arm)[2]
            moved = plus(v, 1.0, to_world(world_from_body, cross(omega, arm)))
            normal = max(0.0, -stiffness * gap - damping * moved[2])
            if gap < 0.0 and normal > 0.0:
                # Friction grows linearly with the slip up to a speed that hardly counts.
                drag = -body.feet.mu[i] * normal / max(slow, math.hypot(moved[0], moved[1]))
                at_foot = (drag * moved[0], drag * moved[1], normal)
                total = plus(total, 1.0, at_foot)
                moment = plus(moment, 1.0, cross(arm, to_body(world_from_body, at_foot)))
        v = plus(v, dt * body.inverse_mass, total)
        # Gyroscopic moments of a body that hardly turns are left out: 1e-6 of the others.
        omega = (
            omega[0] + dt * body.inverse_inertia[0] * moment[0],
            omega[1] + dt * body.inverse_inertia[1] * moment[1],
            omega[2] + dt * body.inverse_inertia[2] * moment[2],
        )
        position = plus(position, dt, v)
        orientation = rotated(orientation, (dt * omega[0], dt * omega[1], dt * omega[2]))
        if tick > settle:
            c, s = world_from_body[0][0], world_from_body[1][0]
            means[0] += (c * v[0] + s * v[1]) / ticks
            means[1] += (c * v[1] - s * v[0]) / ticks
            means[2] += omega[2] / ticks


def sprung_means(drive: Drive, duration_s: float) -> tuple[float, float, float]:
    """As `mujoco_means`, on feet with a natural frequency of 8 kHz and critical damping."""
    dt, natural = 5e-7, 5e4
    part = TABLE_I.mass_kg / 3.0
    means = np.empty(3)
    constants = rig(TABLE_I, TABLE_II, dt)
    ticks = round(whole_turns_s(drive, duration_s) / dt)
    stiffness, damping = part * natural**2, 2.0 * part * natural
    settle = round(SETTLE_S / dt)
    _sprung(constants, drive, settle, ticks, stiffness, damping, 1e-5, FEET, means)
    return float(means[0]), float(means[1]), float(means[2])


def assert_close(
    ours: tuple[float, float, float], theirs: tuple[float, float, float], tolerance: float
) -> None:
    """Velocities and yaw rate relative to themselves; below 0.05 mm/s and 0.1 °/s all is zero.

    The numbers printed stand in docs/physics.md (`pytest -rP`).
    """
    for motion in (ours, theirs):
        speeds = [f"{1e3 * v:.3f}" for v in motion[:2]]
        print(f"{', '.join(speeds)} mm/s, {math.degrees(motion[2]):.3f} deg/s")
    speed = math.hypot(theirs[0], theirs[1])
    assert math.dist(ours[:2], theirs[:2]) < tolerance * speed + 5e-5
    assert ours[2] == pytest.approx(theirs[2], rel=tolerance, abs=math.radians(0.1))


@pytest.mark.ci
@pytest.mark.parametrize("of_others", [mujoco_means, sprung_means])
@pytest.mark.parametrize(
    "duration_s", [pytest.param(0.3, id="short"), pytest.param(2.0, marks=pytest.mark.slow)]
)
@pytest.mark.parametrize("name", OPERATING_POINTS)
def test_mean_motion_agrees_with_mujoco_and_stiff_springs(name, duration_s, of_others):
    drive = OPERATING_POINTS[name]
    lands = of_others is mujoco_means and name not in ALL_FEET_DOWN
    how = {"dt_s": DT, "settle_s": SETTLE_S, "duration_s": duration_s}
    ours = mean_motion(TABLE_I, TABLE_II, drive, **how)[:3]
    assert_close(ours, of_others(drive, duration_s), 0.035 if lands else 0.01)


TURN_MS = 7  # looks at the same phase of the motors see no vibration
# Motors and feet, senses of the motors at 898 rad/s, and tolerances of velocity and yaw rate.
# MuJoCo's soft contacts make a robot that turns creep along its shafts, by 0.05 mm/s, and less with
# stiffer ones (0.04 and 0.03 mm/s with a half and a quarter of the step): that is what one motor
# alone differs by (3.3 and 4.6 %). The machine with three motors lifts feet as it drives (2.6 %).
OTHER_MACHINES = [
    ((2, 4), (-1, 1), 0.02, 0.02),
    ((2, 4), (1, 1), 0.02, 0.02),
    ((2, 4), (1, 0), 0.06, 0.02),
    ((3, 3), (0, -1, 1), 0.045, 0.02),
    ((3, 3), (1, 1, 1), 0.02, 0.02),
    ((3, 3), (1, 0, 0), 0.045, 0.02),
]


@pytest.mark.long
@pytest.mark.parametrize(("sizes", "senses", "speed", "yaw"), OTHER_MACHINES)
def test_machines_with_other_motors_and_feet_move_as_in_mujoco(sizes, senses, speed, yaw):
    config = machine(*sizes)
    robot = Machine(config.robot, motors_of(config.robot, config.motor))
    omega = np.tile(2e3 * math.pi / TURN_MS * np.array(senses), (40 * TURN_MS + 1, 1))
    given = omega, round(1e-3 / DT), DT, TURN_MS
    ours, theirs = tracks([robot], *given)[:, 0], mujoco_track(robot, *given)
    means = []
    for poses in (ours[15:], theirs[15:]):
        steps = np.diff(poses[:, 0] + 1j * poses[:, 1])
        middle = 0.5 * (poses[1:, 2] + poses[:-1, 2])
        velocity = np.mean(steps * np.exp(-1j * middle)) / (1e-3 * TURN_MS)
        means.append((velocity, np.mean(np.diff(poses[:, 2])) / (1e-3 * TURN_MS)))
        print(f"{1e3 * velocity:.3f} mm/s, {math.degrees(means[-1][1]):.3f} deg/s")
    assert abs(means[0][0] - means[1][0]) < speed * abs(means[1][0]) + 1e-8
    assert means[0][1] == pytest.approx(means[1][1], rel=yaw, abs=1e-6)


def test_robots_stand_in_mujoco_as_they_stand_here():
    """Two robots: mass, inertia and feet are ours, and they stay where they are."""
    positions = [(0.0, 0.0), (0.1, 0.05)]
    model = mujoco.MjModel.from_xml_string(robots_mjcf(TABLE_I, TABLE_II, positions, 1e-5))
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, nstep=2000)
    assert model.nu == 12
    assert data.ncon == 6
    for i, (x, y) in enumerate(positions):
        qpos = data.qpos[7 * i : 7 * i + 3]
        np.testing.assert_allclose(qpos, [x, y, TABLE_I.com_height_m], atol=1e-8)

"""Elastic legs against closed forms, laws of mechanics, another integrator and rigid feet."""

import math
from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cosim.base.errors import UserError
from cosim.base.jit import kernel
from cosim.machine.identification.track import excitation
from cosim.machine.platform.motion import robot_platform
from cosim.model.config import CoSimConfig
from cosim.model.params import TABLE_I, TABLE_II, Leg, RobotParams
from cosim.model.preset import find_preset
from cosim.model.world import World
from cosim.physics.body import stepped
from cosim.physics.body_state import (
    NORMALS,
    VELOCITY,
    W_X,
    X,
    Z,
    frictions,
    legs_row,
    read_body,
    standing_state,
    state_size,
    write_body,
)
from cosim.physics.contact import elastic
from cosim.physics.feet import foot_positions
from cosim.physics.inertia import BodyParams
from cosim.physics.lanes import Width, width_of
from cosim.physics.mass import mass_of
from cosim.physics.properties import body_params
from tests.cosim.physics.test_generated import DT, FEW, params_of
from tests.generated import Machine, legged
from tests.references.prescribed import Drive, coast, energy, mean_motion, push, turning

LEGS = 4  # of machines that are drawn: kernels are compiled for each number
LEG = Leg(25.0, 150.0, 60_000.0, 4_000.0, 2e-3, 0.01)


def on(leg: Leg, robot: RobotParams = TABLE_I) -> RobotParams:
    """The paper's robot, or another, on legs that are all alike."""
    return robot._replace(feet=tuple(foot._replace(leg=leg) for foot in robot.feet))


def compliance(leg: Leg) -> np.ndarray:
    return np.linalg.inv(elastic.stiffness(leg))


def legs_of(state: np.ndarray, feet: int) -> np.ndarray:
    """Deflections of legs (M, 3) in m."""
    return state[legs_row(feet) :].reshape(feet, 5)[:, :3]


def bent(state: np.ndarray, robot: RobotParams) -> float:
    """Elastic energy of all legs in J."""
    deflections = legs_of(state, len(robot.feet))
    legs = [foot.leg for foot in robot.feet if foot.leg]
    return sum(
        0.5 * d @ elastic.stiffness(leg) @ d for leg, d in zip(legs, deflections, strict=True)
    )


@pytest.mark.long
@pytest.mark.parametrize("mu", [0.02, 5.0])
def test_sag_and_surge_at_rest_are_those_of_springs(mu):
    """All feet carry alike, tips slide or stick: C f, with f the weight of a foot."""
    robot = on(LEG, TABLE_I._replace(mu=mu))
    params = body_params(robot, TABLE_II, DT)
    state = standing_state(robot, 0.0, 0.0, 0.0)
    coast(state, params, 50_000)
    expected = compliance(LEG) @ (0.0, 0.0, TABLE_I.mass_kg * TABLE_II.g / 3.0)
    tolerance = 2.0 * mu * abs(expected[2]) if mu < 1.0 else 3e-3 * abs(expected[2])
    np.testing.assert_allclose(legs_of(state, 3), [expected] * 3, atol=tolerance)
    assert state[Z] - robot.com_height_m == pytest.approx(-expected[2], rel=3e-3)


def test_oscillations_have_the_natural_frequencies_of_the_body_on_springs():
    """Each of the six modes alone, tips stuck: its period between zeros of its velocity."""
    robot = on(LEG._replace(relaxation_s=5e-7), TABLE_I._replace(mu=50.0))
    mass = mass_of(robot)
    jacobians = [
        np.column_stack([np.eye(3), -np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])])
        for x, y, z in foot_positions(robot)
    ]
    stiffness = sum(j.T @ elastic.stiffness(LEG) @ j for j in jacobians)
    root = np.diag(1.0 / np.sqrt([mass.total] * 3 + list(mass.inertia)))
    squares, modes = np.linalg.eigh(root @ stiffness @ root)
    still = standing_state(robot, 0.0, 0.0, 0.0)
    coast(still, body_params(on(LEG, robot), TABLE_II, DT), 50_000)
    params = body_params(robot, TABLE_II, DT)
    for square, mode in zip(squares, modes.T, strict=True):
        direction = root @ mode
        state, omega = still.copy(), math.sqrt(square)
        state[VELOCITY.start : W_X + 3] += 1e-4 * direction / np.abs(direction).max()
        along, ticks = [], round(10.0 * math.pi / omega / DT)
        for _ in range(ticks):
            coast(state, params, 1)
            along.append(state[VELOCITY.start : W_X + 3] @ np.linalg.solve(root @ root, direction))
        rising = np.flatnonzero(np.diff(np.sign(along)) > 0)
        found = 2.0 * math.pi / (np.diff(rising).mean() * DT)
        assert found == pytest.approx(omega, rel=0.02)


def pulled(leg: Leg, mu: float, way: float) -> float:
    """Load in N on a leg whose root moves slowly at a fixed height, 0.1 mm below rest."""
    beam = elastic.Beam(elastic.axis_of(leg), leg.bending_n_m, leg.axial_n_m - leg.bending_n_m, 0.0)
    state, load = ((0.0, 0.0, 0.0), (0.0, 0.0)), 0.0
    axes = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
    for k in range(1000):
        root = (way * 1e-4 * k, 0.0, -1e-4)
        (load, _), state = elastic._pushed_leg(beam, root, mu, load, state, axes, 1.0)
    return load


@given(st.floats(5.0, 40.0), st.floats(2.0, 30.0), st.floats(0.05, 0.9))
@FEW
def test_loads_against_and_with_the_lean(lean, stiffer, share):
    """At a fixed height the load is that of C_zz ± μ |C_xz|, up to the jam at their ratio."""
    leg = Leg(lean, 180.0, stiffer * 1e3, 1e3, 1.0, 0.01)
    c = compliance(leg)
    mu = share * c[2, 2] / abs(c[0, 2])
    against, along = pulled(leg, mu, -1.0), pulled(leg, mu, 1.0)
    assert sorted((against, along)) == pytest.approx(
        [1e-4 / (c[2, 2] + mu * abs(c[0, 2])), 1e-4 / (c[2, 2] - mu * abs(c[0, 2]))], rel=1e-8
    )


@pytest.mark.long
@given(legged(LEGS), st.floats(0.0, 0.3), st.floats(0.0, 6.0))
@FEW
def test_a_dropped_body_regains_no_energy_and_keeps_the_cone(machine, tilt, towards):
    """Of all energy, that of bent legs included; landings of Euler's method add a hundredth."""
    config = machine.config
    robot, params = config.robot, params_of(config)
    state = standing_state(robot, *params.centre, 0.0)
    sine = math.sin(0.5 * tilt)
    state[3:7] = math.cos(0.5 * tilt), sine * math.cos(towards), sine * math.sin(towards), 0.0
    drop_m = 2e-3 + robot.foot_radius_m * math.sin(tilt)
    state[Z] += drop_m
    weight = robot.mass_kg * config.motor.g
    error = 1e-2 + (elastic.modes_rad_s(robot, mass_of(robot))[-1] * DT) ** 2
    lowest = energy(state, params) + bent(state, robot)
    for _ in range(1500):
        coast(state, params, 20)
        now = energy(state, params) + bent(state, robot)
        assert now <= lowest + error * weight * drop_m
        lowest = min(lowest, now)
        first = frictions(LEGS)
        pressed = state[NORMALS:first]
        rubbed = np.linalg.norm(state[first : first + 3 * LEGS].reshape(LEGS, 3), axis=1)
        mu = np.array([robot.mu if foot.mu is None else foot.mu for foot in robot.feet])
        assert (pressed >= 0.0).all()
        assert (rubbed <= mu * pressed + 1e-9 * weight * DT).all()


@kernel
def step_together(bodies: np.ndarray, params: BodyParams, width: Width, ticks: int) -> None:
    order, lanes = params.feet.pairing.order, len(width)
    for column in range(0, bodies.shape[1], lanes):
        for _ in range(ticks):
            body = read_body(bodies, column, width, order, params.contact.legs)
            body, _ = stepped(body, params, (0.01, 0.0, 0.0), (0.0, 0.0, 1e-6))
            write_body(bodies, column, width, order, body)


@pytest.mark.long
@pytest.mark.parametrize("lanes", [8, *(pytest.param(n, marks=pytest.mark.slow) for n in (2, 4))])
def test_lanes_have_the_bits_of_one(lanes):
    """Bodies that fall from different heights: legs that stick, slide and are in the air."""
    robot = on(LEG)
    params, alone = body_params(robot, TABLE_II, DT), np.empty((state_size(3, 3), 8))
    for k in range(8):
        alone[:, k] = standing_state(robot, 0.1 * k, 0.0, 0.3 * k)
        alone[[Z, VELOCITY.start], k] += 1e-5 * k * k, 0.01 * k
    together = alone.copy()
    step_together(alone, params, width_of(1), 3000)
    step_together(together, params, width_of(lanes), 3000)
    assert np.array_equal(alone, together)
    assert np.isfinite(alone).all()


@pytest.mark.long
@given(data=st.data())
@FEW
def test_mirrored_turned_and_permuted_machines_move_alike(data):
    machine = data.draw(legged(LEGS))
    speed = st.floats(0.3, 0.7) | st.floats(-0.7, -0.3)
    count = len(machine.motors)
    shares = data.draw(
        st.lists(st.tuples(speed, st.floats(0.0, 6.0)), min_size=count, max_size=count)
    )
    top = machine.config.lift_off_rad_s

    def moved(of: Machine, drive: Sequence[tuple[float, float]], angle: float = 0.0):
        config = of.config
        params = params_of(config)
        c, s = math.cos(angle), math.sin(angle)
        x, y = params.centre
        state = standing_state(config.robot, c * x - s * y, s * x + c * y, angle)
        speeds = [(share * top, phase) for share, phase in drive]
        wrenches = turning(config.robot, config.motor, speeds, 1500, DT)
        push(state, params, wrenches, np.zeros(5))
        return state

    plain = moved(machine, shares)
    mirrored = moved(machine.mirrored(), shares)
    scale = np.abs(plain[:3]).max()
    np.testing.assert_allclose(mirrored[:3] * (1.0, -1.0, 1.0), plain[:3], atol=1e-2 * scale)
    turned = moved(machine.turned(), shares, -0.5 * math.pi)
    np.testing.assert_allclose(turned[:3], plain[:3], atol=1e-2 * scale)
    order = data.draw(st.permutations(range(count))), data.draw(st.permutations(range(LEGS)))
    permuted = moved(machine.permuted(*map(list, order)), [shares[k] for k in order[0]])
    np.testing.assert_allclose(permuted[:7], plain[:7], atol=1e-2 * scale)


@pytest.mark.long
def test_stiff_legs_move_as_rigid_feet():
    """The error falls by a quarter at least where the frequency of the bounce doubles."""
    drive = Drive(-900.0, 900.0)
    rigid = mean_motion(TABLE_I, TABLE_II, drive, dt_s=DT).forward_m_s
    errors = []
    for bounce_hz in (1000.0, 2000.0, 4000.0):
        k = TABLE_I.mass_kg * (2.0 * math.pi * bounce_hz) ** 2 / 3.0
        leg = Leg(0.0, 0.0, k, k, 0.2 / (2.0 * math.pi * bounce_hz), 0.01)
        speed = mean_motion(on(leg), TABLE_II, drive, dt_s=DT).forward_m_s
        errors.append(abs(speed / rigid - 1.0))
    assert errors[2] < 0.06
    assert errors[2] < 0.6 * errors[1] < 0.36 * errors[0] * 1.2


@kernel
def slope(
    k_xx: float, k_xz: float, k_zz: float, tau: float, mu: float, m: float, push: float, hz: float,
    dt: float, ticks: int,
) -> float:  # fmt: skip
    """Mean speed in m/s of a mass on one leg in the plane, shaken from above; a reference.

    Unlike the product: the tip's friction is found by bisection in each of its tiny steps.
    """
    x = z = vx = vz = tip = dx = dz = 0.0
    mean = 0.0
    memory, damped = tau / (tau + dt), 1.0 + tau / dt
    touching = False
    for tick in range(ticks):
        hx, hz_ = memory * dx, memory * dz
        fx = fz = 0.0
        if z + hz_ >= 0.0:
            dx, dz, touching = hx, hz_, False
        else:
            if not touching:
                tip, touching = x + hx, True
            low, high = tip - 1e-2, tip + 1e-2
            ez = -z - hz_
            stuck, c = True, tip
            for sign in (0.0, -1.0, 1.0):  # sticks, or friction is at its limit to either side
                if sign == 0.0:
                    ex = tip - x - hx
                    fx = damped * (k_xx * ex + k_xz * ez)
                    fz = damped * (k_xz * ex + k_zz * ez)
                    stuck = fz >= 0.0 and abs(fx) <= mu * fz
                    if stuck:
                        break
                else:
                    a, b, c = low, high, tip
                    for _ in range(60):  # f_x − sign μ f_z grows with the tip's place
                        c = 0.5 * (a + b)
                        ex = c - x - hx
                        fx = damped * (k_xx * ex + k_xz * ez)
                        fz = damped * (k_xz * ex + k_zz * ez)
                        if fx > sign * mu * fz:
                            b = c
                        else:
                            a = c
                    if sign * (tip - c) > 0.0 and fz >= 0.0:
                        tip = c
                        break
            dx, dz = tip - x, -z
        vx += dt * fx / m
        vz += dt * (fz / m - 9.81 + push / m * math.cos(2.0 * math.pi * hz * tick * dt))
        x, z = x + dt * vx, z + dt * vz
        if 2 * tick == ticks:
            mean = x
    return (x - mean) / (0.5 * ticks * dt)


@pytest.mark.long
@pytest.mark.parametrize("hz", [12.0, 34.0, 80.0])
def test_a_shaken_body_drives_as_an_independent_integrator_has_it(hz):
    """In the plane, as pitch has a huge inertia; with few shakes a second it drives backwards."""
    leg = Leg(30.0, 180.0, 20_000.0, 400.0, 1e-3, 0.03)
    robot = on(leg, TABLE_I._replace(mu=0.2, inertia_kg_m2=(1e3, 1e3, 1e3)))
    params, w = body_params(robot, TABLE_II, DT), 0.4
    time_s = DT * np.arange(300_000)
    wrenches = np.zeros((len(time_s), 6))
    wrenches[:, 2] = w * np.cos(2.0 * math.pi * hz * time_s)
    state = standing_state(robot, 0.0, 0.0, 0.0)
    push(state, params, wrenches[:150_000], np.zeros(5))
    half = state[X]
    push(state, params, wrenches[150_000:], np.zeros(5))
    found = (state[X] - half) / 1.5
    k = 3.0 * elastic.stiffness(leg)
    expected = slope(
        k[0, 0], k[0, 2], k[2, 2], leg.relaxation_s, 0.2, robot.mass_kg, w, hz, DT / 5, 1_500_000
    )
    assert found == pytest.approx(expected, rel=0.03, abs=5e-5)


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"bending_n_m": 20.0}, "buckle"),
        ({"bending_n_m": 170.0, "lean_deg": 55.0, "axial_n_m": 170.0, "length_m": 0.009}, "sag"),
        ({"bending_n_m": 1e9, "axial_n_m": 1e9}, "too stiff for dt_s"),
    ],
)
def test_legs_that_the_law_does_not_describe_are_refused(changed, words):
    robot = on(LEG._replace(**changed))
    with pytest.raises(UserError, match=words):
        body_params(CoSimConfig(robot=robot).robot, TABLE_II, DT)


def test_what_is_of_rigid_feet_is_refused():
    config, mixed = CoSimConfig(robot=on(LEG)), on(LEG).feet[:2] + TABLE_I.feet[2:]
    for feet in (mixed, mixed[::-1]):
        with pytest.raises(UserError, match="one kind"):
            CoSimConfig(robot=TABLE_I._replace(feet=feet))
    with pytest.raises(UserError, match="rigid feet"):
        robot_platform(config.robot)
    with pytest.raises(UserError, match="elastic legs"):
        excitation(config)
    with pytest.raises(UserError, match="> 0"):
        CoSimConfig(robot=on(LEG._replace(relaxation_s=0.0)))
    with pytest.raises(UserError, match="restitution"):
        CoSimConfig(robot=on(LEG), world=World(restitution=0.2))


def test_stiffness_follows_from_a_bundle_of_round_beams(tmp_path):
    places = (0.02, 0.0), (-0.01, 0.015), (-0.01, -0.015)
    lines = [f"[[foot]]\nplace_m = {list(place)}" for place in places]
    beam = "length_m = 0.01\ndiameter_m = 2e-4\nyoung_pa = 3e9\ncount = 90\nrelaxation_s = 1e-4"
    path = tmp_path / "brush.toml"
    path.write_text("\n".join(f"{line}\n{beam}" for line in lines))
    leg = find_preset(path).config().robot.feet[0].leg
    area, second = math.pi * 1e-8, math.pi * 1e-16 / 4.0
    assert leg is not None
    assert leg.axial_n_m == pytest.approx(90.0 * 3e9 * area / 0.01)
    assert leg.bending_n_m == pytest.approx(90.0 * 3.0 * 3e9 * second / 1e-6)
    saved = tmp_path / "again.toml"
    find_preset(path).save(saved)
    assert find_preset(saved).config().robot == find_preset(path).config().robot

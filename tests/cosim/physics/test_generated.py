"""Laws of mechanics for machines that are drawn, with any number of motors and feet.

Motors turn at constant speeds, so that one kernel for each number of feet moves all machines; a
fixed machine moves by the whole plant with its motor FMUs.
"""

import math
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cosim.base.errors import UserError
from cosim.calibration.trial import Trial, mean_motion
from cosim.fmi.motor import MotorFmu
from cosim.model.config import CoSimConfig
from cosim.model.params import TIMING
from cosim.model.world import World
from cosim.physics.body_state import (
    ANGULAR_VELOCITY,
    NORMALS,
    POSITION,
    QUATERNION,
    VELOCITY,
    standing_state,
)
from cosim.physics.feet import delassus, foot_positions
from cosim.physics.inertia import BodyParams
from cosim.physics.properties import body_params
from cosim.physics.rotation import rotation_matrix
from tests.generated import Machine, broken, machines
from tests.references.prescribed import coast, energy, push, turning

DT = TIMING.dt_s
COUNTS = pytest.mark.parametrize(
    "feet", [4, *(pytest.param(n, marks=pytest.mark.long) for n in (3, 8))]
)
FEW = settings(max_examples=max(settings().max_examples // 8, 1))


class Run(NamedTuple):
    """A machine that has been driven from rest at the origin."""

    state: np.ndarray  # at the end
    # Place of its axis in m, and its rotation about the vertical in rad: not that of its x axis,
    # which differs from that of its y axis where the machine is tilted
    moved: np.ndarray
    tally: np.ndarray  # see `push`
    gained: float  # kinetic and potential energy in J


def params_of(config: CoSimConfig, dt_s: float = DT, tolerance: float = 1e-4) -> BodyParams:
    return body_params(config.robot, config.motor, dt_s, tolerance=tolerance, world=config.world)


def axis_of(state: np.ndarray, params: BodyParams) -> np.ndarray:
    axes = np.array(rotation_matrix(tuple(state[QUATERNION])))
    place = state[POSITION] - axes @ (*params.centre, 0.0)
    w, _, _, z = state[QUATERNION]
    return np.array([place[0], place[1], 2.0 * math.atan2(z, w)])


def driven(
    machine: Machine,
    shares: list[tuple[float, float]],
    ticks: int,
    *,
    angle: float = 0.0,
    dt_s: float = DT,
    tolerance: float = 1e-4,
) -> Run:
    """Drive a machine at shares of its largest speed, each with an angle at the start."""
    config = machine.config
    params = params_of(config, dt_s, tolerance)
    c, s = math.cos(angle), math.sin(angle)
    x, y = params.centre
    state = standing_state(config.robot, c * x - s * y, s * x + c * y, angle)
    top, before, tally = config.top_speed_rad_s, energy(state, params), np.zeros(5)
    drive = [(share * top, phase) for share, phase in shares]
    push(state, params, turning(config.robot, config.motor, drive, ticks, dt_s), tally)
    return Run(state, axis_of(state, params), tally, energy(state, params) - before)


@st.composite
def drives(draw: st.DrawFn, feet: int) -> tuple[Machine, list[tuple[float, float]]]:
    """Draw a machine, and a drive of each of its motors."""
    machine = draw(machines(motors=(1, 4), feet=(feet, feet)))
    speed = st.floats(0.3, 0.7) | st.floats(-0.7, -0.3) | st.just(0.0)
    count = len(machine.motors)
    shares = st.lists(st.tuples(speed, st.floats(0.0, 6.0)), min_size=count, max_size=count)
    return machine, draw(shares)


@given(broken())
def test_the_nearest_invalid_machines_are_refused_by_name(case):
    machine, word = case
    with pytest.raises(UserError) as error:
        machine.config  # noqa: B018
    assert word in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.long
@COUNTS
@given(data=st.data())
@FEW
def test_at_rest_it_stays_and_its_feet_carry_the_weight(feet, data):
    """Their loads balance its weight and moments; equal springs where these are all pressed."""
    config = data.draw(machines(feet=(feet, feet))).config
    params = params_of(config, tolerance=1e-8)
    state = standing_state(config.robot, *params.centre, 0.0)
    start = state.copy()
    coast(state, params, 10_000)
    np.testing.assert_allclose(state[:7], start[:7], atol=1e-6)  # sunk on its springs
    weight = -params.gravity[2] / params.inverse_mass
    loads = state[NORMALS : NORMALS + feet] / DT / weight
    places = foot_positions(config.robot)[:, :2] - params.centre
    rows = np.column_stack([np.ones(feet), places / np.abs(places).max()]).T
    np.testing.assert_allclose(rows @ loads, [1.0, 0.0, 0.0], atol=1e-3)
    springs = rows.T @ np.linalg.solve(rows @ rows.T, [1.0, 0.0, 0.0])
    if springs.min() > 0.0:
        np.testing.assert_allclose(loads, springs, atol=0.02)


@given(machines())
@FEW
def test_sweeps_never_expand(machine):
    """Eigenvalues of a sweep's linear part, compliance included, are between −1 and 1."""
    config = machine.config
    params = params_of(config)
    steps = [params.contact.step_tangential] * 2 + [params.contact.step_normal]
    root = np.sqrt(steps * len(config.robot.feet))
    operator = delassus(config.robot)
    operator[2::3, 2::3] += params.contact.compliance * np.eye(len(config.robot.feet))
    spectrum = np.linalg.eigvalsh(np.outer(root, root) * operator)
    assert spectrum[0] > -1e-12
    assert spectrum[-1] < 1.0 + 1e-9


@pytest.mark.long
@COUNTS
@given(data=st.data(), factor=st.floats(0.1, 10.0))
@FEW
def test_all_masses_times_a_factor_change_no_motion(feet, data, factor):
    machine, shares = data.draw(drives(feet))
    one, other = driven(machine, shares, 1000), driven(machine.heavier(factor), shares, 1000)
    same_motion(one.moved, other.moved, machine)


def same_motion(one: np.ndarray, other: np.ndarray, machine: Machine) -> None:
    """Compare places and headings after some ms: rounding, grown by sticking and slipping."""
    reach_m = 0.5 * machine.body["diameter_m"]
    np.testing.assert_allclose(one * (1.0, 1.0, reach_m), other * (1.0, 1.0, reach_m), atol=1e-8)


@COUNTS
@given(data=st.data())
@FEW
def test_mirrored_turned_and_permuted_machines_move_alike(feet, data):
    machine, shares = data.draw(drives(feet))
    usual = driven(machine, shares, 1000)
    mirrored = driven(machine.mirrored(), shares, 1000)
    same_motion(mirrored.moved, usual.moved * (1.0, -1.0, -1.0), machine)
    # A mass on a vertical shaft begins at +x, which is turned, too.
    upright = [m["axis"][2] * (math.hypot(*m["axis"][:2]) < 1e-9) for m in machine.motors]
    quarter = math.pi / 2.0
    phases = [
        (share, angle + quarter * math.copysign(1.0, z) * (z != 0.0))
        for (share, angle), z in zip(shares, upright, strict=True)
    ]
    turned = driven(machine.turned(), phases, 1000, angle=-quarter)
    same_motion(np.add(turned.moved, (0.0, 0.0, quarter)), usual.moved, machine)
    motors = data.draw(st.permutations(range(len(shares))))
    standing = data.draw(st.permutations(range(feet)))
    permuted = driven(machine.permuted(motors, standing), [shares[k] for k in motors], 1000)
    same_motion(permuted.moved, usual.moved, machine)


@COUNTS
@given(data=st.data())
@FEW
def test_work_of_motors_is_energy_gained_and_heat(feet, data):
    """Contacts take energy over time, and the floor gives none in any tick.

    In a landing friction alone may give some, if the impact turns the foot's motion around: it may
    so over all, where a robot hops. Some landings on eight feet end at the bound of sweeps, as the
    tolerance is a ten-thousandth of the default.
    """
    machine, shares = data.draw(drives(feet))
    run = driven(machine, shares, 3000, tolerance=1e-6)
    motors, normal, friction, most, unsolved = run.tally
    size = machine.body["mass_kg"] * 9.81 * 1e-6 + abs(motors)  # the weight lifted by 1 µm
    assert run.gained == pytest.approx(motors + normal + friction, abs=1e-2 * size)
    assert normal + friction < 1e-6 * size
    assert most < 1e-3 * size  # lifting back a penetration
    assert normal < 1e-3 * size
    assert unsolved < 150


@COUNTS
@given(data=st.data())
@FEW
def test_free_flight_keeps_momenta(feet, data):
    """With a payload off the axis, so that the inertia tensor is not diagonal."""
    config = data.draw(machines(feet=(feet, feet))).config
    load = World(payload_g=100.0 * config.robot.mass_kg, payload_offset_mm=(2.0, -1.0))
    params = params_of(config.in_world(load))._replace(gravity=(0.0, 0.0, 0.0))
    state = standing_state(config.robot, 0.0, 0.0, 0.0)
    state[2] += 1.0
    velocity = st.tuples(*[st.integers(-100, 100).map(lambda mm: 1e-3 * mm)] * 3)
    state[VELOCITY], state[ANGULAR_VELOCITY] = data.draw(velocity), data.draw(velocity)
    start = state.copy()
    coast(state, params, 10_000)
    tensor = np.diag(params.inertia)
    tensor[0, 1] = tensor[1, 0] = params.product

    def angular_momentum(of: np.ndarray) -> np.ndarray:
        return np.array(rotation_matrix(tuple(of[QUATERNION]))) @ tensor @ of[ANGULAR_VELOCITY]

    assert state[VELOCITY].tolist() == start[VELOCITY].tolist()
    change = np.linalg.norm(angular_momentum(state) - angular_momentum(start))
    assert change <= 1e-10 * np.linalg.norm(angular_momentum(start))


@pytest.mark.long
@COUNTS
@given(data=st.data())
@settings(max_examples=max(settings().max_examples // 25, 1))
def test_a_smaller_step_has_a_smaller_error(feet, data):
    """A fourth of the step has at most half of the error, in the median of eight drives of 10 ms.

    Of single ones it may grow: a foot that just sticks, or just does not, ends elsewhere.
    """
    ratios = []
    for machine, shares in data.draw(st.lists(drives(feet), min_size=8, max_size=8)):
        reach_m = 0.5 * machine.body["diameter_m"]
        coarse, fine, exact = (
            driven(machine, shares, 1000 * finer, dt_s=DT / finer).moved * (1.0, 1.0, reach_m)
            for finer in (1, 4, 16)
        )
        error, left = np.linalg.norm(coarse - exact), np.linalg.norm(fine - exact)
        ratios.append(left / max(error, 1e-12))
    assert np.median(ratios) < 0.5


STRONG = {"J": 1e-7, "K_T": 2e-3, "V_s_max": 6.0}
# Four feet and three motors, none of them alike.
ROVER = Machine(
    {"mass_kg": 1.5, "diameter_m": 0.12, "height_m": 0.08, "com_height_m": 0.02, "com_x_m": 0.004},
    (
        {"place_m": [0.0, 0.05, 0.01], "axis": [0.0, 1.0, 0.2], "m": 0.004, "r": 0.002} | STRONG,
        {"place_m": [0.01, -0.05, 0.01], "axis": [0.1, -1.0, 0.0], "m": 0.005} | STRONG,
        {"place_m": [-0.05, 0.0, 0.02], "axis": [1.0, 0.0, 0.5], "m": 0.003} | STRONG,
    ),
    (
        {"place_m": [0.05, 0.03], "mu": 0.3},
        {"place_m": [-0.04, 0.04]},
        {"place_m": [-0.05, -0.03]},
        {"place_m": [0.04, -0.04]},
    ),
)
SET_POINTS = (-700.0, 740.0, 600.0)


def in_the_plant(machine: Machine, fmu: MotorFmu, set_points: tuple[float, ...]) -> np.ndarray:
    """Drive for 0.3 s; speeds ahead and to the left in m/s and yaw rate in rad/s."""
    config = machine.config.having("test", relative_amplitude=0.0)
    with Trial(fmu, config, np.zeros(1), np.random.SeedSequence(0)) as trial:
        trial.set_motors(np.array([set_points]))
        before = trial.poses
        return mean_motion(before, [trial.advance(300)], 1e-3)[0]


@pytest.mark.long
def test_a_machine_with_its_motors_moves_alike_scaled_mirrored_turned_and_permuted(motor_fmu):
    fmu = MotorFmu(motor_fmu)
    ahead, left, rate = usual = in_the_plant(ROVER, fmu, SET_POINTS)
    assert math.hypot(ahead, left) > 1e-4
    for factor in (0.01, 20.0):
        np.testing.assert_allclose(
            in_the_plant(ROVER.heavier(factor), fmu, SET_POINTS), usual, rtol=1e-4
        )
    mirrored = in_the_plant(ROVER.mirrored(), fmu, SET_POINTS)
    np.testing.assert_allclose(mirrored, (ahead, -left, -rate), rtol=1e-4)
    turned = in_the_plant(ROVER.turned(), fmu, SET_POINTS)  # its heading is that of its x axis
    np.testing.assert_allclose(turned, (-left, ahead, rate), rtol=1e-4)
    other = ROVER.permuted([2, 0, 1], [3, 1, 0, 2])
    permuted = in_the_plant(other, fmu, (SET_POINTS[2], *SET_POINTS[:2]))
    np.testing.assert_allclose(permuted, usual, rtol=1e-4)

"""Both drivers give the same bits; a failing FMU is named."""

import math
import re

import numpy as np
import pytest

from cosim.base.outcome import COLLISION, OUT_OF_BOARD, RUNNING
from cosim.base.params import STEERING, TABLE_I, TABLE_II, TIMING
from cosim.coupling.adaptive import AdaptiveDriver
from cosim.coupling.fmu import FmuError, MotorFmu
from cosim.coupling.master import CompiledDriver
from cosim.coupling.plant import Plant
from cosim.coupling.signals import new_raw_samples, new_samples, new_state
from cosim.coupling.steering import DIRECTION, GOAL_X, START
from cosim.navigation.batch import DRIVERS
from cosim.physics.body import body_params, standing_state
from cosim.physics.collision import PairParams
from cosim.physics.forces import motor_mounts

PERIODS, ROBOTS = 200, 2


def plant_with(**changes) -> Plant:
    plant = Plant(
        body_params(TABLE_I, TABLE_II, TIMING.dt_s),
        *motor_mounts(TABLE_I, TABLE_II),
        STEERING,
        PairParams(TABLE_I.diameter_m, TABLE_I.mu_robots),
        end_on_collision=True,
        board_x=0.3,
        board_y=0.3,
        ticks_per_period=100,
        ticks_per_step=1,
        jacobi=False,
        reaction=False,
        exchange_tolerance=TIMING.exchange_tolerance_rad,
    )
    return plant._replace(**changes)


def advance(
    motor_fmu,
    driver,
    *,
    gap_m=0.1,
    heading=0.3,
    noise=40.0,
    broken_period=None,
    periods=PERIODS,
    head_on=False,
    obstacles=None,
    **changes,
):
    """20 000 ticks of two robots that drive to the right, or the right one towards the other."""
    fmu = MotorFmu(motor_fmu)
    motors = [fmu.instantiate(f"r{r + 1}.{m}") for r in range(ROBOTS) for m in "DE"]
    state = new_state(ROBOTS, obstacles)
    for robot in range(ROBOTS):
        x = 0.05 + gap_m * robot
        state.bodies[robot] = standing_state(TABLE_I, x, 0.15, heading)
        state.commands[robot, :6] = (x + 0.1, 0.15, 0.0, START, 1.0, 0.0)
    if head_on:
        state.commands[1, [GOAL_X, DIRECTION]] = 0.0, math.pi
    speeds = np.random.default_rng(0).uniform(-noise, noise, (periods, ROBOTS, 2))
    if broken_period is not None:
        speeds[broken_period, 0, 0] = np.nan
    samples, raw = new_samples(periods, ROBOTS), new_raw_samples(1000, ROBOTS)
    plant = plant_with(**changes)
    progress = DRIVERS[driver](motors).advance(plant, state, speeds, samples, raw, 0)
    for motor in motors:
        motor.close()
    return progress, state, samples, raw


@pytest.mark.parametrize(
    "coupling",
    [{}, {"ticks_per_step": 5}, {"jacobi": True}, {"reaction": True, "ticks_per_step": 2}],
    ids=lambda changes: "-".join(changes) or "default",
)
def test_drivers_agree_in_every_bit(motor_fmu, coupling):
    compiled = advance(motor_fmu, "compiled", **coupling)
    reference = advance(motor_fmu, "reference", **coupling)
    assert compiled[0] == reference[0] == (PERIODS, 0)
    for a, b in zip(compiled[1:], reference[1:], strict=True):
        for name in a._fields:
            assert np.array_equal(getattr(a, name), getattr(b, name)), name
    assert np.abs(compiled[2].omega[-1]).min() > 800.0  # the motors did run


def test_runs_repeat_in_every_bit(motor_fmu):
    first, second = (advance(motor_fmu, "compiled") for _ in range(2))
    assert np.array_equal(first[1].bodies, second[1].bodies)
    other = advance(motor_fmu, "compiled", noise=41.0)
    assert not np.array_equal(first[1].bodies, other[1].bodies)


@pytest.mark.parametrize("driver", ["compiled", "reference"])
def test_collision_ends_the_advance(motor_fmu, driver):
    progress, *_ = advance(motor_fmu, driver, gap_m=0.0499)
    assert progress == (1, COLLISION)


@pytest.mark.parametrize("driver", ["compiled", "reference"])
@pytest.mark.parametrize("end_on_collision", [True, False])
def test_an_obstacle_ends_the_advance_of_the_robot_that_touches_it(
    motor_fmu, driver, end_on_collision
):
    obstacles = np.array([[0.0, 0.0, 0.3, 0.1], [0.17499, 0.1, 0.2, 0.2]])
    progress, state, samples, _ = advance(
        motor_fmu, driver, obstacles=obstacles, end_on_collision=end_on_collision
    )
    assert progress == (1, COLLISION)
    assert state.events.tolist() == [RUNNING, COLLISION]
    assert samples.touching_share.max() == 0.0
    obstacles[1, 0] += 2e-4
    assert advance(motor_fmu, driver, obstacles=obstacles, periods=1)[0] == (1, RUNNING)


@pytest.mark.parametrize("driver", ["compiled", "reference"])
def test_leaving_the_board_outranks_a_collision_as_on_the_grid(motor_fmu, driver):
    progress, state, *_ = advance(motor_fmu, driver, gap_m=0.0499, board_x=0.07)
    assert progress == (1, OUT_OF_BOARD)
    assert state.events.tolist() == [COLLISION, OUT_OF_BOARD]


@pytest.mark.parametrize("driver", ["compiled", "reference"])
def test_failing_fmu_is_named_with_its_time(motor_fmu, driver):
    with pytest.raises(FmuError, match=r"instance r1\.D, at 0\.00300 s .*: .*omega_noise"):
        advance(motor_fmu, driver, broken_period=3)


def final_position(motor_fmu, **changes):
    """Where two robots are after 0.2 s without noise, shape (2, 3), m."""
    return advance(motor_fmu, "compiled", heading=0.0, noise=0.0, **changes)[2].position[-1]


def test_orders_of_coupling_converge_on_each_other(motor_fmu):
    """Errors of both orders shrink with the communication step, Jacobi's from the larger one."""
    exact = final_position(motor_fmu)
    moved = np.linalg.norm(exact[:, :2] - [[0.05, 0.15], [0.15, 0.15]], axis=1).min()
    for jacobi in (False, True):
        coarse, fine = (
            np.abs(final_position(motor_fmu, jacobi=jacobi, ticks_per_step=n) - exact).max()
            for n in (20, 5)
        )
        assert fine < coarse
        assert fine < 0.01 * moved


def test_adaptive_driver_takes_fewer_steps_for_the_same_motion(motor_fmu):
    fmu = MotorFmu(motor_fmu)
    motors = [fmu.instantiate(name) for name in "DE"]
    driver = AdaptiveDriver(motors)
    state, periods = new_state(1), 50
    state.bodies[0] = standing_state(TABLE_I, 0.05, 0.15, 0.0)
    state.commands[0, :6] = (0.2, 0.15, 0.0, START, 1.0, 0.0)
    other = state._replace(**{name: getattr(state, name).copy() for name in state._fields})
    noise = np.zeros((periods, 1, 2))
    plant = plant_with(steering=STEERING._replace(heading_gain_1_s=0.0))  # no way back to FMUs
    raw = new_raw_samples(0, 1)
    driver.advance(plant, state, noise, new_samples(periods, 1), raw, 0)
    assert driver.rejected > 0  # the start needs short steps
    assert driver.steps < periods * plant.ticks_per_period / 5
    fixed = CompiledDriver([fmu.instantiate(name) for name in "DE"])
    fixed.advance(plant, other, noise, new_samples(periods, 1), raw, 0)
    assert np.array_equal(state.outputs, other.outputs)  # the FMUs do not depend on the step
    assert state.bodies[0, :2] == pytest.approx(other.bodies[0, :2], abs=2e-7)


def test_adaptive_driver_says_which_states_it_may_return_to(motor_fmu):
    """An FMU may forget what is before a point that no state will be restored from."""
    fmu, calls = MotorFmu(motor_fmu), []
    motors = [fmu.instantiate(name) for name in "DE"]
    motors[0].slave.fmiCallLogger = calls.append
    state = new_state(1)
    state.bodies[0] = standing_state(TABLE_I, 0.05, 0.15, 0.0)
    state.commands[0, :6] = (0.2, 0.15, 0.0, START, 1.0, 0.0)
    driver = AdaptiveDriver(motors)
    samples, raw = new_samples(3, 1), new_raw_samples(0, 1)
    driver.advance(plant_with(), state, np.zeros((3, 1, 2)), samples, raw, 0)
    now = saved = forgotten = 0.0
    restored = kept = 0
    for call in calls:
        if call.startswith("fmi3GetFMUState"):
            saved = now
        elif call.startswith("fmi3SetFMUState"):
            assert saved >= forgotten
            now, restored = saved, restored + 1
        elif step := re.search(r"Point=(\S+), \w+=(\S+), noSet\w+=(True|False)", call):
            now = float(step[1]) + float(step[2])
            if step[3] == "True":
                forgotten, kept = float(step[1]), kept + 1
    assert restored > 3
    assert kept == driver.steps


def test_foreign_fmu_gives_the_same_bits(motor_fmu, edited_fmu):
    """Other order, other names of units, other display units, fixed steps: all legal."""

    def edit(root):
        variables = root.find("ModelVariables")
        variables[:] = reversed(variables)
        names = {unit.get("name"): f"[{unit.get('name')}]" for unit in root.iter("Unit")}
        for unit in root.iter("Unit"):
            unit.set("name", names[unit.get("name")])
            for display in unit.findall("DisplayUnit"):
                unit.remove(display)
        for element in variables:
            element.attrib.pop("displayUnit", None)
            if element.get("unit"):
                element.set("unit", names[element.get("unit")])
        for element in variables:
            if element.get("name") in {"V_s", "i", "d"}:
                del element.attrib["unit"]
        interface = root.find("CoSimulation")
        interface.set("canHandleVariableCommunicationStepSize", "false")
        interface.set("fixedInternalStepSize", "1e-5")

    own, foreign = (advance(path, "compiled", periods=20) for path in (motor_fmu, edited_fmu(edit)))
    assert own[0] == foreign[0]
    for a, b in zip(own[1:], foreign[1:], strict=True):
        assert all(np.array_equal(getattr(a, n), getattr(b, n)) for n in a._fields)


def test_reaction_of_the_body_is_small(motor_fmu):
    """The paper neglects it; see docs/physics.md for its size."""
    without, with_it = (
        advance(motor_fmu, "compiled", noise=0.0, reaction=on) for on in (False, True)
    )
    torque = with_it[1].inputs[..., 2]
    assert np.abs(torque).max() > 0.0
    assert without[1].inputs[..., 2].max() == 0.0
    change = np.abs(with_it[2].omega[-50:] - without[2].omega[-50:]).max()
    assert 0.01 < change < 20.0


def test_touching_robots_push_each_other_on(motor_fmu):
    progress, state, samples, _ = advance(
        motor_fmu,
        "compiled",
        gap_m=0.0501,
        heading=0.0,
        head_on=True,
        end_on_collision=False,
        periods=500,
    )
    assert progress.periods == 500
    assert samples.touching_share.max() > 0.0
    distance = np.linalg.norm(samples.position[:, 0, :2] - samples.position[:, 1, :2], axis=1)
    assert distance.min() > TABLE_I.diameter_m - 1e-7  # rigid
    assert np.isfinite(state.bodies).all()

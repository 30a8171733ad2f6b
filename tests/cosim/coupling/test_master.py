"""Both drivers give the same bits; a failing FMU is named."""

import math
import signal
from dataclasses import replace
from operator import attrgetter
from typing import Any

import numpy as np
import pytest
from fmpy.fmi3 import FMU3Slave

from cosim.coupling.assembly import new_plant, robot_properties
from cosim.coupling.master import CompiledDriver, FmpyDriver, ReferenceDriver
from cosim.coupling.plant import Plant
from cosim.coupling.signals import new_raw_samples, new_samples, new_state, with_room
from cosim.fmi.fmu import FmuError
from cosim.fmi.motor import MotorFmu
from cosim.fmi.motors import Motors
from cosim.model.config import CoSimConfig
from cosim.model.outcome import COLLISION, OUT_OF_BOARD, RUNNING
from cosim.model.params import STEERING, TABLE_I, TABLE_II
from cosim.onboard.steering import DIRECT, DIRECTION, GOAL_X, MODE, OMEGA_D, OMEGA_E, START
from cosim.physics.body_state import standing_state
from cosim.physics.lanes import host_lanes

PERIODS, ROBOTS = 200, 2
REFERENCE = pytest.param("reference", marks=pytest.mark.ci)  # has kernels of its own


def plant_with(**changes) -> Plant:
    return new_plant(CoSimConfig(), ROBOTS, end_on_collision=True)._replace(**changes)


def new_motors(motor_fmu, columns, *, sampled, ticks_per_step):
    config = CoSimConfig()
    step_s = ticks_per_step * config.timing.dt_s
    config = replace(config, timing=config.timing._replace(communication_step_s=step_s))
    motors = Motors(MotorFmu(motor_fmu), config, columns, sampled=sampled)
    motors.restart(range(columns), ((TABLE_II, TABLE_II),) * columns)
    return motors


def put_down(state, column, x, heading):
    state.bodies.motion[:, column] = standing_state(TABLE_I, x, 0.15, heading)
    state.bodies.properties[:] = robot_properties(CoSimConfig())[:, None]
    state.onboard.commands[column, :6] = (x + 0.1, 0.15, 0.0, START, 1.0, 0.0)


def advance(
    motor_fmu,
    driver,
    *,
    gap_m=0.1,
    heading=0.3,
    noise=0.04,
    broken_period=None,
    periods=PERIODS,
    head_on=False,
    obstacles=None,
    forbidden=None,
    board_x=0.3,
    straight=False,
    **changes,
):
    """100 ticks a period of two robots that drive to the right, or the right one towards the other.

    The driver is "reference", "fmpy" (with as many lanes as there are robots) or a number of lanes.
    """
    lanes: Any = {"reference": 1, "fmpy": 2}.get(driver, driver)
    columns = max(ROBOTS, lanes)
    steps = changes.get("ticks_per_step", 1)
    motors = new_motors(motor_fmu, columns, sampled=driver == "fmpy", ticks_per_step=steps)
    state = new_state(1, ROBOTS, columns)
    if obstacles is not None:
        state = with_room(state, len(obstacles), 0)
        state.floor.obstacles[0] = obstacles
    if forbidden is not None:
        state = with_room(state, 0, 0, 1)
        state.floor.forbidden[:] = np.inf
        state.floor.forbidden[0, 0] = forbidden
    state.floor.boards[0] = board_x, 0.3
    state.episodes.running[0] = 1
    for robot in range(ROBOTS):
        put_down(state, robot, 0.05 + gap_m * robot, heading)
    if head_on:
        state.onboard.commands[1, [GOAL_X, DIRECTION]] = 0.0, math.pi
    if straight:
        speed = STEERING.forward_speed_rad_s
        state.onboard.commands[:, MODE] = DIRECT
        state.onboard.commands[:, [OMEGA_D, OMEGA_E]] = -speed, speed
    speeds = np.zeros((periods, columns, 2))
    generator = np.random.default_rng(0)
    speeds[:, :ROBOTS] = generator.uniform(-noise, noise, (periods, ROBOTS, 2))
    if broken_period is not None:
        speeds[broken_period, 0, 0] = np.nan
    samples, raw = new_samples(periods, columns), new_raw_samples(1000, columns)
    kinds = {"reference": ReferenceDriver, "fmpy": FmpyDriver}
    chosen = kinds.get(driver, CompiledDriver)(motors, lanes)
    chosen.advance(plant_with(**changes), state, speeds, samples, raw)
    motors.close()
    done = int(state.episodes.periods[0])
    ticks = min(1000, 100 * done)
    return (
        (done, int(state.episodes.events[:ROBOTS].max())),
        visible(state),
        type(samples)(*(signal[:done, :ROBOTS] for signal in samples)),
        type(raw)(*(signal[:ticks, :ROBOTS] for signal in raw)),
    )


def visible(state):
    """What is of the robots in a state, by name; columns first."""
    by_column = "onboard.commands", "contacts.touching", "episodes.events"
    by_row = (
        *("bodies.motion", "bodies.statistics"),
        *("motors.inputs", "motors.outputs", "motors.electrical"),
    )
    found = {name: attrgetter(name)(state)[:ROBOTS] for name in by_column}
    return found | {name: attrgetter(name)(state)[:, :ROBOTS].T for name in by_row}


def same(first, second):
    """Whether two results of `advance` agree in every bit."""
    one, other = ((*r[1].values(), *r[2], *r[3]) for r in (first, second))
    return first[0] == second[0] and all(map(np.array_equal, one, other))


@pytest.mark.ci
@pytest.mark.parametrize(
    "coupling",
    [{}, {"ticks_per_step": 5}, {"reaction": True, "ticks_per_step": 2}],
    ids=lambda changes: "-".join(changes) or "default",
)
def test_drivers_lanes_and_arrays_agree_in_every_bit(motor_fmu, array_fmu, coupling):
    coupling = {"periods": 60, **coupling}
    reference = advance(motor_fmu, "reference", **coupling)
    assert reference[0] == (60, 0)
    assert not same(advance(motor_fmu, 2, noise=0.041, **coupling), reference)
    assert np.abs(reference[2].omega[-1]).min() > 800.0  # the motors did run
    for fmu in (motor_fmu, array_fmu):
        for lanes in {2, host_lanes()}:
            assert same(advance(fmu, lanes, **coupling), reference), (fmu, lanes)
    if "reaction" not in coupling:
        assert same(advance(array_fmu, "fmpy", **coupling), reference)


@pytest.mark.slow  # compiles for widths that nothing chooses on this processor
@pytest.mark.parametrize("lanes", sorted({1, 4, 8, 16} - {host_lanes()}))
@pytest.mark.parametrize(
    "how",
    [
        {"gap_m": 0.1},
        {"gap_m": 0.0499},
        {"forbidden": (0.05001, 0.14, 0.06, 0.16), "straight": True, "heading": 0.0, "periods": 60},
    ],
)
def test_any_number_of_lanes_gives_the_same_bits(array_fmu, lanes, how):
    reference = advance(array_fmu, "reference", **how)
    assert same(advance(array_fmu, lanes, **how), reference)


@pytest.mark.parametrize("driver", [2, REFERENCE, "fmpy"])
def test_collisions_end_the_advance_and_leaving_the_board_outranks_them(array_fmu, driver):
    assert advance(array_fmu, driver, gap_m=0.0499)[0] == (1, COLLISION)
    progress, state, *_ = advance(array_fmu, driver, gap_m=0.0499, board_x=0.07)
    assert progress == (1, OUT_OF_BOARD)
    assert state["episodes.events"].tolist() == [COLLISION, OUT_OF_BOARD]


@pytest.mark.parametrize("driver", [2, REFERENCE])
def test_an_obstacle_ends_the_advance_of_the_robot_that_touches_it(motor_fmu, driver):
    obstacles = np.array([[0.0, 0.0, 0.3, 0.1], [0.17499, 0.1, 0.2, 0.2]])
    progress, state, samples, _ = advance(motor_fmu, driver, obstacles=obstacles)
    assert progress == (1, COLLISION)
    assert state["episodes.events"].tolist() == [RUNNING, COLLISION]
    assert samples.touching_share[0, 0] == 0.0 < samples.touching_share[0, 1] <= 1.0
    obstacles[1, 0] += 2e-4
    assert advance(motor_fmu, driver, obstacles=obstacles, periods=1)[0] == (1, RUNNING)


@pytest.mark.long
def test_robots_slide_along_obstacles_and_around_their_corners(motor_fmu):
    """Both drive, askew, along walls of two obstacles; the right one passes their end."""
    obstacles = np.array([[0.0, 0.17505, 0.15, 0.2], [0.15, 0.17505, 0.151, 0.3]])
    how = {"obstacles": obstacles, "end_on_collision": False, "straight": True}
    for periods, drivers in ((100, ("reference", 2)), (900, (2, host_lanes()))):
        results = [advance(motor_fmu, driver, periods=periods, **how) for driver in drivers]
        assert results[0][2].touching_share[:, 1].max() > 0.0
        assert all(same(result, results[0]) for result in results[1:])
    progress, _, samples, _ = results[0]
    assert progress == (900, RUNNING)
    x, y = samples.position[..., 0], samples.position[..., 1]
    gaps = [
        np.hypot(x - np.clip(x, left, right), y - np.clip(y, bottom, top))
        for left, bottom, right, top in obstacles
    ]
    assert np.min(gaps) > TABLE_I.diameter_m / 2.0 - 1e-7
    assert (x[-1] > x[0] + 2e-3).all()
    assert x[-1, 1] > 0.151


@pytest.mark.ci
def test_a_centre_where_it_is_forbidden_ends_the_episode_in_every_driver(motor_fmu):
    ahead = 0.05 + 1e-5, 0.14, 0.06, 0.16
    straight = {"straight": True, "heading": 0.0, "periods": 60}
    drivers = ("reference", 2, host_lanes())
    results = [advance(motor_fmu, d, forbidden=ahead, **straight) for d in drivers]
    assert all(same(result, results[0]) for result in results[1:])
    (done, event), state, samples, _ = results[0]
    assert event == COLLISION
    assert state["episodes.events"].tolist() == [COLLISION, RUNNING]  # not the other
    assert 1 < done < 60
    assert samples.position[-2, 0, 0] < ahead[0] <= samples.position[-1, 0, 0]
    on = advance(motor_fmu, 2, forbidden=ahead, end_on_collision=False, **straight)
    assert on[0] == (60, RUNNING)


@pytest.mark.parametrize("driver", [2, REFERENCE])
def test_failing_fmu_is_named_with_its_time(motor_fmu, driver):
    with pytest.raises(FmuError, match=r"instance r1\.D, at 0\.00300 s .*: .*omega_noise"):
        advance(motor_fmu, driver, broken_period=3)


def test_fmpy_names_a_failing_fmu_with_its_time(array_fmu):
    """Whether it refuses its inputs or a step, which is too long for a motor's inertia."""
    with pytest.raises(FmuError, match=r"instance motors, at 0\.00300 s .*: .*omega_noise"):
        advance(array_fmu, "fmpy", broken_period=3)
    parameters = TABLE_II._replace(J=5e-13)
    motors = Motors(MotorFmu(array_fmu), CoSimConfig(), 2, sampled=True)
    motors.restart(range(2), ((parameters, TABLE_II),) * 2)
    state = new_state(1, 1, 2)
    put_down(state, 0, 0.05, 0.0)
    state.episodes.running[0] = 1
    samples, raw, noise = new_samples(3, 2), new_raw_samples(0, 2), np.full((3, 2, 2), 1e3)
    driver = FmpyDriver(motors, 2)
    with pytest.raises(FmuError, match=r"motors, at 0\.00000 s failed .*: .*J of motor 1 cannot"):
        driver.advance(plant_with(robots=1), state, noise, samples, raw)


def test_fmpy_raises_what_comes_up_in_a_step(array_fmu, monkeypatch):
    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(FMU3Slave, "doStep", interrupted)
    with pytest.raises(KeyboardInterrupt):
        advance(array_fmu, "fmpy", periods=3)


def test_a_signal_ends_an_advance_of_fmpy(array_fmu, monkeypatch):
    """At the end of the advance: out of a callback the exception would be lost."""
    do_step, done = FMU3Slave.doStep, []

    def signalled(*arguments):
        done.append(signal.raise_signal(signal.SIGINT) if len(done) == 3 else None)
        return do_step(*arguments)

    monkeypatch.setattr(FMU3Slave, "doStep", signalled)
    with pytest.raises(KeyboardInterrupt):
        advance(array_fmu, "fmpy", periods=5)
    assert len(done) == 5


def final_position(motor_fmu, **changes):
    """Where two robots are after 0.2 s without noise, shape (2, 3), m."""
    return advance(motor_fmu, 2, heading=0.0, noise=0.0, **changes)[2].position[-1]


def test_errors_shrink_with_the_communication_step(motor_fmu):
    exact = final_position(motor_fmu)
    moved = np.linalg.norm(exact[:, :2] - [[0.05, 0.15], [0.15, 0.15]], axis=1).min()
    coarse, fine = (
        np.abs(final_position(motor_fmu, ticks_per_step=n) - exact).max() for n in (20, 5)
    )
    assert fine < coarse
    assert fine < 0.01 * moved


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

    own, foreign = (advance(path, 2, periods=20) for path in (motor_fmu, edited_fmu(edit)))
    assert same(own, foreign)


def test_reaction_of_the_body_is_small(motor_fmu):
    """The paper neglects it; see docs/physics.md for its size."""
    without, with_it = (advance(motor_fmu, 2, noise=0.0, reaction=on) for on in (False, True))
    torque = with_it[1]["motors.inputs"][:, 4:]
    assert np.abs(torque).max() > 0.0
    assert without[1]["motors.inputs"][:, 4:].max() == 0.0
    change = np.abs(with_it[2].omega[-50:] - without[2].omega[-50:]).max()
    assert 0.01 < change < 20.0


def test_touching_robots_push_each_other_on(motor_fmu):
    how: Any = {"gap_m": 0.0501, "heading": 0.0, "head_on": True, "end_on_collision": False}
    progress, state, samples, _ = advance(motor_fmu, 2, periods=500, **how)
    assert progress[0] == 500
    assert samples.touching_share.max() > 0.0
    distance = np.linalg.norm(samples.position[:, 0, :2] - samples.position[:, 1, :2], axis=1)
    assert distance.min() > TABLE_I.diameter_m - 1e-7  # rigid
    assert np.isfinite(state["bodies.motion"]).all()

"""RL steps over the dynamics: actions end at cell centres, observations are the cells'."""

from dataclasses import replace
from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from cosim.base.arguments import ConfigError
from cosim.base.errors import UserError
from cosim.coupling.rl_step import Decision, decide
from cosim.coupling.signals import new_state
from cosim.model.config import CoSimConfig
from cosim.model.params import TABLE_I, TIMING, cylinder_inertia
from cosim.model.scenario import Scenario
from cosim.model.world import Sensor, World
from cosim.onboard.features import LARGE, MEDIUM, Observation
from cosim.onboard.observing import draw_starts
from cosim.onboard.steering import DRIVE, GOAL_X, GOAL_Y, HOLD, MODE, PAST
from cosim.recording.series import with_bursts
from cosim.simulation.episode import RunningEpisode
from cosim.simulation.options import PROMPT_RL_STEP_S, DecisionOptions
from cosim.simulation.rules import TICK, conclude, robots_of
from cosim.simulation.simulate import simulate
from tests.alone import CoSimulation, drive

SHORT = Scenario("short", "two cells each", ((15, 27), (15, 2)), (((15, 29),), ((15, 0),)))
EAST, NORTH, SOUTH = 0, 2, 6


@pytest.fixture(scope="module")
def short(motor_fmu, straight_policy):
    """Steps of an episode in which both robots drive two cells."""
    config = with_bursts(CoSimConfig(), "default")
    return drive(SHORT, motor_fmu, straight_policy(SHORT.targets), config)


def test_robots_reach_their_targets_and_stop_at_the_centres(short):
    system, steps = short
    assert system.episode.outcome == "success"
    assert steps[-1].outcome == "success"
    assert steps[-1].after.cells.tolist() == [[15, 27], [15, 2]]
    assert system.episode.measures.path_length_m == pytest.approx(0.02, abs=0.001)
    for robot, target in enumerate(SHORT.targets):
        final = steps[-1].samples.position[-1, robot, :2]
        assert final == pytest.approx(SHORT.centre_m(target), abs=2e-3)


def test_a_robot_that_thinks_to_be_off_the_board_is_at_its_edge(motor_fmu):
    """A camera that is wrong by decimetres puts robots off the board; policies never see that."""
    world = World(sensor=Sensor(rate_hz=30.0, position_noise_mm=100.0))
    system = CoSimulation(SHORT, motor_fmu, CoSimConfig().in_world(world))
    system.reset()
    off = 0
    for _ in range(3):
        step = system.step(np.array([EAST, EAST]))
        off += (step.samples.estimate[..., :2] < 0.0).sum()
        off += (step.samples.estimate[..., :2] > 0.3).sum()
        assert ((step.after.cells >= 0) & (step.after.cells < 30)).all()
    system.close()
    assert off > 0


def test_robots_drive_through_centres_and_stop_at_their_targets(motor_fmu, straight_policy, short):
    """Asked when their moves end, robots are sooner there, and stop only to stay or to turn."""
    config = CoSimConfig().merged(DecisionOptions(through=True).tree())
    system, steps = drive(SHORT, motor_fmu, straight_policy(SHORT.targets), config)
    assert system.episode.outcome == "success"
    assert [step.duration_s for step in steps] == pytest.approx([PROMPT_RL_STEP_S] * len(steps))
    assert system.episode.time_s < short[0].episode.time_s
    modes = np.concatenate([step.samples.mode for step in steps])
    passed = np.concatenate([step.completed[None] for step in steps]).sum(axis=0)
    assert passed.tolist() == [2, 2]
    for robot in range(2):
        first, last = np.flatnonzero(modes[:, robot] == DRIVE)[[0, -1]]
        assert not (modes[first:last, robot] == HOLD).any()
    assert (modes[-1] == PAST).any()
    assert (system.state.onboard.commands[:, MODE] == HOLD).all()


def test_action_stays_in_force_until_the_centre(short):
    _, steps = short
    decisions = np.array([step.decided for step in steps])
    assert decisions[0].all()
    assert 0 < decisions[1:].sum() < decisions[1:].size / 2
    for before, after in pairwise(steps):
        kept = ~after.decided & (after.action >= 0)
        assert np.array_equal(before.action[kept], after.action[kept])


def test_observation_has_the_cells_that_robots_drive_to(short):
    _, steps = short
    assert steps[0].before.goals.tolist() == steps[0].before.cells.tolist()
    for step in steps:
        ended = step.completed
        assert step.after.goals[ended].tolist() == step.after.cells[ended].tolist()
    under_way = [s for s in steps if not s.completed.any()]
    assert under_way
    assert under_way[0].after.goals.tolist() == [[15, 28], [15, 1]]


def test_signals_are_contiguous_in_time(short):
    _, steps = short
    for before, after in pairwise(steps):
        assert after.first_tick - before.first_tick == 200_000
        assert len(before.samples.omega) == 2000
        jump = after.samples.position[0] - before.samples.position[-1]
        assert np.abs(jump).max() < 1e-4


def test_voltage_stays_within_the_battery_and_friction_in_the_cone(short):
    _, steps = short
    assert max(np.abs(step.samples.voltage).max() for step in steps) == 3.0
    for step in steps:
        assert len(step.raw.normal) > 0
        assert (step.raw.normal >= 0.0).all()
        friction = np.linalg.norm(step.raw.friction.reshape(*step.raw.normal.shape, 2), axis=-1)
        assert (friction <= TABLE_I.mu * step.raw.normal * (1.0 + 1e-9)).all()


def test_leaving_the_board_ends_the_episode(motor_fmu):
    system = CoSimulation(SHORT, motor_fmu)
    system.reset(((29, 29), (0, 0)))
    step = system.step(np.array([EAST, NORTH]))
    while not system.episode.outcome:
        step = system.step(np.array([EAST, NORTH]))
    assert system.episode.outcome == "out_of_board"
    assert step.samples.position[-1, 0, 0] == pytest.approx(0.3, abs=1e-4)


def test_limits_hold_to_the_tick_whenever_a_move_began():
    """In floating point 62 of these 300 moves lasted one RL step longer than their limit."""
    state, starts = new_state(1, 2, 2), ((15, 29), (15, 0))
    config = CoSimConfig(timing=TIMING._replace(episode_limit_s=1e3))
    episode = RunningEpisode(SHORT, config, state, slice(0, 2), starts, np.random.SeedSequence(0))
    for began in range(0, 300 * 200_000, 200_000):
        state.onboard.commands[:, MODE] = HOLD
        for later, decides in ((0, True), (3_999_999, False), (4_000_000, True)):
            episode.moves.counts[TICK] = began + later
            conclude(episode.rules, robots_of(state, 0), episode.moves, driven=False)
            assert episode.awaiting.all() == episode.awaiting.any() == decides
            episode.begin_step(np.array([SOUTH, NORTH]))
            assert episode.moves.decided.all() == decides
    assert [config.ticks(s) for s in (0.3, 1e3, 1e3 + 1e-5)] == [30_000, 10**8, 10**8 + 1]


class Unruly:
    """An array of a library that refuses to become one of NumPy, as tensors with gradients do."""

    def __array__(self, *_: Any, **__: Any) -> np.ndarray:
        raise RuntimeError("detach it first")


@pytest.mark.parametrize(
    "action",
    [-1, 2, 2.5, [1.5, 2], True, [True, False], [2, 2, 2], [2, 8], [-1, 0], None, "NN", [2],
     [[2, 2]], [[2], [2, 2]], np.full(2, np.nan), np.array([2.0, 2.0]), [None, 2],
     np.ma.masked_all(2, int), np.ma.array([2, 2], mask=[False, True]), np.array([2, 2], object),
     np.array([2**64 - 1, 2], np.uint64), np.array([2, 2], "m8[s]"), {0: 2, 1: 2}, {2, 3},
     Unruly()],
)  # fmt: skip
def test_policies_that_return_anything_else_than_directions_are_refused(motor_fmu, action):
    system = CoSimulation(SHORT, motor_fmu)
    system.reset()
    expected = r"^the policy returned .*; expected 2 integers from 0 to 7"
    with pytest.raises(UserError, match=expected):
        system.step(action)
    system.close()


def test_observation_has_the_targets(motor_fmu):
    system = CoSimulation(SHORT, motor_fmu)
    observation = system.reset()
    assert observation.targets.tolist() == [[15, 27], [15, 2]]
    for array in observation:
        array[:] = 0  # a policy's own copy
    assert system.step(np.array([SOUTH, NORTH])).after.targets.tolist() == [[15, 27], [15, 2]]
    goals = system.state.onboard.commands[:, GOAL_X : GOAL_Y + 1]
    assert goals.tolist() == pytest.approx(np.array([[0.155, 0.285], [0.155, 0.015]]))
    system.close()


@pytest.mark.parametrize(
    "values",
    ["bad", np.zeros((2, 3)), np.zeros(8), [[0.0] * 8, None], np.ma.masked_all((2, 8)),
     np.zeros((2, 8), object), np.zeros((2, 8), complex), SimpleNamespace(shape=(2, 8)), Unruly()],
)  # fmt: skip
def test_values_that_are_none_of_the_directions_are_refused(values):
    policy: Any = SimpleNamespace(act=lambda _: Decision(np.array([SOUTH, NORTH]), values))
    observation = Observation(*np.zeros((5, 2), int))
    with pytest.raises(UserError, match=r"returned values = .*; expected 2 x 8 numbers"):
        decide(policy, observation)


def test_observation_sees_the_nearest_robot(motor_fmu):
    system = CoSimulation(SHORT, motor_fmu)
    assert system.reset().distance_class.tolist() == [LARGE, LARGE]
    observation = system.reset(((10, 10), (18, 10)))
    assert observation.distance_class.tolist() == [MEDIUM, MEDIUM]
    assert observation.gradient_sign.tolist() == [0, 0]
    assert observation.direction.tolist() == [NORTH, NORTH]


def test_starts_never_touch():
    crowd = Scenario("crowd", "", ((0, 9), (9, 9)), (tuple((x, 0) for x in range(12)),) * 2)
    rng = np.random.default_rng(0)
    for _ in range(50):
        a, b = draw_starts(crowd, rng)
        assert abs(a[0] - b[0]) > 5


def test_the_scenario_decides_the_diameter(motor_fmu):
    small = Scenario("small", "", SHORT.targets, SHORT.starts, robot_diameter_m=0.03)
    with pytest.raises(ConfigError, match=r"diameter_m = 0\.05 .* robot_diameter_m = 0\.03"):
        CoSimulation(small, motor_fmu, CoSimConfig()).reset()
    config = CoSimConfig().sized(0.03)
    assert CoSimulation(small, motor_fmu).config == config
    values = {name: row["value"] for name, row in config.table().items()}
    assert values["diameter_m"] == 0.03
    assert config.robot.foot_radius_m == pytest.approx(0.6 * TABLE_I.foot_radius_m)
    assert config.robot.motors[1].place_m == pytest.approx((0.0, -0.6 * 0.0225, 0.003))
    assert cylinder_inertia(config.robot)[2] == pytest.approx(0.36 * cylinder_inertia(TABLE_I)[2])
    assert CoSimConfig().sized(0.05) == CoSimConfig()  # in every bit


@pytest.mark.parametrize(
    ("record", "changes", "message"),
    [
        ("timing", {"dt_s": 3e-5}, "communication_step_s = 1e-05 s is not a whole multiple"),
        ("timing", {"communication_step_s": 3e-5}, "control_period_s = 0.001 s is not a whole"),
        ("timing", {"rl_step_s": 0.0015}, "rl_step_s = 0.0015 s is not a whole multiple"),
        ("timing", {"dt_s": 0.0}, "timing.dt_s = 0.0 is invalid: expected float > 0"),
        ("robot", {"diameter_m": 0.0452}, "a foot at .* outside the body of diameter_m = 0.0452"),
        ("robot", {"motors": TABLE_I.spread(1.2).motors}, "a motor at .* is outside the body"),
        ("steering", {"forward_speed_rad_s": 1200.0}, "would make the robot hop"),
    ],
)
def test_parameters_that_do_not_fit_each_other_are_refused(record, changes, message):
    with pytest.raises(ConfigError, match=message):
        replace(CoSimConfig(), **{record: getattr(CoSimConfig(), record)._replace(**changes)})


@pytest.mark.parametrize("speed", [1160.0, -1e5])
def test_policies_that_command_hopping_are_refused(motor_fmu, speed):
    class Fast:
        interval_s = 0.1

        def drive(self, motion):
            return np.full((len(motion.poses), 2), speed)

    with pytest.raises(UserError, match=f"commands .* {abs(speed):g} rad/s, which would .* hop"):
        simulate("1a", Fast(), motor_fmu=motor_fmu, record="summary", progress=None)


def test_a_payload_that_tips_the_robot_over_is_refused():
    World(payload_g=20.0, payload_offset_mm=(10.0, 0.0))
    with pytest.raises(ConfigError, match=r"falls over: .* with the payload at \(15, 0\) mm"):
        CoSimConfig().in_world(World(payload_g=300.0, payload_offset_mm=(20.0, 0.0)))

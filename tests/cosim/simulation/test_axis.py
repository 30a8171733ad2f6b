"""Geometry belongs to a robot's axis, wherever its centre of mass is: generated places of it."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from cosim.coupling.rl_step import Step
from cosim.model.config import CoSimConfig
from cosim.model.params import TABLE_I
from cosim.model.scenario import Cell, Scenario
from cosim.model.world import IDEAL, World
from cosim.physics.body_state import V_X, W_Z
from cosim.physics.mass import mass_of
from cosim.physics.rotation import headings
from cosim.recording.episode import EpisodeRecorder
from cosim.recording.file import Kept
from cosim.recording.reader import read_episode
from fmus.build import cached_fmu
from tests.alone import CoSimulation

ICE = CoSimConfig().having("test", mu=0.0, relative_amplitude=0.0)
TIMING = ICE.timing._replace(rl_step_s=0.03, burst_s=0.03)
RADIUS = TABLE_I.diameter_m / 2.0
FAST, SPIN = 0.9, 10.0
ROUNDING_M, SHAKEN_M = 1e-6, 5e-5
centres = st.builds(
    lambda r, angle: {"com_x_m": r * math.cos(angle), "com_y_m": r * math.sin(angle)},
    st.floats(0.0, 0.011),
    st.floats(-math.pi, math.pi),
)
AHEAD, ASIDE, MIDDLE = ({"com_x_m": x, "com_y_m": y} for x, y in ((0, 0.011), (0.011, 0), (0, 0)))
generated = settings(max_examples=max(4, settings().max_examples // 20), deadline=None)


def slides(
    machine: dict[str, float],
    *starts: Cell,
    obstacles: tuple[Cell, ...] = (),
    end: bool = False,
    world: World = IDEAL,
) -> Step:
    """An RL step in which the first robot slides over ice, its centre of mass to the right.

    Until it touches something that moves on a straight line, and its axis around it.
    """
    config = replace(
        ICE.having("test", **machine).in_world(world),
        timing=TIMING,
        on_collision="end" if end else "continue",
    )
    targets = ((0, 0), (29, 29))[: len(starts)]
    scenario = Scenario("ice", "", targets, tuple((s,) for s in starts), obstacles=obstacles)
    system = CoSimulation(scenario, cached_fmu(), config)
    system.reset()
    expected = 0.01 * (np.array(starts) + 0.5)
    assert system.episode.positions_m.tolist() == expected.tolist()
    system.state.bodies.motion[V_X, 0], system.state.bodies.motion[W_Z, 0] = FAST, SPIN
    step = system.step(np.zeros(len(starts), dtype=np.int64))
    system.close()
    centre = centres_of_mass(step, mass_of(config.robot, world).centre)
    free = np.argmax(np.append(step.samples.touching_share[:, 0], 1.0) > 0.0)
    moved = centre[:free, 0] - centre[0, 0]
    np.testing.assert_allclose(moved[:, 0], 1e-3 * FAST * np.arange(free), atol=SHAKEN_M)
    np.testing.assert_allclose(moved[:, 1], 0.0, atol=SHAKEN_M)
    return step


def centres_of_mass(step: Step, centre: tuple[float, float]) -> np.ndarray:
    """Places (n, N, 2) of robots' centres of mass that are at a place from their axes."""
    angle, (x, y) = headings(step.samples.quaternion), centre
    arm = np.cos(angle) * x - np.sin(angle) * y, np.sin(angle) * x + np.cos(angle) * y
    return step.samples.position[..., :2] + np.stack(arm, axis=-1)


@generated
@given(centres, st.booleans())
@example(AHEAD, True)
@example(ASIDE, False)
@example(MIDDLE, True)
def test_outlines_of_robots_touch_but_do_not_overlap(machine, end):
    step = slides(machine, (10, 15), (16, 15), end=end)
    between = np.diff(step.raw.position[..., :2], axis=1)[:, 0]
    distance = np.linalg.norm(between, axis=1)
    assert distance.min() == pytest.approx(2.0 * RADIUS, abs=1e-5)
    assert distance.min() > 2.0 * RADIUS - ROUNDING_M
    centre = centres_of_mass(step, (machine["com_x_m"], machine["com_y_m"])).mean(axis=1)
    pushed = centre - centre[0] - np.outer(np.arange(len(centre)), (0.5e-3 * FAST, 0.0))
    np.testing.assert_allclose(pushed, 0.0, atol=SHAKEN_M)  # they push each other alone
    assert step.samples.touching_share[-1].all() or not end
    assert step.outcome == ("collision" if end else "")


@generated
@given(centres)
@example(AHEAD)
@example(ASIDE)
def test_outlines_touch_walls_but_do_not_enter_them(machine):
    step = slides(machine, (10, 15), obstacles=((14, 14), (14, 15), (14, 16)))
    assert step.raw.position[..., 0].max() == pytest.approx(0.14 - RADIUS, abs=1e-5)
    assert step.raw.position[..., 0].max() < 0.14 - RADIUS + ROUNDING_M


@generated
@given(centres)
@example(ASIDE)
def test_a_robot_has_left_the_board_when_its_axis_has(machine):
    step = slides(machine, (28, 15))
    x = step.samples.position[:, 0, 0]
    assert step.outcome == "out_of_board"
    assert x[-2] <= 0.3 < x[-1]


@generated
@given(centres)
@example(ASIDE)
def test_what_is_known_and_drawn_of_a_robot_is_where_its_axis_is(machine):
    """It turns after a blow off its centre of mass; its velocity is that of its axis, too."""
    config = replace(ICE.having("test", **machine), timing=TIMING)
    scenario = Scenario("ice", "", ((0, 0), (29, 29)), (((10, 15),), ((16, 16),)))
    step, kept = slides(machine, (10, 15), (16, 16)), Kept()
    with EpisodeRecorder(kept, scenario, config, "ice", {"seed": 0}) as recorder:
        recorder.write(step)
    drawn = read_episode(kept).signals["/world/r1/robot:translation"].values[-1]
    samples = step.samples
    np.testing.assert_allclose(drawn, samples.position[-1, 0], atol=1e-7)
    assert np.array_equal(samples.estimate[..., :2], samples.position[..., :2])
    ends = config.ticks_per_period * np.arange(1, len(samples.position)) + config.ticks_per_period
    moved = (step.raw.position[ends - 1] - step.raw.position[ends - 2]) / config.timing.dt_s
    np.testing.assert_allclose(moved, samples.velocity[1:], atol=2e-3)


@pytest.mark.parametrize("machine", [MIDDLE, {"com_x_m": 0.006, "com_y_m": 0.0}])
def test_a_payload_moves_no_outline(machine):
    world = World(payload_g=20.0, payload_offset_mm=(0.0, 8.0))
    step = slides(machine, (10, 15), (16, 15), world=world)
    distance = np.linalg.norm(np.diff(step.raw.position[..., :2], axis=1)[:, 0], axis=1)
    assert 2.0 * RADIUS - ROUNDING_M < distance.min() < 2.0 * RADIUS + 1e-5

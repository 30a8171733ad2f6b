"""What the 3D view shows of robots of any number, choice and machine; nothing is simulated.

Boards are not square, robots are not in order, and each place says its time.
"""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import rerun.blueprint as rrb
from scipy.spatial.transform import Rotation

from cosim.base.colours import robot_rgba
from cosim.coupling.rl_step import POSES_S, Step
from cosim.coupling.signals import new_raw_samples, new_samples
from cosim.model.config import CoSimConfig
from cosim.model.outcome import Outcome
from cosim.model.params import TIMING, Mount, feet_names
from cosim.model.preset import find_preset
from cosim.model.scenario import Scenario
from cosim.onboard.features import Observation
from cosim.recording.blueprint import episode_blueprint
from cosim.recording.episode import EpisodeRecorder
from cosim.recording.file import Kept
from cosim.recording.reader import read_episode
from cosim.recording.scene import SWARM
from cosim.recording.series import PolicyMap, signals_of

ROBOTS, CHOSEN = 12, (1, 9, 11)
NAMES = ["r2", "r10", "r12"]
CELLS = [(3 + 7 * (k % 6), 3 + 7 * (k // 6)) for k in range(ROBOTS)]
BOARD = Scenario("wide", "", tuple(CELLS[::-1]), tuple((cell,) for cell in CELLS), 60, 30)
RL_STEP_S = 0.25
AXES = (0.6, 0.0, 0.8), (-1.0, 0.0, 0.0)
MOUNTS = tuple(Mount((0.01 * k, 0.002, 0.004), axis) for k, axis in enumerate(AXES))


def machine() -> CoSimConfig:
    config = CoSimConfig(timing=TIMING._replace(rl_step_s=RL_STEP_S))
    return replace(config, robot=config.robot._replace(motors=MOUNTS))


def step(number: int, config: CoSimConfig, outcome: str = "") -> Step:
    """An RL step of some of many robots; x of every pose is its time in s, y is k mm of robot k."""
    periods = round(RL_STEP_S / TIMING.control_period_s)
    sizes = config.robot.sizes
    samples = new_samples(periods, len(CHOSEN), sizes)
    ends_s = number * RL_STEP_S + TIMING.control_period_s * np.arange(1, periods + 1)
    samples.position[..., 0] = ends_s[:, None]
    samples.position[..., 1] = 1e-3 * np.array(CHOSEN)
    samples.quaternion[..., 0] = 1.0
    samples.theta[:] = ends_s[:, None, None] * np.array([20.0, -7.0])
    first, last = number * RL_STEP_S / POSES_S, (number + 1) * RL_STEP_S / POSES_S
    times = POSES_S * np.arange(np.floor(first) + 1, np.floor(last) + 1)
    poses = np.zeros((len(times), ROBOTS, 7))
    poses[..., 0], poses[..., 1], poses[..., 3] = times[:, None], 1e-3 * np.arange(ROBOTS), 1.0
    none = np.zeros(ROBOTS, dtype=np.int64)
    seen = Observation(np.array(CELLS), none, none, none, np.array(BOARD.targets), np.array(CELLS))
    flags = np.zeros(ROBOTS, dtype=bool)
    ticks = round(number * RL_STEP_S / TIMING.dt_s)
    raw = new_raw_samples(0, len(CHOSEN), sizes)
    return Step(
        number, ticks, seen, seen, none, flags, flags, samples, raw, none, Outcome(outcome),
        RL_STEP_S, np.zeros(ROBOTS), CHOSEN, poses,
    )  # fmt: skip


@pytest.fixture(scope="module")
def kept() -> Kept:
    kept, config = Kept(), machine()
    maps = []
    for k in range(ROBOTS):  # robot k knows what to do in column k alone
        visits = np.zeros((BOARD.columns, BOARD.rows))
        visits[k, 3] = 1.0
        maps.append(PolicyMap(visits, np.full(visits.shape, k % 8), visits))
    chosen: Any = {"sampled": CHOSEN, "policies": maps}
    with EpisodeRecorder(kept, BOARD, config, "test", {"seed": 0}, **chosen) as recorder:
        for number in range(4):
            recorder.write(step(number, config, "timeout" if number == 3 else ""))
    return kept


def column(kept: Kept, entity: str, component: str, *, static: bool) -> list[Any]:
    """Rows of a component of an entity; those that change with their times in s."""
    found: list[Any] = []
    for chunk in kept.chunks:
        if chunk.entity_path != entity or chunk.is_static != static:
            continue
        batch = chunk.to_record_batch()
        names = [name for name in batch.schema.names if name.endswith(component)]
        values = batch.column(names[0]).to_pylist() if names else []
        if static:
            found += values
        elif names:
            times = batch.column("sim_time").cast("int64").to_pylist()
            found += [(1e-9 * time, value) for time, value in zip(times, values, strict=True)]
    return found


def test_poses_of_a_swarm_are_those_of_their_times(kept):
    rows = column(kept, SWARM, "InstancePoses3D:translations", static=False)
    assert [time_s for time_s, _ in rows] == pytest.approx(0.1 * np.arange(1, 11))
    for time_s, places in rows:
        expected = np.column_stack([np.full(ROBOTS, time_s), 1e-3 * np.arange(ROBOTS)])
        assert np.array(places)[:, :2] == pytest.approx(expected)
    for name, robot in zip(NAMES, CHOSEN, strict=True):
        rows = column(kept, f"/world/{name}/robot", "Transform3D:translation", static=False)
        for time_s, (place,) in rows:
            assert place[:2] == pytest.approx([time_s, 1e-3 * robot])


def test_chosen_robots_keep_their_order_colours_and_targets(kept):
    episode = read_episode(kept)
    assert list(episode.robots) == NAMES
    (colours,) = column(kept, "/world/targets", "Boxes3D:colors", static=True)
    (centres,) = column(kept, "/world/targets", "Boxes3D:centers", static=True)
    assert np.array(centres)[:, :2] == pytest.approx(0.01 * (np.array(CELLS[::-1]) + 0.5))
    for k, (name, robot) in enumerate(zip(NAMES, CHOSEN, strict=True)):
        (trail,) = column(kept, f"/world/{name}/trail", "LineStrips3D:colors", static=True)
        (curves,) = column(kept, f"/sim/{name}/yaw_rate", "SeriesLines:colors", static=True)
        assert [colours[robot], *trail] == [robot_rgba(k)] * 2
        assert robot_rgba(k) in curves
    assert len({colours[robot] for robot in range(ROBOTS) if robot not in CHOSEN}) == 1
    lines = [text for text in episode.texts["/log"].texts if "has not arrived" in text]
    end_m = np.column_stack([np.full(3, 4 * RL_STEP_S), 1e-3 * np.array(CHOSEN)])
    targets_m = 0.01 * (np.array(CELLS[::-1])[list(CHOSEN)] + 0.5)
    aways_cm = 100.0 * np.linalg.norm(targets_m - end_m, axis=1)
    assert lines == [
        f"{name} has not arrived: target {away_cm:.1f} cm away"
        for name, away_cm in zip(NAMES, aways_cm, strict=True)
    ]


def test_policies_and_outcome_are_where_they_belong(kept):
    for name, robot in zip(NAMES, CHOSEN, strict=True):
        path = f"/world/{name}/policy/greedy"
        parts = (
            column(kept, path, f"Arrows3D:{part}", static=True) for part in ("origins", "vectors")
        )
        (origin,), (vector,) = (np.array(rows[0]) for rows in parts)
        middle = origin + 0.5 * vector
        assert middle[:2] == pytest.approx([0.01 * (robot + 0.5), 0.035], abs=1e-6)
        assert np.arctan2(vector[1], vector[0]) % (2.0 * np.pi) == pytest.approx(
            robot % 8 * np.pi / 4
        )
    for _, (place,) in column(kept, "/world/outcome", "Points3D:positions", static=False):
        assert place[:2] == pytest.approx([0.3, 0.3])


def test_every_leg_has_its_names():
    robot = find_preset("hexbug").config().robot
    found = {
        signal.path: signal.names for signal in signals_of(robot, distances=False, camera=False)
    }
    names = [f"{foot} {axis}" for foot in feet_names(len(robot.feet)) for axis in "xyz"]
    assert list(found["sim/contact/deflection"]) == names
    assert len(names) > 9


def test_masses_turn_about_their_shafts_as_their_motors_do(kept):
    """By the right hand, from straight below, which is what Eq. (1) has."""
    robot, r_m = machine().robot, machine().motor.r
    rows = column(kept, "/world/r10/robot/motors/masses", "Points3D:positions", static=False)
    assert len(rows) > 20
    for time_s, masses in rows:
        for mass, mount, rate in zip(masses, MOUNTS, (20.0, -7.0), strict=True):
            axis = np.array(mount.axis)
            below = np.array([0.0, 0.0, -1.0])
            below -= (below @ axis) * axis
            turned = Rotation.from_rotvec(rate * time_s * axis).apply(below / np.linalg.norm(below))
            middle = np.array(mount.place_m) - (0.0, 0.0, robot.com_height_m)
            end = middle + 0.5 * robot.motor_length_m * axis
            assert mass == pytest.approx(end + r_m * turned, abs=1e-7)


def views(part: Any) -> list[rrb.Spatial3DView]:
    if isinstance(part, rrb.Spatial3DView):
        return [part]
    children = getattr(part, "contents", ())
    return [view for child in children if child is not part for view in views(child)]


def test_the_eye_stands_before_the_middle_of_a_board_that_is_not_square():
    board, policy = views(episode_blueprint(1, (0.6, 0.3), policies=True).root_container)[:2]
    eyes: list[Any] = [view.properties["EyeControls3D"] for view in (board, policy)]
    (eye,), (above,) = [found.position.as_arrow_array().to_pylist() for found in eyes]
    (target,) = eyes[0].look_target.as_arrow_array().to_pylist()
    assert [eye[0], target[0], *above[:2]] == pytest.approx([0.3, 0.3, 0.3, 0.15])
    assert eye[1] < 0.0 < target[1] < 0.3
    assert above[2] > 0.6


def test_lines_of_cells_and_the_zone_fit_a_board_that_is_not_square(kept):
    (board,) = column(kept, "/world/board", "LineStrips3D:strips", static=True)
    width, height = BOARD.size_m
    strips = [np.array(strip)[:, :2] for strip in board]
    across = [strip for strip in strips if strip[0, 1] == strip[1, 1]]
    assert len(across) == BOARD.rows + 1
    assert len(strips) == BOARD.columns + BOARD.rows + 2
    ends = np.concatenate(strips)
    assert (*ends.min(axis=0), *ends.max(axis=0)) == pytest.approx((0.0, 0.0, width, height))
    (outline,) = column(kept, "/world/zone", "LineStrips3D:strips", static=True)
    corners = np.array(outline[0])[:, :2] / BOARD.cell_m
    left, bottom, right, top = BOARD.zone
    lowest, highest = corners.min(axis=0), corners.max(axis=0)
    assert (*lowest, *highest) == pytest.approx((left, bottom, right + 1, top + 1))

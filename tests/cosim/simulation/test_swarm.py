"""Many robots in one episode: bits, signals of some of them, poses of all."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import minirobots as mr
from cosim.base.errors import UserError
from cosim.coupling.rl_step import sampled_of
from cosim.model.config import CoSimConfig
from cosim.model.params import SHIELD, TABLE_I
from cosim.model.scenario import Scenario
from cosim.model.scenario_file import find_scenario
from cosim.model.swarm import Swarm, lay_out
from cosim.onboard.features import Observation
from cosim.onboard.observing import draw_starts
from cosim.physics.lanes import host_lanes
from cosim.recording.episode import EpisodeRecorder
from cosim.recording.file import Kept
from cosim.recording.reader import read_episode
from cosim.recording.scene import SWARM
from cosim.simulation.batch import Batch
from docs.examples.swarm import Barrier, Local, ThroughDoor
from fmus.build import cached_fmu
from tests.alone import same

EXAMPLES = Path(__file__).parents[3] / "docs" / "examples"
ROBOTS = 70  # more than those whose signals are all kept
SCENARIO = Scenario("many", "", **lay_out(Swarm(ROBOTS, spacing=7), 100.0 * TABLE_I.diameter_m))
CONFIG = CoSimConfig(shield=SHIELD)
CONFIG = replace(CONFIG, timing=CONFIG.timing._replace(rl_step_s=0.35, episode_limit_s=1.0))


def steps_of(fmu, sampled=None, **options):
    starts = draw_starts(SCENARIO, np.random.default_rng(0))
    batch = Batch(fmu, CONFIG, ROBOTS, 1, **options)
    episode = batch.begin(0, SCENARIO, starts, np.random.SeedSequence(0), sampled=sampled)
    steps = [batch.advance({0: np.arange(ROBOTS) % 8})[0] for _ in range(2)]  # in all directions
    batch.close()
    return steps, episode.measures


@pytest.fixture(scope="module")
def driven():
    return steps_of(cached_fmu(), driver="fmpy")


@pytest.mark.long
def test_bits_depend_neither_on_lanes_nor_on_the_driver(driven):
    for options in ({"lanes": 2}, {"lanes": host_lanes()}):
        steps, measures = steps_of(cached_fmu(), **options)
        for step, other in zip(steps, driven[0], strict=True):
            assert same((step.poses, *step.samples), (other.poses, *other.samples))
        assert np.array_equal(measures.energy_j, driven[1].energy_j)
        assert measures.min_distance_m == driven[1].min_distance_m


def test_signals_of_chosen_robots_are_those_of_all(driven):
    steps, measures = steps_of(cached_fmu(), sampled=tuple(range(ROBOTS)))
    assert [step.sampled for step in driven[0]] == [(0, 1, 2, 3)] * 2
    for step, some in zip(steps, driven[0], strict=True):
        assert same((every[:, :4] for every in step.samples), some.samples)
        assert np.array_equal(step.moved_m, some.moved_m)
        assert step.poses.shape == (0, ROBOTS, 7)
    position = np.concatenate([step.samples.position for step in steps])
    poses = np.concatenate([step.poses for step in driven[0]])
    assert np.array_equal(poses[..., :3], position[99::100])
    distances = np.linalg.norm(position[:, :, None, :2] - position[:, None, :, :2], axis=3)
    distances[:, np.arange(ROBOTS), np.arange(ROBOTS)] = np.inf
    assert measures.min_distance_m == pytest.approx(distances.min(), abs=1e-12)


def test_a_recording_has_poses_of_all_and_signals_of_some_which_views_show(driven, shown_paths):
    kept = Kept()
    with EpisodeRecorder(kept, SCENARIO, CONFIG, "many", {"seed": 0}) as recorder:
        for step in driven[0]:
            recorder.write(step)
    episode = read_episode(kept)
    assert episode.facts["signals"] == [1, 2, 3, 4]
    signals = episode.signals
    assert {name.split("/")[2] for name in signals if "/sim/" in name} == {"r1", "r2", "r3", "r4"}
    assert "/sim/r1/distance_m" not in signals
    shown = shown_paths(kept.blueprint)
    assert "/sim/r4/position" in shown
    assert not [path for path in shown if path.endswith(("/distance", "/distance_m"))]
    others = [c for c in kept.chunks if c.entity_path == SWARM and not c.is_static]
    assert sum(chunk.num_rows for chunk in others) == sum(len(step.poses) for step in driven[0])


def test_what_is_told_of_sampled_robots_is_theirs(driven):
    step = driven[0][0]._replace(events=np.arange(ROBOTS), sampled=(1, 3))
    assert step.of_sampled().events.tolist() == [1, 3]


def test_a_single_episode_has_the_signals_of_chosen_robots(straight_policy):
    policy = straight_policy(find_scenario("4-cross").targets)
    options = {"record": "summary", "time_limit": 2.0, "progress": None}
    episode = mr.simulate("4-cross", policy, signals=(2, 4), **options)
    names = {name.split("/")[2] for name in episode.signals if name.startswith("/sim/")}
    assert names == {"r2", "r4"}


def test_robots_whose_signals_are_kept_are_named_from_one():
    assert sampled_of(64) == tuple(range(64))
    assert sampled_of(65) == (0, 1, 2, 3)
    assert sampled_of(65, (65, 2)) == (1, 64)  # rising: names and signals are in one order
    for named in ((0,), (66,), (3, 3)):
        with pytest.raises(UserError, match=r"signals = .* must name different robots from 1 to"):
            sampled_of(65, named)


def test_the_rules_of_the_example_keep_off_robots_and_walls():
    still = np.zeros(2, dtype=int)

    def directions(rule, cells, targets):
        return rule.act(Observation(cells, still, still, still, targets, cells)).tolist()

    facing = np.array([[10, 20], [18, 20]])
    east, west = directions(Local(), facing, np.array([[24, 20], [4, 20]]))
    assert east in (6, 7)
    assert west in (2, 3)
    far = np.array([[4, 20], [24, 20]])
    assert directions(Barrier(), far, far[::-1]) == [0, 4]
    for near in ([[10, 20], [16, 20]], [[10, 20], [15, 20]]):
        east, west = directions(Barrier(), np.array(near), far[::-1])
        assert east in (2, 3, 4, 5, 6)
        assert west in (6, 7, 0, 1, 2)
    door = find_scenario(EXAMPLES / "door.toml")
    behind_the_wall, targets = np.array([[60, 10], [63, 30]]), np.array(door.targets[:2])
    up, along = directions(ThroughDoor(), behind_the_wall, targets)
    assert up in (1, 2)
    assert along in (7, 0, 1)

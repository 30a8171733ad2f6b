"""Episodes that kernels alone play have the bits of a batch, and policies choose the same."""

import json
import math
import re
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from agent.mdp.config import ProcessConfig
from agent.mdp.interpretations import build_process
from agent.training.methods import method_config
from agent.training.policy import GroupPolicy, PairPolicy, PolicyConfig, Seed, table_policy
from agent.training.settings import LearningConfig
from agent.training.store import find_or_make
from agent.web import playing
from agent.web.page import _html
from agent.web.playing import deciding, new_play, start
from cosim.model.config import CoSimConfig
from cosim.model.outcome import BY_RANK
from cosim.model.params import SHIELD
from cosim.model.preset import find_preset
from cosim.model.scenario import Scenario
from cosim.model.scenario_file import find_scenario
from cosim.model.world import Patch, Sensor, World
from cosim.onboard.features import DIRECTION_COUNT, DISTANCE_CLASSES, Observation
from cosim.onboard.observing import draw_starts
from cosim.physics.draws import CAMERA_CHILD, DETOUR_CHILD, WORLD_CHILD, generator
from cosim.physics.properties import GRAVITY
from cosim.simulation.batch import Batch
from cosim.simulation.options import DecisionOptions, Setup
from cosim.simulation.rules import USED
from tests.agent.moves.test_pair import MOVES

FACING = Scenario("facing", "", ((15, 24), (15, 5)), (((15, 10),), ((15, 19),)))
NEAR = Scenario("near", "", ((3, 6), (9, 6)), (((3, 7),), ((9, 5),)), 13, 13, zone=(0, 0, 0, 0))
ROUGH = World(motor_spread=0.1, sensor=Sensor(30.0, 50.0, 0.5, 1.0, 0.1))
SLOPE = World(
    motor_spread=0.05, floor_tilt_deg=1.0, mu_patches=(Patch((10, 8, 20, 13), 0.1),), edge=True
)
SEED = np.random.SeedSequence(3)
PROMPT = CoSimConfig().merged(DecisionOptions(through=True).tree())


def uniform_numbers(play):
    """Fill the arrays of a play before every RL step."""
    motors, cameras = (
        [generator(SEED, first + k) for k in range(count)]
        for first, count in ((0, len(play.noise_draws)), (CAMERA_CHILD, len(play.sight_draws)))
    )
    detours, room = generator(SEED, DETOUR_CHILD), play.moves.detours
    while True:
        draws = -(-(len(play.noise) - int(play.left[0])) // play.hold)
        for rng, row in zip(motors, play.noise_draws, strict=True):
            rng.random(out=row[:draws])
        for rng, row in zip(cameras, play.sight_draws, strict=True):
            rng.random(out=row)
        used = play.moves.counts[USED]
        room[:] = np.roll(room, -used)
        detours.random(out=room[len(room) - used :])
        play.moves.counts[USED] = 0
        yield


def test_legs_lead_from_their_tips_to_the_body():
    robot = find_preset("pogobot-brush").config().robot
    given = [foot.leg for foot in robot.feet if foot.leg]
    legs = [leg._replace(lean_towards_deg=30.0 + 50.0 * k) for k, leg in enumerate(given)]
    feet = tuple(foot._replace(leg=leg) for foot, leg in zip(robot.feet, legs, strict=True))
    config = CoSimConfig(robot=robot._replace(feet=feet))
    policy, *_ = find_or_make(method_config("shortest", NEAR))
    page = _html(policy, Setup(NEAR, config, Path()), [], 0)
    found = re.search(r'id="data">(.*)</script>', page)
    assert found is not None
    machine = json.loads(found[1])["machine"]
    for (x, y), leg in zip(machine["legs"], legs, strict=True):
        level_m = leg.length_m * math.sin(math.radians(leg.lean_deg))
        towards = math.radians(leg.lean_towards_deg + 180.0)
        assert (x, y) == pytest.approx((level_m * math.cos(towards), level_m * math.sin(towards)))
    assert [place for _, place in machine["feet"]] == [[foot.x_m, foot.y_m] for foot in feet]


def begin_at(play, starts):
    """Start an episode in a world that is drawn again."""
    drawn = play.state.bodies.properties[:, : len(starts)]
    drawn[GRAVITY : GRAVITY + 3] = drawn[-4:] = np.nan
    generator(SEED, WORLD_CHILD).random(out=play.varied.draws)
    play.cells[:] = starts
    start(play)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("scenario", "config"),
    [
        (FACING, CoSimConfig()),
        (FACING, CoSimConfig(world=ROUGH, shield=SHIELD)),
        (FACING, CoSimConfig(world=SLOPE)),
        (find_scenario("4-cross"), replace(PROMPT, shield=SHIELD)),
        (find_scenario("1a"), CoSimConfig()),
    ],
    ids=["pair", "camera and shield", "slope", "four robots", "one robot"],
)  # fmt: skip
def test_kernels_alone_play_the_episode_of_a_batch(motor_fmu, straight_policy, scenario, config):
    config = replace(config, timing=config.timing._replace(episode_limit_s=9.0))
    starts = draw_starts(scenario, np.random.default_rng(3))
    policy = straight_policy(scenario.targets)
    batch, others = (Batch(motor_fmu, config, scenario.robots, 1) for _ in range(2))
    elsewhere = draw_starts(scenario, np.random.default_rng(4))
    episode = batch.begin(0, scenario, starts, SEED)
    other = others.begin(0, scenario, elsewhere, SEED)  # motors with the same parameters
    play = new_play(others, other)
    begin_at(play, starts)
    assert np.array_equal(others.state.bodies.properties, batch.state.bodies.properties)
    for robot, motors in enumerate(episode.drawn.motors):
        own = [(motor.K_T, motor.R, motor.J, motor.r) for motor in motors]
        assert play.varied.own[:, :, robot].T.tolist() == [list(values) for values in own]
    for _ in uniform_numbers(play):
        assert all(map(np.array_equal, play.moves.seen, episode.observation))
        directions = policy.act(episode.observation)
        step = batch.advance({0: directions})[0]
        play.wanted[:] = directions
        outcome, periods = BY_RANK[playing.step(play)], int(play.state.episodes.periods[0])
        for signal, mine in zip(step.samples, play.samples, strict=True):
            part = np.ascontiguousarray(mine[:periods, : scenario.robots])
            assert part.tobytes() == np.ascontiguousarray(signal).tobytes()
        assert np.array_equal(play.moves.action, step.action)
        assert outcome == episode.outcome
        if outcome:
            break
    assert episode.conflicts == other.conflicts
    assert (episode.conflicts > 0) == (config.shield is not None)
    batch.close()
    others.close()


def seen_by(scenario, rng):
    """Return what robots could see, in cells that they can be in, some under way."""
    n, last = scenario.robots, (scenario.columns, scenario.rows)
    cells = rng.integers(0, last, (n, 2))
    goals = np.where(rng.random((n, 1)) < 0.5, cells, cells + rng.integers(-1, 2, (n, 2)))
    classes, signs = rng.integers(len(DISTANCE_CLASSES), size=n), rng.integers(-1, 2, n)
    facing = rng.integers(DIRECTION_COUNT, size=n)
    return Observation(cells, classes, signs, facing, np.array(scenario.targets), goals)


class Seen(NamedTuple):
    """What policies' kernels need of a play's moves."""

    seen: Observation
    awaiting: np.ndarray


class Deciding(NamedTuple):
    """What policies' kernels need of a play."""

    decides: Any
    moves: Seen
    wanted: np.ndarray


def chosen(policy, seen):
    """Directions that the kernel of a policy chooses."""
    name, decides = deciding(policy)
    play = Deciding(decides, Seen(seen, np.ones(2, dtype=bool)), np.zeros(2, dtype=np.int64))
    getattr(playing, name)(play)
    return play.wanted.tolist()


@pytest.mark.parametrize("features", [("x", "y", "d", "g", "b"), ("x", "y", "p"), ("x", "y", "h")])
def test_tables_of_best_directions_are_followed_like_values(features):
    config = PolicyConfig(NEAR, ProcessConfig(features=features), LearningConfig(), Seed(0))
    rng = np.random.default_rng(0)
    count = build_process(NEAR, config.process).state_count
    # with many equal ones
    values = rng.integers(0, 3, (2, count, DIRECTION_COUNT)).astype(np.float32)
    policy = table_policy(config, values, np.ones(values.shape[:2], dtype=bool))
    for _ in range(200):
        seen = seen_by(NEAR, rng)
        assert chosen(policy, seen) == policy.act(seen).action.tolist()


@pytest.mark.long
@pytest.mark.parametrize("method", ["fastest", "planned"])
def test_pairs_and_groups_choose_like_their_policies(method):
    features = ("x", "y", "h", "p") if method == "fastest" else ("x", "y", "h")
    process = ProcessConfig(features=features)
    config = PolicyConfig(NEAR, process, LearningConfig(), Seed(0), MOVES, method)
    policy = {"fastest": PairPolicy, "planned": GroupPolicy}[method].computed(config)
    rng = np.random.default_rng(0)
    for _ in range(100):
        seen = seen_by(NEAR, rng)
        assert chosen(policy, seen) == policy.act(seen).action.tolist()

"""Networks for all robots: what they see, how they are trained, and their policies in commands."""

import json
from dataclasses import replace
from typing import Any

import msgspec
import numpy as np
import pytest

import agent
from agent.deep.inputs import GROUPS, NOTHING, REACH, Inputs, look_at_boards
from agent.deep.learning_grid import SHAPING, DrawnTargets, LearningGrid, values_alone
from agent.deep.policy import Network, NetworkConfig, NetworkPolicy
from agent.envs import parallel_env
from agent.mdp.config import ProcessConfig
from agent.mdp.exact import joint_starts
from agent.mdp.greedy import PolicyError
from agent.mdp.readings import FREE, GOAL, build_process
from agent.training.policy import Seed
from cosim.base.progress import silent
from cosim.model.outcome import TIMEOUT, Outcome
from cosim.model.scenario import Scenario
from cosim.model.scenario_file import find_scenario
from cosim.onboard.features import DIRECTIONS, Observation

pytestmark = pytest.mark.long  # it trains networks

TINY = """
title = "two robots on a small board"
columns = 4
rows = 4
cell_m = 0.05
zone = [1, 1, 2, 2]

[[robots]]
target = [1, 1]
starts = "top"

[[robots]]
target = [2, 2]
starts = "bottom"
"""
WALLED = Scenario(
    "walled", "", ((5, 25), (25, 5)), (((5, 5),), ((25, 25),)), obstacles=((15, 15), (15, 16))
)


def network(scenario, seed=0, step_limit=60):
    """A policy of a network with random weights."""
    config = NetworkConfig(scenario, ProcessConfig(step_limit=step_limit), "ippo", 0, Seed(seed))
    inputs = Inputs.of(scenario, build_process(scenario, config.process))
    random = np.random.default_rng(seed)
    shapes = [(inputs.first[-1], 16), 16, (16, 16), 16, (16, 8), 8]
    parts = (random.normal(size=shape).astype(np.float32) for shape in shapes)
    return NetworkPolicy(config, Network(*parts), 0)


@pytest.fixture(scope="module", autouse=True)
def small_rounds():
    """Few boards and moves, and evaluations after few steps."""
    from agent.deep import ddqn, learners

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(learners, "BOARDS", 32)
        patch.setattr(learners, "ROUND", 3000)
        patch.setattr(ddqn, "_BATCH", 128)
        yield


@pytest.fixture(scope="module")
def tiny(tmp_path_factory):
    path = tmp_path_factory.mktemp("tiny") / "tiny.toml"
    path.write_text(TINY)
    return path


@pytest.mark.long
def test_a_learner_masters_a_small_board_and_commands_take_its_policy(tiny, tmp_path, command):
    options = ("--scenario", tiny, "--algorithm", "ddqn", "--steps", 5000, "--json")
    done = command("deep", *options, "--out", tmp_path / "out")
    assert done.returncode == 0, done.stderr
    report = json.loads(done.stdout.splitlines()[-1])
    assert report["success"] > 0.9
    untrained = network(find_scenario(str(tiny))).evaluate()
    assert untrained.rate(Outcome.SUCCESS) < 0.5
    policy = agent.load(report["policy"])
    assert isinstance(policy, NetworkPolicy)
    assert policy.evaluate().rate(Outcome.SUCCESS) == report["success"]
    assert policy.episodes > 200
    ran = command(
        "run",
        *("--scenario", tiny, "--policy", report["policy"], "--time-limit", 4),
        *("--out", tmp_path / "run"),
    )
    assert ran.returncode == 0, ran.stderr
    assert json.loads((tmp_path / "run" / "summary.json").read_text())["method"] == "ddqn"
    options = ("--starts", 2, "--time-limit", 4, "--out", tmp_path / "dynamics", "--json")
    evaluated = command("evaluate", report["policy"], *options)
    assert evaluated.returncode == 0, evaluated.stderr
    (row,) = json.loads(evaluated.stdout.splitlines()[-1])["policies"]
    assert (row["episodes"], row["out_of_board"]) == (2, 0.0)


@pytest.mark.slow
def test_a_critic_that_sees_all_robots_teaches_too(tiny, tmp_path, command):
    options = ("--scenario", tiny, "--algorithm", "mappo", "--steps", 12_000, "--json")
    done = command("deep", *options, "--out", tmp_path)
    assert done.returncode == 0, done.stderr
    report = json.loads(done.stdout.splitlines()[-1])
    assert max(success for *_, success in report["curve"]) == report["success"]
    assert report["success"] > report["curve"][0][2] + 0.1


@pytest.mark.long
@pytest.mark.parametrize("algorithm", ["ddqn", pytest.param("ippo", marks=pytest.mark.slow)])
def test_the_same_seed_gives_the_same_bits(algorithm, tiny):
    from agent.deep.learners import train

    scenario = find_scenario(str(tiny))

    def trained(seed):
        config = NetworkConfig(scenario, SHAPING[algorithm].process, algorithm, 3000, Seed(seed))
        return train(config, silent, lambda _: None)

    first, again, other = trained(3), trained(3), trained(4)
    assert first.digest() == again.digest() != other.digest()


def test_only_networks_of_drawn_targets_act_where_targets_are_others():
    policy = network(find_scenario("2"))
    other = replace(find_scenario("2"), targets=((4, 20), (25, 5)), starts=(((1, 1),), ((9, 9),)))
    with pytest.raises(PolicyError, match="was trained on scenario 2"):
        policy.in_scenario(other)
    config = msgspec.structs.replace(policy.config, any_target=True)
    policy = replace(policy, config=config)
    assert policy.in_scenario(other).inputs.targets.tolist() == [[4, 20], [25, 5]]
    with pytest.raises(PolicyError, match="was trained on scenario 2"):
        policy.in_scenario(replace(other, cell_m=0.011))


@pytest.mark.slow
def test_a_network_of_drawn_targets_drives_to_others():
    from agent.deep.learners import train

    scenario = Scenario("lone", "", ((1, 1),), (((4, 4), (4, 0)),), 6, 6, 0.05, (2, 2, 3, 3))
    config = NetworkConfig(
        scenario, SHAPING["ddqn"].process, "ddqn", 5000, Seed(1), any_target=True
    )
    policy = train(config, silent, lambda _: None)
    moved = policy.in_scenario(replace(scenario, targets=((3, 5),)))
    assert moved.evaluate().rate(Outcome.SUCCESS) == 1.0


def test_targets_are_drawn_again_and_episodes_cut():
    world = DrawnTargets(WALLED, 15, 0, SHAPING["ddqn"])
    before = [grid.inputs.targets.tolist() for grid in world._grids]
    assert len({str(targets) for targets in before}) > 10
    cut = np.zeros(30, dtype=int)
    for _ in range(20):
        possible = world.observations()[:, GROUPS:]
        cut += world.step(possible.argmax(axis=1)).truncated
    after = [grid.inputs.targets.tolist() for grid in world._grids]
    assert [a != b for a, b in zip(before, after, strict=True)] == [k in (1, 2) for k in range(15)]
    assert cut[2:6].min() == 1
    assert not np.delete(cut, range(2, 6)).any()


def test_ppo_learns_from_moves_only(monkeypatch):
    from agent.deep import ppo

    monkeypatch.setattr(ppo, "_STEPS", 4)
    memory: Any = ppo.Moves(6, 0)
    names, sizes = ["observations", "advantages"], (2, 1)
    for name, size in zip(names, sizes, strict=True):
        memory.create_tensor(name, size=size, dtype=np.float32)
    random = np.random.default_rng(0)
    for _ in range(4):
        seen = random.integers(0, 5, (6, 2)).astype(np.float32)
        seen[random.permutation(6)[:2]] = NOTHING
        advantages = np.where(seen[:, :1] == NOTHING, 99.0, random.normal(3.0, 2.0, (6, 1)))
        memory.add_samples(observations=seen, advantages=advantages.astype(np.float32))
    batches = memory.sample(names, batch_size=24, mini_batches=3)
    seen, advantages = (np.concatenate(part) for part in zip(*batches, strict=True))
    assert [len(batch[0]) for batch in batches] == [8, 8, 8]
    assert (seen != NOTHING).all()
    drawn, times = np.unique(advantages, return_counts=True)
    assert set(times) == {1, 2}
    assert (len(drawn), drawn.mean(), drawn.std()) == pytest.approx((16, 0.0, 1.0), abs=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("central", [False, True])
def test_ppo_learns_from_its_moves(monkeypatch, central):
    from agent.deep import ppo

    monkeypatch.setattr(ppo, "_STEPS", 4)
    monkeypatch.setitem(ppo._CONFIG, "rollouts", 4)
    sampled, sample = [], ppo.Moves.sample
    monkeypatch.setattr(
        ppo.Moves, "sample", lambda self, *a, **k: sampled.append(k) or sample(self, *a, **k)
    )
    world = LearningGrid(find_scenario("2"), 8, 0, SHAPING["ippo"])
    learner = ppo.Ppo(world, find_scenario("2"), 0, central)
    before = learner.network()
    for _ in range(4):
        assert not sampled
        learner.advance(world)
    assert len(sampled) == ppo._CONFIG["learning_epochs"]
    after = learner.network()
    assert all((a != b).any() for a, b in zip(before, after, strict=True))


def test_training_ends_where_it_is_enough(tiny):
    from agent.deep.learners import train

    config, curve = (
        NetworkConfig(find_scenario(str(tiny)), SHAPING["ddqn"].process, "ddqn", 6000, Seed(0)),
        [],
    )
    train(config, silent, curve.append, enough=0.0)
    assert len(curve) == 1


def test_a_network_in_numpy_is_the_network_in_jax():
    import jax.numpy as jnp

    from agent.deep.ppo import Ppo

    scenario = find_scenario("4")
    world = LearningGrid(scenario, 64, 0, SHAPING["mappo"])
    learner = Ppo(world, scenario, 0, central=True)
    config = NetworkConfig(scenario, ProcessConfig(), "mappo", 0, Seed(0))
    policy = NetworkPolicy(config, learner.network(), 0)
    observations = world.observations()
    theirs, _ = learner.actor.apply(
        learner.actor.state_dict.params, {"observations": jnp.asarray(observations)}, "policy"
    )
    cells = world.cells().reshape(64, 2, 2, 2)[:, 0].astype(np.int64)
    ours = np.concatenate([policy.q_values(seen(both)) for both in cells])
    possible = observations[:, GROUPS:] > 0
    assert possible.sum() > 900
    assert np.abs(ours - np.asarray(theirs))[possible].max() < 1e-4


def seen(cells):
    n = len(cells)
    nothing = np.zeros(n, dtype=np.int64)
    return Observation(
        cells=cells, distance_class=nothing, gradient_sign=nothing, direction=nothing
    )


def test_inputs_are_offsets_from_target_and_nearest_robot():
    inputs = Inputs.of(WALLED, build_process(WALLED, ProcessConfig()))
    rows, possible = np.zeros((1, 2, GROUPS), np.float32), np.zeros((1, 2, 8), np.float32)
    look_at_boards(inputs, np.array([[[0, 24], [7, 20]]]), rows, possible, 30)
    numbers = (rows[0] - inputs.first[:GROUPS]).astype(int)
    own = [0, 0, 24, REACH - 5, REACH - 1]
    assert numbers[0].tolist() == [*own, REACH + 7, REACH - 4, 0, 4]
    other = [1, 7, 20, 0, 2 * REACH]
    assert numbers[1].tolist() == [*other, REACH - 7, REACH + 4, 0, 1]
    assert possible[0].astype(int).tolist() == [[1, 1, 1, 0, 0, 0, 1, 1], [1] * 8]
    alone = find_scenario("1a")
    inputs = Inputs.of(alone, build_process(alone, ProcessConfig()))
    look_at_boards(inputs, np.array([[[3, 4]]]), rows[:, :1], possible[:, :1], 30)
    assert rows[0, 0, 5:].tolist() == [NOTHING] * 4


def test_moves_off_the_board_and_into_obstacles_are_never_chosen():
    policy = network(WALLED)
    terrain = policy.process.terrain[0]
    best, forbidden = [], 0
    for x, y in np.argwhere(terrain[1:-1, 1:-1] == FREE).tolist():
        values = policy.q_values(seen(np.array([[x, y], [25, 25]])))[0]
        after = DIRECTIONS + np.array([x, y])
        allowed = np.isin(terrain[after[:, 0] + 1, after[:, 1] + 1], (FREE, GOAL))
        assert values[allowed].min() > values[~allowed].max(initial=-np.inf)
        best.append(values.argmax())
        forbidden += np.count_nonzero(~allowed)
    assert len(set(best)) > 2
    assert forbidden > 400  # the rim alone has 356


def test_a_robot_alone_is_worth_what_the_fewest_moves_earn():
    process = build_process(WALLED, ProcessConfig(goal_reward=7.0))
    values = values_alone(process, 0.95)[0].reshape(30, 30)
    assert [values[5, 25], values[6, 26], values[5, 22]] == [0.0, 7.0, pytest.approx(4.36750)]
    assert values[15, 15] == values.min()  # inside an obstacle


@pytest.mark.parametrize("algorithm", ["ddqn", "ippo"])
def test_shaping_adds_what_a_robot_alone_gains(algorithm):
    shaping = SHAPING[algorithm]
    plain = LearningGrid(WALLED, 1, 0, shaping)
    cells = plain.cells()[0, :2].astype(int)
    before = plain._height[0]
    possible = np.flatnonzero(plain.observations()[0, GROUPS:])
    now = plain.step(np.array([possible[0], np.flatnonzero(plain.observations()[1, GROUPS:])[0]]))
    assert (plain.cells()[0, :2].astype(int) != cells).any()
    gain = shaping.gamma * plain._height[0] - before
    assert now.rewards[0] == pytest.approx(0.1 * (plain._boards.arrays.rewards[0, 0] + gain))
    assert abs(gain) > 0.2


def test_training_has_the_readings_that_the_file_tells(tiny):
    from agent.deep import learners

    scenario, usual = find_scenario(str(tiny)), SHAPING["ddqn"].process

    def trained(process):
        config = NetworkConfig(scenario, process, "ddqn", 3000, Seed(0))
        return learners.train(config, silent, lambda _: None)

    other = trained(replace(usual, step_cost=2.0 * usual.step_cost))
    assert not np.array_equal(other.network.w1, trained(usual).network.w1)


def test_evaluation_is_exact_whatever_slips_in_training():
    policy = network(find_scenario("2"), 3)
    slippery = replace(policy.config.process, slip_probability=0.5)
    config = msgspec.structs.replace(policy.config, process=slippery)
    starts = joint_starts(policy.process)[::100]
    ended = replace(policy, config=config).evaluate(starts)
    assert np.array_equal(ended.outcome, policy.evaluate(starts).outcome)


@pytest.mark.parametrize("step_limit", [60, 61])
def test_evaluation_is_what_the_environment_says(step_limit):
    policy = network(find_scenario("2"), 3, step_limit)
    result = policy.evaluate()
    assert np.count_nonzero(result.outcome[::100] == TIMEOUT) > 1  # those circle
    env = parallel_env("2", policy.config.process)
    for k in range(0, 900, 100):
        env.reset(options={"starts": result.starts[k]})
        cells, info = result.starts[k].copy(), {}
        moved = dict.fromkeys(env.possible_agents, 0)
        while env.agents:
            moved |= {name: moved[name] + 1 for name in env.agents}
            actions = policy.act(seen(cells)).action
            observations, *_, infos = env.step(
                {agent: int(a) for agent, a in zip(env.possible_agents, actions, strict=True)}
            )
            info |= infos
            for name, row in observations.items():
                cells[int(name[-1]) - 1] = row[:2]
        outcomes = [entry["outcome"] for entry in info.values()]
        assert result.outcome[k] in outcomes
        paths = [info[name]["path_length"] for name in env.possible_agents]
        assert paths == pytest.approx(result.path_cells[k].tolist())
        assert list(moved.values()) == result.steps[k].tolist()


def test_policies_are_saved_and_read_back_and_others_are_refused(tmp_path):
    policy, path = network(find_scenario("2")), tmp_path / "policy.npz"
    policy.save(path)
    again = agent.load(path)
    assert isinstance(again, NetworkPolicy)
    assert again.config == policy.config
    assert all(np.array_equal(a, b) for a, b in zip(again.network, policy.network, strict=True))
    with pytest.raises(PolicyError, match="was trained on scenario 2"):
        agent.load(path, find_scenario("4"))
    with pytest.raises(ValueError, match="off the board"):
        again.q_values(seen(np.array([[0, 30], [3, 3]])))
    smaller = NetworkPolicy(policy.config, policy.network._replace(b3=np.zeros(7, np.float32)), 0)
    smaller.save(path)
    with pytest.raises(PolicyError, match="do not fit"):
        agent.load(path)
    assert [picture.value.shape for picture in policy.maps()] == [(30, 30)] * 2


def test_a_missing_extra_is_named(monkeypatch, command, tmp_path):
    monkeypatch.setattr("agent.deep.find_spec", lambda name: None)
    done = command("deep", "--out", tmp_path / "out")
    assert done.returncode == 2
    assert "uv sync --extra deep" in done.stderr
    assert not (tmp_path / "out").exists()

"""The C of a page's episode against the kernels: poses, times and outcomes in every bit."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest

import agent
from agent.mdp.greedy import PolicyError
from agent.web.packing import load_page_policy, pack, require_playable
from cosim.base.errors import UserError
from cosim.model.config import ConfigError
from cosim.model.scenario import Scenario
from cosim.model.scenario_file import find_scenario
from cosim.model.world import World
from cosim.simulation.options import SimulationOptions, resolve
from tests.agent.deep.test_deep import network
from tests.agent.firmware.test_firmware import random_policy
from tests.references.native import compile_page
from tests.references.web_episode import NativeEpisode, steps_of

pytestmark = pytest.mark.long  # it compiles C, and plays whole episodes


@pytest.fixture(scope="session")
def library(tmp_path_factory):
    out = tmp_path_factory.mktemp("web") / "library.so"
    compile_page(out)
    return out


def compare(library, policy, seeds, world=None, targets: tuple = (), **options) -> list[str]:
    """Compare episodes of the C with those of the kernels; how they ended.

    With targets, those of the kernels have them, and the C has them set after the start.
    """
    given = policy.config.scenario if world is None else policy.config.scenario.name
    asked = SimulationOptions(portable=True, **options)
    setup = resolve(asked, given, world=world)
    scenario, config, _ = setup
    episode, n = NativeEpisode(library, pack(policy, scenario, config)), scenario.robots
    if targets:
        setup = setup._replace(scenario=replace(scenario, targets=targets))
        policy = policy.in_scenario(setup.scenario)
    outcomes = []
    for seed in seeds:
        episode.begin(seed)
        for robot, cell in enumerate(targets):
            assert episode.aim(robot, *cell)
        for simulation, step in steps_of(policy, setup, seed):
            outcome, view = episode.advance(config.periods_per_step), episode.view()
            ours = view["position"].reshape(-1, 3)[:n]
            assert ours.tobytes() == step.samples.position[-1].tobytes(), (seed, step.number)
            assert view["omega"][: 2 * n].tobytes() == step.samples.omega[-1].tobytes()
            assert view["voltage"][: 2 * n].tobytes() == step.samples.voltage[-1].tobytes()
            assert view["time_s"][0] == simulation.time_s
            assert outcome == simulation.outcome
            if outcome:
                path = simulation.measures.path_length_m
                assert view["path_m"][:n] == pytest.approx(path, rel=1e-12)
                outcomes.append(str(outcome))
    return outcomes


def test_robot_alone_has_the_bits_of_the_kernels(library):
    policy = agent.train("1a", method="shortest")
    assert compare(library, policy, [0]) == ["success"]


def test_robots_that_touch_have_the_bits_of_the_kernels(library):
    scenario = Scenario("meet", "", ((5, 12), (24, 12)), (((20, 12),), ((9, 13),)))
    policy = agent.train(scenario, method="paper", episodes=1)
    assert "timeout" in compare(library, policy, [3], on_collision="continue", time_limit=60.0)


@pytest.mark.slow
def test_obstacles_and_bounces_have_the_bits_of_the_kernels(library):
    policy = agent.train("5-doorway", method="shortest")
    compare(library, policy, [1], world={"restitution": 0.2}, time_limit=60.0, noise=0.1)


@pytest.mark.slow
def test_tables_of_all_features_decide_as_the_policy_does(library):
    scenario = Scenario(
        "small", "", ((9, 9), (2, 2)), (((9, 2),), ((2, 9),)), 12, 12, zone=(5, 5, 6, 6)
    )
    policy = random_policy(scenario, "xdgbhp", np.random.default_rng(3))
    compare(library, policy, range(3), time_limit=60.0)


@pytest.mark.long
@pytest.mark.parametrize("shield", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_unequal_motors_seen_by_a_camera_have_the_bits_of_the_kernels(library, shield):
    policy = random_policy(find_scenario("4-ring"), "xydgb", np.random.default_rng(3))
    world = "cosim/model/worlds/rough.toml"
    compare(library, policy, [1], world=world, shield=shield, time_limit=12.0)


@pytest.mark.parametrize("name", ["1a", "4-ring"])
def test_networks_have_the_bits_of_the_kernels(library, name):
    policy = network(find_scenario(name), 3)
    compare(library, policy, [1], shield=True, time_limit=16.0, on_collision="continue")


def test_robots_whose_targets_are_set_have_the_bits_of_other_scenarios(library):
    policy = network(find_scenario("4-ring"), 3)
    policy = replace(policy, config=msgspec.structs.replace(policy.config, any_target=True))
    targets = ((24, 9), (12, 4), (15, 25), (5, 12))
    compare(library, policy, [1], targets=targets, shield=True, time_limit=16.0)


def test_loads_phases_and_slopes_have_the_bits_of_the_kernels(library):
    policy = random_policy(find_scenario("4-ring"), "xydgb", np.random.default_rng(3))
    load = {"payload_g": 5.0, "payload_offset_mm": (4.0, -3.0), "restitution": 0.2}
    world = load | {"motor_phases_deg": tuple(range(0, 320, 40))}
    compare(library, policy, [2], world=world, on_collision="continue", time_limit=16.0)
    slope = {"floor_tilt_deg": 6.0, "edge": True}
    ended = compare(library, policy, [2, 5], world=slope, on_collision="continue")
    assert ended == ["out_of_board"] * 2


@pytest.mark.slow
@pytest.mark.parametrize("name", ["1a", "2", "4", "5-doorway"])
def test_a_rough_world_has_the_bits_of_the_kernels(library, name):
    policy = agent.train(name, method="shortest")
    compare(library, policy, range(4), world="cosim/model/worlds/rough.toml", time_limit=100.0)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["2", "4", "5-doorway"])
def test_the_shield_has_the_bits_of_the_kernels(library, name):
    policy = agent.train(name, method="shortest")
    compare(library, policy, range(5), shield=True, time_limit=100.0)


def test_robots_that_yield_and_retreat_have_the_bits_of_the_kernels(library):
    policy = random_policy(find_scenario("4-ring"), "xydgb", np.random.default_rng(3))
    compare(library, policy, [3], shield=True, time_limit=60.0)


def test_patches_of_friction_have_the_bits_of_the_kernels(library):
    patches = [{"cells": (10, 0, 19, 14), "mu": 0.3}, {"cells": (12, 5, 14, 29), "mu": 0.1}]
    policy = agent.train("1a", method="shortest")
    compare(library, policy, [0], world={"mu_patches": patches}, time_limit=40.0)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["1a", "2", "3", "4", "5-doorway"])
def test_more_episodes_have_the_bits_of_the_kernels(library, name):
    assert compare(library, agent.train(name), range(4)).count("success") >= 3


@pytest.mark.slow
def test_driving_through_cells_has_the_bits_of_the_kernels(library):
    for name in ("2", "4"):
        assert compare(library, agent.train(name), [0, 1], through=True) == ["success"] * 2


@pytest.mark.parametrize(
    ("options", "named"),
    [
        ({"reaction": True}, "--reaction"),
        ({"open_loop": ("motors",)}, "--open-loop"),
        ({"order": "jacobi"}, "--order jacobi"),
    ],
)
def test_options_that_a_page_lacks_are_refused_by_name(options, named):
    with pytest.raises(ConfigError, match=named):
        require_playable(find_scenario("2"), SimulationOptions(**options).config())


def test_pages_know_all_fields_of_worlds():
    assert {*World.__struct_fields__} == {  # a page plays all that are here; refuse others by name
        *("restitution", "mu", "mu_patches", "motor_speed_noise", "motor_spread", "obstacles"),
        *("payload_g", "payload_offset_mm", "motor_phases_deg", "sensor", "edge"),
        "floor_tilt_deg",
    }


def test_foreign_policies_are_refused(tmp_path, monkeypatch):
    damaged = tmp_path / "policy.npz"
    damaged.write_bytes(b"PK nothing")
    with pytest.raises(UserError, match=r"policy\.npz"):
        load_page_policy(damaged, find_scenario("2"))
    agent.train("1a", method="shortest").save(tmp_path / "other.npz")
    with pytest.raises(PolicyError, match="1a"):
        load_page_policy(tmp_path / "other.npz", find_scenario("2"))
    network(find_scenario("2")).save(tmp_path / "wide.npz")
    monkeypatch.setattr("agent.web.packing.MOST_HIDDEN", 15)
    with pytest.raises(PolicyError, match="layers of 16, but a page plays at most 15"):
        load_page_policy(tmp_path / "wide.npz", find_scenario("2"))

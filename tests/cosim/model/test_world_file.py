"""Tables [world] of files: with a scenario, beside one, and what is refused."""

import pytest

from cosim.base.errors import UserError
from cosim.model.scenario_file import find_in_world, find_scenario
from cosim.model.world import IDEAL, Patch, Sensor

SCENARIO = """
columns = 20
rows = 20
[[robots]]
target = [5, 15]
starts = "bottom"
"""
WORLD = """
[world]
mu = 0.2
mu_patches = [{cells = [0, 0, 9, 9], mu = 0.1}]
obstacles = [[14, 10, 16, 12]]
[world.sensor]
rate_hz = 30
"""


@pytest.fixture
def write(tmp_path):
    def written(name, text):
        path = tmp_path / name
        path.write_text(text, encoding="utf-8")
        return path

    return written


@pytest.mark.parametrize("mark", ["", "\ufeff"])  # with which editors on Windows begin files
def test_a_scenario_may_have_a_world(write, mark):
    scenario, world = find_in_world(write("own.toml", mark + SCENARIO + WORLD))
    assert world.mu == 0.2
    assert world.mu_patches == (Patch((0, 0, 9, 9), 0.1),)
    assert world.sensor == Sensor(rate_hz=30.0)
    assert len(scenario.obstacles) == 9
    assert scenario.blocks(2 * 15 + 1, 2 * 11 + 1)


def test_a_world_file_goes_with_any_scenario(write):
    path = write("world.toml", WORLD)
    own, _ = find_in_world(write("own.toml", SCENARIO + WORLD))
    beside, world = find_in_world(write("own2.toml", SCENARIO), path)
    assert beside.digest() == own.digest()
    assert world.mu == 0.2
    assert find_in_world("4") == (find_scenario("4"), IDEAL)


@pytest.mark.parametrize(
    ("world", "said"),
    [
        ("[world]\nmue = 0.2", "mue"),
        ("[word]\nmu = 0.2", "word"),
        ("mu = 0.2", "mu"),
        ("[world]\nrestitution = 2", "world.toml: world.restitution = 2 is not usable"),
        ("[world]\nmu = 'slippery'", "world.mu"),
        ("[world]\nmu_patches = [{cells = [0, 0, 30, 9], mu = 0.1}]", "not a rectangle"),
        ("[world]\nobstacles = [[1, 2, 3]]", "world.obstacles"),
        ("[world]\nobstacles = [[9, 5, 3, 8]]", "world.obstacles.*is neither a cell"),
        ("[world]\nobstacles = [[15, 18]]", "touches an obstacle"),
        ("[world", "not a TOML file"),
    ],
)
def test_what_is_wrong_is_named(write, world, said):
    with pytest.raises(UserError, match=said):
        find_in_world("2", write("world.toml", world))


def test_two_worlds_are_refused(write):
    own, other = write("own.toml", SCENARIO + WORLD), write("world.toml", WORLD)
    with pytest.raises(UserError, match="a world of its own in addition to"):
        find_in_world(own, other)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(UserError, match=r"none\.toml: no such world file"):
        find_in_world("2", tmp_path / "none.toml")


def test_a_world_that_would_have_no_effect_is_refused(write):
    obstacles = "\n[world]\nobstacles = [[14, 10]]\n"
    walled = find_scenario(write("walled.toml", SCENARIO + obstacles), ideal=True)
    assert (14, 10) in walled.obstacles
    with pytest.raises(UserError, match="has no effect here, but for obstacles"):
        find_scenario(write("own.toml", SCENARIO + WORLD), ideal=True)

"""Built-in scenarios as in Fig. 5, files of the user's own, and messages that name the field."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.ndimage import label

from cosim.base.errors import UserError
from cosim.model.scenario import Cell, Scenario, sides
from cosim.model.scenario_file import AMONG_OBSTACLES, BUILT_IN, IN_GROUPS, PAPER, find_scenario

EXAMPLE = Path(__file__).parents[3] / "docs" / "examples" / "four_crossing.toml"

MINIMAL = """
[[robots]]
target = [15, 18]
starts = "top"
"""


def test_starts_and_targets_of_the_paper():
    assert list(PAPER) == ["1a", "1b", "2", "3", "4"]
    assert [len(cells) for s in map(find_scenario, PAPER) for cells in s.starts] == [30, 116] + [
        30
    ] * 6
    for scenario in map(find_scenario, PAPER):
        left, bottom, right, top = scenario.zone
        for x, y in scenario.targets:
            assert x in {left, right} or y in {bottom, top}  # "in the border of this central zone"


def straight(start: Cell, target: Cell) -> Iterator[tuple[float, float]]:
    """Places on the straight line between two cells, in half cells."""
    (x, y), (to_x, to_y) = start, target
    for t in np.linspace(0.0, 1.0, 200):
        yield 2 * (x + t * (to_x - x)) + 1, 2 * (y + t * (to_y - y)) + 1


@pytest.mark.parametrize("name", AMONG_OBSTACLES)
def test_obstacles_stand_between_most_starts_and_their_targets(name):
    scenario = find_scenario(name)
    blocked = [
        any(scenario.blocks(x, y) for x, y in straight(start, target))
        for starts, target in zip(scenario.starts, scenario.targets, strict=True)
        for start in starts
    ]
    assert np.mean(blocked) > 0.5


@pytest.mark.parametrize("name", IN_GROUPS)
def test_every_robot_of_a_group_finds_home_when_all_others_have_parked(name):
    scenario = find_scenario(name)
    x, y = np.indices((scenario.columns, scenario.rows))
    for robot, (target, starts) in enumerate(zip(scenario.targets, scenario.starts, strict=True)):
        free = np.full((scenario.columns, scenario.rows), fill_value=True)
        for u, v in scenario.targets[:robot] + scenario.targets[robot + 1 :]:
            free &= (x - u) ** 2 + (y - v) ** 2 > scenario.squared_contact
        regions = np.zeros(free.shape, dtype=np.int64)
        label(free, np.ones((3, 3)), output=regions)
        assert regions[target] > 0
        assert all(regions[start] == regions[target] for start in starts)


def test_digest_tells_geometry_and_not_names():
    digests = {s.digest() for s in map(find_scenario, BUILT_IN)}
    assert len(digests) == len(BUILT_IN)
    base = find_scenario("1a")
    renamed = Scenario("other", "other", base.targets, base.starts)
    assert renamed.digest() == base.digest()


def test_minimal_file_is_scenario_1a(written):
    scenario = find_scenario(written(MINIMAL))
    assert scenario.digest() == find_scenario("1a").digest()
    assert scenario.name == "mine"


def test_full_file(written):
    path = written("""
name = "maze"
title = "a maze"
columns = 20
rows = 12
cell_m = 0.02
zone = [8, 4, 11, 7]
obstacles = [[3, 3], [5, 5, 6, 7], [3, 3]]
robot_diameter_m = 0.05

[[robots]]
target = [8, 4]
starts = [[0, 0], [0, 5, 1, 6]]

[[robots]]
target = [11, 7]
starts = "right"
""")
    maze = find_scenario(str(path))
    assert (maze.name, maze.columns, maze.rows, maze.cell_m) == ("maze", 20, 12, 0.02)
    assert maze.obstacles == ((3, 3), (5, 5), (6, 5), (5, 6), (6, 6), (5, 7), (6, 7))
    assert maze.starts[0] == ((0, 0), (0, 5), (1, 5), (0, 6), (1, 6))
    assert maze.starts[1] == tuple((19, y) for y in range(12))
    assert maze.zone == (8, 4, 11, 7)


@given(columns=st.integers(1, 40), rows=st.integers(1, 40))
def test_starts_by_name_are_the_cells_at_an_edge_of_any_board(columns, rows):
    edges = {
        "left": {(0, y) for y in range(rows)},
        "right": {(columns - 1, y) for y in range(rows)},
        "bottom": {(x, 0) for x in range(columns)},
        "top": {(x, rows - 1) for x in range(columns)},
    }
    edges["border"] = set().union(*edges.values())
    found = sides(columns, rows)
    assert {name: {*cells} for name, cells in found.items()} == edges
    assert all(len(cells) == len({*cells}) for cells in found.values())


def test_the_documented_examples_are_usable(written):
    assert find_scenario(EXAMPLE).robots == 4
    page = (EXAMPLE.parents[1] / "scenarios.md").read_text()
    gate = find_scenario(written(page.split("```toml")[1].split("```")[0]))
    assert gate.robots == 2
    assert gate.walls.tolist() == [[0, 9, 8, 10], [16, 9, 24, 10]]
    swarm = (EXAMPLE.parents[1] / "groups.md").read_text().split("```toml")[1].split("```")[0]
    assert find_scenario(written(swarm)).robots == 256


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("columns = 3\nrows = x\n", "not a TOML file .*line 2"),
        ("columns = 30", "robots"),
        (MINIMAL.replace("[15, 18]", "[15, 40]"), r"targets has cell \(15, 40\).* 0 to 29"),
        (MINIMAL.replace("[15, 18]", "[15]"), r"robots\[0\]\.target = .*length 2, got 1"),
        (MINIMAL.replace("18]", '"18"]'), r"target\[1\] = '18' .* int, got str"),
        (MINIMAL.replace('"top"', '"up"'), r"robots\[0\]\.starts = 'up' is unknown; .* top"),
        (MINIMAL.replace('"top"', "[[1, 2, 3]]"), r"robots\[0\]\.starts\[0\]: \[1, 2, 3\]"),
        (MINIMAL.replace('"top"', "[[0, 0], [9, 5, 3, 8]]"), r"starts\[1\]: \[9, 5, 3, 8\] is nei"),
        ("obstacles = [[9, 8, 12, 5]]" + MINIMAL, r"obstacles\[0\]: \[9, 8, 12, 5\] is neither"),
        (MINIMAL.replace('"top"', "[]"), r"starts\[0\] is empty"),
        (MINIMAL + 'colour = "red"', r"robots\[0\]\.colour is unknown; choose one of target"),
        ("columns = 0" + MINIMAL, "columns = 0 is invalid: .* give 1 to 500"),
        ("rows = 100000" + MINIMAL, "rows = 100000 is invalid"),
        ("obstacles = [[0, 0, 9999999, 0]]" + MINIMAL, r"obstacles\[0\]\[2\] = 9999999 is invalid"),
        ("cell_m = -1.0" + MINIMAL, "cell_m"),
        ("robot_diameter_m = 0" + MINIMAL, "robot_diameter_m"),
        ("zone = [5, 5, 40, 9]" + MINIMAL, "zone"),
        ('name = "../x"' + MINIMAL, "name"),
        ("obstacles = [[99, 0]]" + MINIMAL, r"obstacles has cell \(99, 0\)"),
        (MINIMAL + MINIMAL.replace("18]", "21]"), "3.0 cm apart"),
    ],
)
def test_wrong_files_are_refused_with_the_field(written, text, message):
    with pytest.raises(UserError, match=message):
        find_scenario(written(text))


def test_missing_file_and_unknown_name(tmp_path):
    with pytest.raises(UserError, match="no such scenario file"):
        find_scenario(tmp_path / "none.toml")
    with pytest.raises(UserError, match=r"unknown scenario '5'.*1a, 1b, 2, 3, 4"):
        find_scenario("5")

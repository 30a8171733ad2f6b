"""Swarms in scenario files: layouts, and what is refused by name."""

import math

import numpy as np
import pytest

from cosim.base.errors import UserError
from cosim.model.scenario_file import SWARMS, find_scenario
from cosim.model.swarm import FORMATIONS
from cosim.onboard.observing import draw_starts


@pytest.mark.parametrize("name", SWARMS)
def test_built_in_swarms_have_one_density(name):
    found = find_scenario(name)
    assert f"swarm-{found.robots}" == name
    assert found.columns == found.rows == 12 * (math.isqrt(found.robots) + 1)
    draw_starts(found, np.random.default_rng(0))  # no two of them touch


@pytest.mark.parametrize(("robots", "columns", "rows"), [(12, 60, 48), (7, 48, 48), (5, 48, 36)])
def test_boards_of_swarms_have_the_rows_that_their_robots_need(written, robots, columns, rows):
    found = find_scenario(written(f"[swarm]\nrobots = {robots}"))
    assert (found.columns, found.rows) == (columns, rows)


@pytest.mark.parametrize("robots", [1, 2, 7, 70])
@pytest.mark.parametrize("formation", FORMATIONS)
@pytest.mark.parametrize("spacing", [6, 7, 12])
def test_no_robot_begins_in_the_target_of_another(written, robots, formation, spacing):
    text = f'[swarm]\nrobots = {robots}\nspacing = {spacing}\ntargets = "{formation}"'
    if formation == "square" and spacing < 7:
        text = text.replace("spacing = 6", "spacing = 8")
    found = find_scenario(written(text))
    assert not {cell for cells in found.starts for cell in cells} & set(found.targets)


def test_targets_come_from_a_file_or_a_list(written):
    written("1,2\n30,4\n", "cells.csv")
    text = 'columns = 40\nrows = 40\n[swarm]\nrobots = 2\ntargets = "cells.csv"'
    by_file = find_scenario(written(text))
    assert by_file.targets == ((1, 2), (30, 4))
    text = "columns = 40\nrows = 40\n[swarm]\nrobots = 2\ntargets = [[1, 2], [30, 4]]"
    assert find_scenario(written(text)).digest() == by_file.digest()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[swarm]\nrobots = 0", r"swarm\.robots = 0 is invalid: expected int >= 1"),
        ("[swarm]\nrobots = 9999", r"swarm\.robots = 9999 is invalid: .*; give 1 to 4096"),
        ("[swarm]\nrobots = 2\nspacing = 5", r"swarm\.spacing = 5 lets robots of 5 cells touch"),
        ("columns = 20\n[swarm]\nrobots = 64", "columns = 20: 64 robots .* need 96 cells"),
        ("[swarm]\nrobots = 4096", "columns = 780: .* boards have up to 500"),
        ('[swarm]\nrobots = 4\ntargets = "ring"', r"swarm\.targets = 'ring' is unknown; choose"),
        ('[swarm]\nrobots = 4\ntargets = "no.csv"', "no such file of target cells"),
        (r'swarm = {robots = 4, targets = "\u0000.csv"}', "no such file of target cells"),
        ('[swarm]\nrobots = 2\ntargets = "one.csv"', r"one\.csv: .*line 1 has 1 numbers"),
        ('[swarm]\nrobots = 2\ntargets = "three.csv"', r"three\.csv: .*line 2 has 3 numbers"),
        ("[swarm]\nrobots = 2\ntargets = [[1, 1]]", r"swarm\.targets has 1 cells for 2 robots"),
        ("cell_m = nan\n[swarm]\nrobots = 2", "cell_m = nan is invalid"),
        ("[swarm]\nrobots = 2\nradius = 3", r"swarm\.radius is unknown; choose one of robots"),
        ("columns = 30", r"robots: give a table \[\[robots\]\] for each robot, or one table"),
    ],
)
def test_what_cannot_be_is_refused_by_name(written, text, message):
    written("1\n2\n3\n4\n", "one.csv")
    written("1,2\n3,4,5\n6\n", "three.csv")
    with pytest.raises(UserError, match=message):
        find_scenario(written(text))

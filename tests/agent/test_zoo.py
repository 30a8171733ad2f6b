"""The zoo: policies by name wherever a file is taken, and a leaderboard of them."""

from pathlib import Path

import pytest

import minirobots as mr
from agent.study.leaderboard import COLUMNS, Straight, leaderboard
from agent.study.policies import policy_of
from agent.zoo import made_with, published, zoo, zoo_rows
from cosim.base.table import markdown
from cosim.model.built_in import BUILT_IN
from cosim.model.scenario_file import find_scenario
from minirobots.commands.policies import Policies

PAGE = Path(__file__).parents[2] / "docs/leaderboard.md"


def test_every_built_in_scenario_has_a_learnt_and_a_computed_policy():
    boards = [board.name for board, _ in zoo().values()]
    assert all(boards.count(name) >= 2 for name in BUILT_IN if not name.startswith("swarm"))
    assert {row["policy"] for row in zoo_rows()} == set(zoo())


def test_a_policy_of_the_zoo_is_taken_by_its_name():
    policy = mr.load("zoo:1a-shortest", progress=None)
    assert policy.digest() == mr.train("1a", method="shortest", progress=None).digest()
    assert policy_of("zoo:1a-shortest", find_scenario("1a")).digest() == policy.digest()
    with pytest.raises(mr.UserError, match="was trained on scenario 1a"):
        mr.load("zoo:1a-shortest", "2")


def test_unknown_names_are_refused_with_those_that_are_known():
    with pytest.raises(mr.UserError, match=r"zoo:9-best is not in the zoo; .* zoo:4-pair"):
        mr.load("zoo:9-best")
    with pytest.raises(mr.UserError, match="scenario 9 has no leaderboard; choose one of 1a"):
        leaderboard(["9"], out=Path("none"))


def test_a_list_takes_no_options_of_measuring():
    with pytest.raises(mr.UserError, match=r"--episodes.* no effect on a list; add --measure"):
        Policies(episodes=20)


@pytest.mark.slow
def test_a_users_policy_is_measured_next_to_those_of_the_zoo(tmp_path):
    names = {name for name, (board, _) in zoo().items() if board.name == "1a"}
    found = leaderboard(["1a"], [Straight()], episodes=2, out=tmp_path)
    assert {entry.policy for entry in found} == names | {"straight", "Straight"}
    assert published(tmp_path / "leaderboard.json") == found
    assert found[0].success == 1.0
    assert {e.policy: e.made for e in found}["zoo:1a-paper"] == made_with("zoo:1a-paper")
    assert (tmp_path / "leaderboard.md").read_text().strip() == markdown(COLUMNS, found)


def test_the_page_has_what_was_measured():
    entries = published()
    assert {entry.policy for entry in entries} <= {"straight", *zoo()}
    assert markdown(COLUMNS, entries) in PAGE.read_text("utf-8")

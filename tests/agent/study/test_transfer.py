"""The table of transfer: its rows and goals, and how it continues."""

from pathlib import Path
from typing import Any

import msgspec
import pytest

from agent.evaluation.statistics import Interval
from agent.study.options import TransferOptions
from agent.study.store import EpisodeStore
from agent.study.studies import TransferReport, _verdict, goals, transfer
from cosim.base.errors import UserError
from minirobots.commands.policies import Evaluate, Transfer

BOARD = """
columns = 14
rows = 14
robots = [
    { target = [3, 6], starts = [[3, 7], [3, 8]] },
    { target = [10, 6], starts = [[10, 5], [10, 4]] },
]
"""


@pytest.fixture(scope="module")
def board(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("transfer") / "near.toml"
    path.write_text(BOARD)
    return path


def quick_table(board: Path, out: Path, **options) -> TransferReport:
    few: Any = {"scenarios": (str(board),), "methods": ("paper",), "quick": True}
    return transfer(TransferOptions(out=out, **few, **options))


@pytest.fixture(scope="module")
def table(board) -> TransferReport:
    return quick_table(board, board.parent / "transfer")


@pytest.mark.long
def test_rows_without_and_with_the_shield(table):
    off, on = table.rows
    assert [off.shield, on.shield] == [False, True]
    for row in (off, on):
        assert (row.scenario, row.policy, row.mu) == ("near", "paper", 0.15)
        assert row.episodes == row.planned == 2
        assert row.success == 1.0
        assert row.success_low < row.success
        assert row.wall_s > 0.0
    assert table.simulated == 4


@pytest.mark.long
def test_table_is_written_and_not_made_again(table, board, monkeypatch):
    out = board.parent / "transfer"
    assert table.complete
    assert msgspec.json.decode((out / "transfer.json").read_bytes(), type=TransferReport) == table
    monkeypatch.setattr(EpisodeStore, "keep", lambda *_: pytest.fail("simulated again"))
    assert quick_table(board, out) == table
    text = (out / "transfer.md").read_text()
    assert text == table.to_markdown() + "\n"
    assert "| near | paper | 0.15 | off | – | 2 | 100.0% [34.2, 100.0] |" in text
    assert (out / "policies" / "near-paper.npz").is_file()


@pytest.mark.long
def test_budget_leaves_a_table_of_what_is_there(board, tmp_path):
    table = quick_table(board, tmp_path, budget_minutes=0.0)
    assert not table.complete
    assert [row.episodes for row in table.rows] == [0, 0]
    assert "| 0 of 2 | – |" in table.to_markdown()


@pytest.mark.long
def test_goals_are_judged_by_the_worst_row(table):
    best = [msgspec.structs.replace(row, policy="moves") for row in table.rows]
    success, collisions, paths = goals(best)
    assert [success.verdict, collisions.verdict, paths.verdict] == ["not decided"] * 3
    assert "(99.0%): not decided; the worst row has 100.0% [34.2, 100.0]" in success.finding()
    failing = msgspec.structs.replace(
        best[0], mu=0.2, success=0.5, success_low=0.1, success_high=0.9
    )
    wide = msgspec.structs.replace(best[0], mu=0.1, success=0.4, success_high=1.0)
    success, collisions, _ = goals([*best, wide, failing])
    assert (success.worst, success.mu, success.verdict) == (0.5, 0.2, "does not hold")
    assert "(99.0%): does not hold; the worst row has 50.0% [10.0, 90.0]" in success.finding()
    assert collisions.worst == 0.0
    assert table.goals == ()  # of another method


@pytest.mark.parametrize(
    ("of", "sign", "verdict"),
    [
        ((1.0, 0.991, 1.0), 1, "holds"),
        ((1.0, 0.98, 1.0), 1, "not decided"),
        ((0.9, 0.8, 0.98), 1, "does not hold"),
        ((0.9, 0.8, 0.98), -1, "holds"),
        ((1.0, 0.98, 1.1), -1, "not decided"),
        ((1.1, 1.0, 1.2), -1, "does not hold"),
        ((1.0, None, None), 1, "not decided"),
    ],
)
def test_a_goal_holds_if_its_interval_does(of, sign, verdict):
    assert _verdict(Interval(*of), sign, 0.99) == verdict


@pytest.mark.parametrize(
    ("command", "options", "message"),
    [
        (Evaluate, {"starts": "many"}, "--starts many is neither 'all' nor a positive number"),
        (Evaluate, {"starts": "0"}, "--starts 0 is neither"),
        (Evaluate, {"recordings": -1}, "recordings = -1 is invalid: expected int >= 0"),
        (Transfer, {"budget_minutes": -1.0}, "budget_minutes = -1.0 is invalid"),
        (Transfer, {"scenarios": ("7",)}, "unknown scenario '7'"),
        (Transfer, {"scenarios": ("4", "4")}, "--scenarios has two of one name"),
        (Transfer, {"scenarios": ()}, "at least one each"),
        (Transfer, {"methods": ()}, "at least one each"),
    ],
)
def test_bad_options_are_refused(command, options, message):
    with pytest.raises(UserError, match=message):
        command(**options)

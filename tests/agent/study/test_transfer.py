"""The table of transfer: its rows, and how it continues."""

from pathlib import Path

import msgspec
import pytest

from agent.evaluation.cases import Case
from agent.mdp.config import ProcessConfig
from agent.study.store import ResultFile
from agent.study.transfer import TransferReport, goals, markdown, transfer
from agent.training.policy import PolicyConfig, Seed
from agent.training.settings import LearningConfig
from agent.training.store import train_policy
from cosim.base.arguments import ConfigError
from cosim.base.errors import UserError
from cosim.model.config import CoSimConfig
from cosim.model.outcome import Outcome
from cosim.model.scenario import Scenario
from cosim.simulation.result import EpisodeResult
from minirobots.commands.policies import Transfer

pytestmark = pytest.mark.long  # it trains and drives

BOARD = """
columns = 14
rows = 14
[[robots]]
target = [3, 6]
starts = [[3, 7], [3, 8]]
[[robots]]
target = [10, 6]
starts = [[10, 5], [10, 4]]
"""


@pytest.fixture(scope="module")
def board(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("transfer") / "near.toml"
    path.write_text(BOARD)
    return path


def quick_table(board: Path, out: Path, **options) -> TransferReport:
    return transfer(out, scenarios=(str(board),), methods=("paper",), quick=True, **options)


@pytest.fixture(scope="module")
def table(board) -> TransferReport:
    return quick_table(board, board.parent / "out")


def test_rows_without_and_with_the_shield(table):
    off, on = table.rows
    assert [off.shield, on.shield] == [False, True]
    for row in (off, on):
        assert (row.scenario, row.method, row.mu) == ("near", "paper", 0.15)
        assert row.episodes == row.planned == 2
        assert row.success == 1.0
        assert row.success_low < row.success
        assert row.wall_s > 0.0
    assert table.simulated == 4


def test_table_is_written_and_not_made_again(table, board):
    out = board.parent / "out"
    assert table.complete
    written = (out / "transfer.json").read_bytes()
    assert msgspec.json.decode(written, type=TransferReport) == table
    assert quick_table(board, out) == table
    text = (out / "transfer.md").read_text()
    assert text == markdown(table) + "\n"
    assert "| near | paper | 0.15 | off | 2 | 100.0% [34.2, 100.0] |" in text
    assert (out / "policies" / "near-paper.npz").is_file()


def test_budget_leaves_a_table_of_what_is_there(board, tmp_path):
    table = quick_table(board, tmp_path, budget_minutes=0.0)
    assert not table.complete
    assert [row.episodes for row in table.rows] == [0, 0]
    assert "| 0 of 2 | – |" in markdown(table)


PLAIN = EpisodeResult(
    Outcome.SUCCESS, 10.0, 60.0, 9.0, None, ((0, 0),), (10.0,), 0.0, 8.0, 9.0, (9.0,), 0
)


def test_a_row_counts_the_beginning_of_its_sample(tmp_path, motor_fmu):
    """A long episode is still under way, or was lost, while later ones have ended."""
    starts = tuple((x, y) for x in (0, 5, 9) for y in (8, 12))
    scenario = Scenario("six", "", ((4, 4),), (starts,), columns=14, rows=14, zone=(0, 0, 0, 0))
    config = PolicyConfig(scenario, ProcessConfig(), LearningConfig(episodes=1), Seed(0))
    case = Case(train_policy(config)[0], CoSimConfig(), motor_fmu, 0)
    file, indices = ResultFile.of_case(tmp_path, case), case.sample(6)
    for place in (0, 1, 3, 5):
        file.add(indices[place], PLAIN)
    assert list(file.completed_prefix(indices)) == indices[:2]
    file.add(indices[2], PLAIN)
    assert list(file.completed_prefix(indices)) == indices[:4]


def test_goals_are_judged_by_the_worst_row(table):
    best = [msgspec.structs.replace(row, method="moves") for row in table.rows]
    failing = msgspec.structs.replace(
        best[0], mu=0.2, success=0.5, success_low=0.1, success_high=0.9
    )
    success, collisions, paths = goals([*best, failing])
    assert (success.worst, success.mu, success.holds) == (0.5, 0.2, False)
    assert "(99.0%): does not hold; the worst row has 50.0% [10.0, 90.0]" in success.finding()
    assert (collisions.worst, collisions.holds) == (0.0, True)
    assert paths.holds
    assert table.goals == ()  # of another method


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        (
            {"budget_minutes": -1.0},
            UserError,
            "budget_minutes = -1.0 is invalid",
        ),
        ({"scenarios": ("7",)}, UserError, "unknown scenario '7'"),
        ({"scenarios": ("4", "4")}, ConfigError, "--scenarios has two of one name"),
        ({"scenarios": ()}, ConfigError, "at least one each"),
        ({"methods": ()}, ConfigError, "at least one each"),
    ],
)
def test_bad_options_are_refused(options, error, message):
    with pytest.raises(error, match=message):
        Transfer(**options)

"""The table of transfer: its rows, how it goes on, and what the safety layer leaves alone."""

from dataclasses import replace
from pathlib import Path

import msgspec
import pytest

from agent.evaluation.cases import Case, Job, run_jobs
from agent.evaluation.result_file import ResultFile
from agent.evaluation.transfer import transfer
from agent.evaluation.transfer_table import Row, TransferReport, goals, markdown
from agent.process.config import ProcessConfig
from agent.training.policy import PolicyConfig, Seed
from agent.training.settings import LearningConfig
from agent.training.store import train_policy
from cosim.base.config import ConfigError, CoSimConfig
from cosim.base.errors import UserError
from cosim.base.outcome import Outcome
from cosim.base.params import SAFETY_MARGIN_M
from cosim.navigation.result import EpisodeResult
from cosim.scenarios.scenario import Scenario, ScenarioError
from cosim.transfer import Transfer

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


def episode(scenario: Scenario, fmu, margin_m: float) -> EpisodeResult:
    config = PolicyConfig(scenario, ProcessConfig(), LearningConfig(episodes=5000), Seed(0))
    case = Case(train_policy(config)[0], CoSimConfig(safety_margin_m=margin_m), fmu, 0)
    ((_, result),) = run_jobs([Job(case, 0)], 1)
    return msgspec.structs.replace(result, realtime_factor=1.0)


def test_layer_leaves_an_episode_without_conflicts_alone(motor_fmu):
    apart = Scenario(
        "apart",
        "",
        ((3, 6), (10, 6)),
        (((3, 8),), ((10, 4),)),
        columns=14,
        rows=14,
        zone=(0, 0, 0, 0),
    )
    off, on = (episode(apart, motor_fmu, margin_m) for margin_m in (0.0, SAFETY_MARGIN_M))
    assert off.conflicts == 0
    assert off == on


def test_layer_changes_an_episode_with_conflicts(motor_fmu):
    """Robot 1 wants to within 5 cm of robot 2, which is about to leave."""
    close = Scenario(
        "close",
        "",
        ((4, 7), (10, 7)),
        (((3, 7),), ((9, 7),)),
        columns=14,
        rows=14,
        zone=(0, 0, 0, 0),
    )
    off, on = (episode(close, motor_fmu, margin_m) for margin_m in (0.0, SAFETY_MARGIN_M))
    assert off.conflicts > 0
    assert on.conflicts > 0
    assert off.path_length_cm_by_robot != on.path_length_cm_by_robot


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


def test_rows_without_and_with_the_layer(table):
    off, on = table.rows
    assert [off.safety_margin_m, on.safety_margin_m] == [0.0, SAFETY_MARGIN_M]
    for row in (off, on):
        assert (row.scenario, row.method, row.mu) == ("near", "paper", 0.15)
        assert row.episodes == row.planned == 2
        assert row.success == 1.0
        assert row.success_low < 1.0
    # nothing is simulated twice
    assert (off.simulated, on.simulated, table.simulated) == (2, 0, 2)
    assert off.wall_s > 0.0


def test_table_is_written_and_not_made_again(table, board):
    out = board.parent / "out"
    assert table.complete
    assert len(table.sessions) == 1
    assert table.elapsed_s > table.episode_wall_s / 2
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
CHANGED = msgspec.structs.replace(PLAIN, conflicts=2)


@pytest.fixture
def row(tmp_path, motor_fmu) -> Row:
    """A row of six starts of which nothing is known."""
    starts = tuple((x, y) for x in (0, 5, 9) for y in (8, 12))
    scenario = Scenario("six", "", ((4, 4),), (starts,), columns=14, rows=14, zone=(0, 0, 0, 0))
    config = PolicyConfig(scenario, ProcessConfig(), LearningConfig(episodes=1), Seed(0))
    case = Case(train_policy(config)[0], CoSimConfig(), motor_fmu, 0)
    with_layer = replace(case, config=CoSimConfig(safety_margin_m=SAFETY_MARGIN_M))
    files = (ResultFile(tmp_path, c) for c in (case, with_layer))
    return Row("six", "paper", 0.15, case.sample(None), *files)


def counted(row: Row, safety: bool) -> list[int]:
    """Places in the sample of the episodes that count, in order."""
    return sorted(row.indices.index(k) for k in row.results(safety))


def test_a_row_counts_the_beginning_of_its_sample(row):
    """A long episode is still under way, or was lost, while later ones have ended."""
    for place in (0, 1, 3, 5):
        row.off.add(row.indices[place], PLAIN)
    assert counted(row, safety=False) == counted(row, safety=True) == [0, 1]
    row.off.add(row.indices[2], PLAIN)
    assert counted(row, safety=False) == [0, 1, 2, 3]
    assert [row.indices.index(job.index) for job in row.missing(safety=False)] == [4]


def test_episodes_that_the_layer_changes_are_not_left_out(row):
    changed = [1, 2, 4]
    for place, index in enumerate(row.indices):
        row.off.add(index, CHANGED if place in changed else PLAIN)
    assert counted(row, safety=False) == [0, 1, 2, 3, 4, 5]
    # the budget ended between the passes: nothing is known of what the layer does
    assert counted(row, safety=True) == []
    counts = []
    for place in changed:
        row.on.add(row.indices[place], CHANGED)
        counts.append(counted(row, safety=True))
    assert counts == [[0, 1], [0, 1, 2, 3], [0, 1, 2, 3, 4, 5]]
    assert [r.conflicts > 0 for r in row.results(safety=True).values()] == [False] * 3 + [True] * 3


def test_goals_are_judged_by_the_worst_row(table):
    best = [msgspec.structs.replace(row, method="moves") for row in table.rows]
    failing = msgspec.structs.replace(
        best[0], mu=0.2, success=0.5, success_low=0.1, success_high=0.9
    )
    success, collisions, paths = goals([*best, failing])
    assert (success.worst, success.mu, success.holds) == (0.5, 0.2, False)
    assert (collisions.worst, collisions.holds) == (0.0, True)
    assert paths.holds
    assert goals(list(table.rows)) == []


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"jobs": 0}, UserError, "--jobs must be at least 1"),
        ({"budget_minutes": -1.0}, ConfigError, "--budget-minutes must not be negative"),
        ({"scenarios": ("7",)}, ScenarioError, "unknown scenario '7'"),
    ],
)
def test_bad_options_are_refused(options, error, message):
    with pytest.raises(error, match=message):
        Transfer(**options)

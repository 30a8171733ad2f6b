"""The table of learners: how it is made, continues and is written, and what it says."""

import json

import msgspec
import pytest

from agent.baselines import comparison
from agent.baselines.learners import config_of, digest
from agent.baselines.table import COLUMNS, Drive, LearnerRun, report_of
from agent.deep.policy import NetworkConfig
from agent.evaluation.grid import PolicyMeasures
from agent.mdp.exact import Milestone
from agent.moves import observe
from agent.study.store import EpisodeStore
from cosim.base.errors import UserError
from cosim.base.progress import silent
from cosim.base.table import markdown
from cosim.model.outcome import Outcome
from cosim.model.scenario_file import find_scenario
from minirobots.commands.baselines import Baselines

pytestmark = pytest.mark.long  # it trains

BOARD = """
columns = 14
rows = 14
[[robots]]
target = [3, 6]
starts = [[3, 7], [3, 8]]
"""


@pytest.fixture(scope="module")
def board(tmp_path_factory):
    path = tmp_path_factory.mktemp("baselines") / "near.toml"
    path.write_text(BOARD)
    return path


@pytest.fixture(scope="module", autouse=True)
def brief():
    """Trainings of a fifth, in all tests alike: a training of another length is another one."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("agent.baselines.learners.QUICK_EPISODES", 20_000)
        yield


@pytest.fixture(scope="module")
def done(board, command):
    """With one move of every kind, instead of two dozen, to say what moves take."""
    options = ("--quick", "--scenarios", board, "--learners", "shortest", "double_q", "--json")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(observe, "MOVES_PER_KIND", 1)
        patch.setattr(observe, "WALKS", 1)
        patch.setattr(observe, "cache_dir", lambda kind: board.parent / kind)
        ended = command("baselines", *options, "--out", board.parent / "out")
    assert ended.returncode == 0, ended.stderr
    return ended


def test_learners_are_trained_and_drive(done, board):
    report = json.loads(done.stdout.splitlines()[-1])
    assert report["complete"]
    rows = {row["learner"]: row for row in report["rows"]}
    assert list(rows) == ["double_q", "shortest"]
    assert rows["shortest"]["path_ratio"]["mean"] == 1.0
    assert rows["shortest"]["steps_to_enough"]["mean"] is None
    for row in rows.values():
        assert row["success"]["mean"] == 1.0
        assert (row["seeds"], row["episodes"]) == (1, 2)
        assert 0.8 < row["time_ratio"]["mean"] < 3.0
    assert rows["double_q"]["reached"] == 1
    # a policy's own description is no training
    assert {path.suffix for path in (board.parent / "out" / "policies").iterdir()} > {".json"}
    assert len(list((board.parent / "out" / "runs").iterdir())) == len(rows)
    table = (board.parent / "out" / "baselines.md").read_text().splitlines()
    assert len(table) == 2 + len(rows)


@pytest.mark.slow
def test_networks_are_trained_and_drive(board, tmp_path, command, monkeypatch):
    from agent.deep import learners

    monkeypatch.setattr(learners, "BOARDS", 32)
    monkeypatch.setattr(learners, "ROUND", 3000)
    options = ("--scenarios", board, "--learners", "ddqn", "--quick", "--out", tmp_path, "--json")
    ended = command("baselines", *options)
    assert ended.returncode == 0, ended.stderr
    (row,) = json.loads(ended.stdout.splitlines()[-1])["rows"]
    assert row["success"]["mean"] > 0.9
    assert (row["reached"], row["episodes"]) == (1, 2)
    assert 0.8 < row["time_ratio"]["mean"] < 3.0


def test_boards_of_one_name_are_told_apart_or_refused(board, tmp_path):
    other = tmp_path / board.name
    other.write_text(BOARD.replace("[3, 6]", "[4, 6]"))
    with pytest.raises(UserError, match="two boards called near"):
        comparison.baselines(
            tmp_path,
            scenarios=[str(board), str(other)],
            learners=["shortest"],
            seed=0,
            seeds=1,
            episodes=1,
        )


def test_it_goes_on_where_it_ended(done, board, monkeypatch):
    def refuse(*_):
        raise AssertionError("trained again")

    monkeypatch.setattr(comparison, "train", refuse)
    monkeypatch.setattr(EpisodeStore, "keep", refuse)
    report = comparison.baselines(
        board.parent / "out",
        scenarios=[str(board)],
        learners=["double_q", "shortest"],
        seed=0,
        seeds=1,
        episodes=2,
        quick=True,
    )
    assert json.loads(done.stdout.splitlines()[-1])["rows"][0]["time_s"]["mean"] == (
        report.rows[0].time_s.mean
    )
    assert (report.quick, report.seed, report.seeds, report.episodes) == (True, 0, 1, 2)
    late = comparison.baselines(
        board.parent / "out",
        scenarios=[str(board)],
        learners=["shortest"],
        seed=0,
        seeds=2,
        episodes=2,
        quick=True,
        budget_minutes=0.0,
    )
    assert not late.complete
    assert late.rows[0].seeds == 1


def test_episodes_of_a_session_that_was_cut_are_in_the_table(done, board):
    """Those of other physics, or more than are asked for, are not; a lost policy is rebuilt."""
    out = board.parent / "out"
    files = sorted((out / "runs").iterdir())
    old = tuple(Drive(k, Outcome.COLLISION, 1.0, 1.0) for k in range(6))
    for path in files:
        kept = msgspec.json.decode(path.read_bytes(), type=LearnerRun)
        assert kept.drives == ()
        path.write_bytes(msgspec.json.encode(msgspec.structs.replace(kept, drives=old)))

    def table(budget_minutes=None, episodes=2):
        return comparison.baselines(
            out,
            scenarios=[str(board)],
            learners=["double_q", "shortest"],
            seed=0,
            seeds=1,
            episodes=episodes,
            quick=True,
            budget_minutes=budget_minutes,
        )

    for episodes in (2, 1):
        rows = table(0.0, episodes).rows
        assert [(row.episodes, row.driven and row.driven.share) for row in rows] == [
            (episodes, 1.0)
        ] * 2
    kept = {path: path.read_bytes() for path in (out / "episodes").iterdir()}
    for path in kept:
        path.unlink()
    assert [(row.episodes, row.driven) for row in table(0.0).rows] == [(0, None)] * 2
    for path, content in kept.items():
        path.write_bytes(content)
    (out / "policies" / f"{files[0].stem}.npz").unlink()
    assert not table(0.0).complete
    assert table().complete


def run(seed, success, seconds, drives=()):
    grid = PolicyMeasures(
        policy="", scenario="2", starts=10, success=success, collision=1.0 - success,
        out_of_board=0.0, timeout=0.0, path_length_cm=1.0, steps=1.0, ratio_to_bound=1.2,
        steps_ratio_to_bound=1.1, failing_starts=0,
    )  # fmt: skip
    curve = (Milestone(1000, 1.0, 0.5), Milestone(2000, seconds, success))
    return LearnerRun(
        scenario="2", learner="ippo", seed=seed, seconds=9.0, curve=curve, grid=grid, drives=drives
    )


def test_rows_are_means_over_seeds_with_intervals():
    drives = (
        Drive(0, Outcome.SUCCESS, 30.0, 20.0),
        Drive(1, Outcome.SUCCESS, 50.0, 20.0),
        Drive(2, Outcome.COLLISION, 5.0, 20.0),
    )
    runs = [run(0, 0.99, 3.0, drives), run(1, 0.9, 5.0)]
    rows = [("2", "ippo", runs, None), ("4-cross", "shortest", [], "n/a: too many")]
    report = report_of(rows, 2, 3)
    (row, left_out), text = report.rows, markdown(COLUMNS, report.rows).splitlines()
    assert not report.complete  # the second seed has not driven
    assert report_of(rows[1:], 2, 3).complete
    for seeds, episodes, complete in ((1, 3, True), (1, 4, False), (2, 3, False)):
        assert report_of([("2", "ippo", runs[:1], None)], seeds, episodes).complete == complete
    assert row.success.mean == pytest.approx(0.945)
    assert (row.reached, row.seconds_to_enough.mean, row.steps_to_enough.mean) == (1, 3.0, 2000)
    assert (row.time_s.mean, row.time_ratio.mean, row.episodes) == (40.0, 2.0, 3)
    assert row.driven is not None
    assert row.driven.share == pytest.approx(2 / 3)
    assert row.driven.low < row.driven.share < row.driven.high
    assert "94.5 % [37.3, 100.0]" in text[2]
    assert left_out.left_out == "n/a: too many"
    assert len({line.count("|") for line in text}) == 1


def test_what_cannot_be_computed_is_left_out_with_its_reason():
    reason = comparison.left_out(find_scenario("4-cross"), "shortest")
    assert reason == "n/a: 7e+11 joint states"
    assert comparison.left_out(find_scenario("1b"), "shortest") is None


def test_budgets_and_seeds_are_part_of_what_a_training_is():
    scenario = find_scenario("1b")
    configs = [
        config_of(learner, scenario, seed, quick, silent)
        for learner in ("ippo", "ddqn", "paper", "double_q")
        for seed in (0, 1)
        for quick in (False, True)
    ]
    assert len({digest(config) for config in configs}) == len(configs)
    assert isinstance(configs[0], NetworkConfig)


@pytest.mark.parametrize(
    "options",
    [
        {"seeds": 0},
        {"seed": -1},
        {"budget_minutes": -1.0},
        {"budget_minutes": float("nan")},
        {"learners": ()},
        {"scenarios": ("1b", "1b")},
    ],
)
def test_options_that_cannot_be_are_refused(options):
    with pytest.raises(UserError):
        Baselines(**options)

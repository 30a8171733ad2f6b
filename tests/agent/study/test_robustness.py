"""The robustness table: its worlds, how it continues, and what it writes."""

from pathlib import Path

import msgspec
import pytest

from agent.study.axes import AXES, points
from agent.study.episodes import EPISODES
from agent.study.store import EpisodeStore
from agent.study.transfer import OF_WORLDS, RobustnessReport, robustness
from cosim.base.errors import UserError
from cosim.base.table import markdown
from cosim.model.scenario_file import find_scenario, in_world, read_world
from cosim.model.world import IDEAL, World
from minirobots.commands.policies import Robustness
from tests.agent.study.test_transfer import BOARD

ROUGH = Path(__file__).parents[3] / "docs" / "examples" / "rough.toml"


def measure(out: Path, board: Path, **options) -> RobustnessReport:
    return robustness(
        out,
        read_world(ROUGH),
        scenario=str(board),
        axes=("nothing", "delay"),
        methods=("paper",),
        episodes=1,
        **options,
    )


@pytest.fixture(scope="module")
def board(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("robustness") / "near.toml"
    path.write_text(BOARD)
    return path


@pytest.fixture(scope="module")
def report(board) -> RobustnessReport:
    return measure(board.parent / "out", board)


def test_the_default_world_is_there_wherever_the_command_runs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    world = Robustness().world
    assert read_world(world) == read_world(ROUGH)
    assert "cosim" in {parent.name for parent in world.parents}  # in the wheel


def test_every_axis_has_worlds_of_its_own():
    scenario = find_scenario("4")
    worlds = [p for axis in AXES for p in points(axis, scenario, read_world(ROUGH))]
    assert len({repr(p.world) for p in worlds}) == len(worlds)
    assert [p.axis for p in worlds if p.world == IDEAL] == ["nothing"]
    for point in worlds:
        assert in_world(scenario, point.world) == scenario


@pytest.mark.long
def test_rows_are_methods_in_worlds(report, board):
    assert report.complete
    assert [row.axis for row in report.rows] == ["nothing", *["delay"] * 3]
    assert len({row.digest for row in report.rows}) == len(report.rows)
    for row in report.rows:
        assert row.episodes == 1
        assert row.success_low < row.success_high
    out = board.parent / "out"
    assert msgspec.json.decode((out / "robustness.json").read_bytes(), type=RobustnessReport)
    assert (out / "robustness.md").read_text() == markdown(OF_WORLDS, report.rows) + "\n"
    assert len(markdown(OF_WORLDS, report.rows).splitlines()) == 2 + len(report.rows)
    assert (out / "robustness.png").stat().st_size > 10_000


def test_it_resumes_where_it_ended(report, board, monkeypatch):
    monkeypatch.setattr(EpisodeStore, "keep", lambda *_: pytest.fail("simulated again"))
    assert measure(board.parent / "out", board) == report


@pytest.mark.slow
def test_rows_in_one_world_share_their_episodes(board, monkeypatch):
    """A world that says no more than one of the axes."""
    counts = []

    def count(jobs, *_):
        counts.append(len(jobs))
        return iter(())

    monkeypatch.setattr("agent.study.episodes.EPISODES", EPISODES._replace(compute=count))
    report = robustness(
        board.parent / "same",
        World(mu=0.1),
        scenario=str(board),
        axes=("friction", "everything"),
        methods=("paper",),
        episodes=2,
    )
    assert len(report.rows) > len({row.digest for row in report.rows})
    assert counts == [2 * len({row.digest for row in report.rows})]


@pytest.mark.parametrize(
    "options",
    [
        {"episodes": 0},
        {"seed": -1},
        {"budget_minutes": -1.0},
        {"quick": True, "episodes": 3},
        {"methods": ("paper", "fastest")},
        {"methods": ()},
        {"axes": ()},
    ],
)
def test_options_that_cannot_be_are_refused(options):
    with pytest.raises(UserError):
        Robustness(**options)

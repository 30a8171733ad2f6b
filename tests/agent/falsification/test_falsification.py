"""A search of a small board: it continues to the same bits, and its cases are run again."""

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import msgspec
import pytest

from agent.falsification.falsify import FalsificationReport, falsify
from agent.falsification.found import fails, gap_cm, read_cases, run_again
from agent.method import method_policy
from agent.moves import observe
from agent.study.store import ResultFileError
from cosim.base.errors import UserError
from cosim.base.storage import write_json
from cosim.model.outcome import Outcome
from cosim.model.scenario_file import find_scenario
from cosim.simulation.result import EpisodeResult
from minirobots.runner import FAILED_STATUS

BOARD = """
columns = 20
rows = 20
[[robots]]
target = [3, 10]
starts = [[11, 9, 13, 11]]
[[robots]]
target = [17, 9]
starts = [[4, 9, 6, 11]]
"""
EPISODES = 12  # a generation and a half


@pytest.fixture(scope="module")
def policy(tmp_path_factory) -> Iterator[Path]:
    """Of robots that have to swap sides, and have hardly learnt to; few moves are observed."""
    folder = tmp_path_factory.mktemp("falsification")
    board = folder / "swap.toml"
    board.write_text(BOARD)
    policy, *_ = method_policy("paper", find_scenario(board), episodes=30)
    policy.save(folder / "policy.npz")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(observe, "MOVES_PER_KIND", 1)
        patch.setattr(observe, "WALKS", 1)
        patch.setattr(observe, "cache_dir", lambda kind: folder / kind)
        yield folder / "policy.npz"


def search(policy: Path, out: Path, episodes: int = EPISODES, **options) -> FalsificationReport:
    options = {"time_limit": 16.0, "keep": 1, "jobs": 1} | options
    return falsify(policy, out=out, episodes=episodes, **options)


def episodes_of(report: FalsificationReport) -> list[dict]:
    """Results by number, without what differs from run to run."""
    rows = [json.loads(line) for line in Path(report.results).read_text().splitlines()[1:]]
    assert len({row["index"] for row in rows}) == len(rows)
    return [
        {name: value for name, value in row.items() if name != "realtime_factor"}
        for row in sorted(rows, key=lambda row: row["index"])
    ]


@pytest.fixture(scope="module")
def whole(policy) -> FalsificationReport:
    return search(policy, policy.parent / "whole")


@pytest.mark.long
def test_the_worst_episodes_are_kept(whole, policy):
    assert (whole.episodes, sum(whole.outcomes.values())) == (EPISODES, EPISODES)
    results = [
        msgspec.convert(row | {"realtime_factor": 1.0}, EpisodeResult) for row in episodes_of(whole)
    ]
    scenario = find_scenario(policy.parent / "swap.toml")
    gaps = [gap_cm(result, scenario) for result in results]
    assert 0.0 < max(gaps) < 14.0
    assert whole.found == gaps.count(0.0) > 0
    assert whole.first == gaps.index(0.0) + 1
    (worst,) = whole.worst
    assert worst.gap_cm == 0.0
    assert Path(worst.recording or "").stat().st_size > 10_000
    found = read_cases(policy.parent / "whole" / "cases.json")
    assert [case.number for case in found.cases] == [k for k, gap in enumerate(gaps) if not gap]
    assert [case.recording for case in found.cases[1:]] == [None] * (whole.found - 1)


@pytest.mark.long
def test_a_search_goes_on_where_it_ended_to_the_same_bits(whole, policy):
    out = policy.parent / "parts"
    first = search(policy, out, 5, jobs=2)
    assert first.episodes == 5
    file = Path(first.results)
    lines = file.read_text().splitlines(keepends=True)
    file.write_text("".join(lines[:2] + lines[4:]))  # as if it had ended within a generation
    again = search(policy, out, jobs=2)
    assert episodes_of(again) == episodes_of(whole)
    parts, cases = (read_cases(o / "cases.json") for o in (out, policy.parent / "whole"))
    unrecorded = {"recording": None}
    for ours, theirs in zip(parts.cases, cases.cases, strict=True):
        assert msgspec.structs.replace(ours, **unrecorded) == msgspec.structs.replace(
            theirs, **unrecorded
        )
    assert search(policy, out) == again  # nothing is simulated again


@pytest.mark.long
def test_results_of_another_search_are_refused(whole, policy):
    out = policy.parent / "edited"
    report = search(policy, out, 2)
    file = Path(report.results)
    rows = [json.loads(line) for line in file.read_text().splitlines()]
    rows[1]["starts"][0] = [0, 0]
    file.write_text("".join(json.dumps(row) + "\n" for row in rows))
    with pytest.raises(ResultFileError, match="asked for other episodes on another machine"):
        search(policy, out, 2)


def test_a_search_for_time_ends_with_the_first_time_out(policy):
    report = search(
        policy, policy.parent / "time", 24, objective="time", search="random", until_found=True,
        time_limit=4.0, keep=0,
    )  # fmt: skip
    assert report.episodes == 8  # a generation
    assert report.first is not None
    cases = read_cases(policy.parent / "time" / "cases.json").cases
    assert {case.outcome for case in cases} == {Outcome.TIMEOUT}
    assert len(cases) == report.found == report.outcomes["timeout"]


def test_cases_are_what_they_were_when_they_are_run_again(whole, policy, command):
    cases = policy.parent / "whole" / "cases.json"
    ended = command("falsify", "--policy", policy, "--replay", cases, "--json")
    assert ended.returncode == FAILED_STATUS, ended.stderr
    assert f"{whole.found} of {whole.found} cases fail" in ended.stdout
    report = json.loads(ended.stdout.splitlines()[-1])
    for then, now in zip(report["then"], report["now"], strict=True):
        assert now | {"recording": None} == then | {"recording": None}


def test_cases_of_another_motor_are_not_run_with_the_built_in_one(whole, policy, command, tmp_path):
    found = read_cases(policy.parent / "whole" / "cases.json")
    own = msgspec.structs.replace(found, config=replace(found.config, motor_fmu="0" * 16))
    write_json(tmp_path / "cases.json", own)
    ended = command("falsify", "--policy", policy, "--replay", tmp_path / "cases.json")
    assert (ended.returncode, ended.stdout) == (2, "")
    assert "found with another motor FMU than the built-in one; name it by" in ended.stderr


@pytest.mark.parametrize(
    ("result", "gap", "failure"),
    [
        ({"outcome": "success", "min_distance_cm": 5.25}, 0.25, None),
        ({"outcome": "timeout", "min_distance_cm": 5.25}, 0.25, "time"),
        ({"outcome": "collision", "min_distance_cm": 9.0, "contact_time_s": 1e-5}, 0.0, "gap"),
        ({"outcome": "success", "min_distance_cm": 4.9, "contact_time_s": 1e-5}, 0.0, "gap"),
        ({"outcome": "out_of_board", "min_distance_cm": 9.0}, 0.0, "gap"),
        ({"outcome": "success", "min_distance_cm": None}, float("inf"), None),
    ],
)
def test_gaps_and_failures(result, gap, failure):
    rest = {
        "path_length_cm": 1.0, "sim_time_s": 1.0, "realtime_factor": 1.0, "recording": None,
        "starts": (), "path_length_cm_by_robot": (), "contact_time_s": 0.0, "energy_j": 1.0,
        "energy_j_by_robot": (), "conflicts": 0,
    }  # fmt: skip
    scenario = find_scenario("3")
    ended = msgspec.convert(rest | result, EpisodeResult)
    assert gap_cm(ended, scenario) == pytest.approx(gap)
    for objective in ("gap", "time"):
        assert fails(ended, scenario, objective) == (objective == failure)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--episodes", 0], "--episodes must be at least 1"),
        (["--keep", -1], "--keep must not be negative"),
        (["--ranges", "none.toml"], "none.toml: no such file of ranges"),
        (["--replay", "none.json"], "none.json: no such file of cases"),
        (["--replay", "none.json", "--mu", 0.2], "--replay has the dynamics from its file"),
        (["--replay", "none.json", "--episodes", 9], "--replay has the dynamics from its file"),
    ],
)
def test_what_cannot_be_is_refused(policy, command, arguments, said):
    ended = command("falsify", "--policy", policy, *arguments)
    assert (ended.returncode, ended.stdout) == (2, "")
    assert said in ended.stderr
    assert ended.stderr.count("\n") == 1


@pytest.mark.slow
def test_a_collision_that_was_found_is_found_again(array_fmu):
    """One of `python -m benchmarks falsification`."""
    found = read_cases(Path(__file__).with_name("collision.json"))
    policy, *_ = method_policy("shortest", found.scenario)
    assert policy.digest() == found.policy_digest
    assert run_again(found, policy, array_fmu, 1) == found.cases
    assert [case.outcome for case in found.cases] == [Outcome.COLLISION]


def test_a_robot_alone_has_no_gap(tmp_path):
    policy, *_ = method_policy("paper", find_scenario("1a"), episodes=10)
    policy.save(tmp_path / "policy.npz")
    with pytest.raises(UserError, match=r"1a .*one robot.* gap"):
        search(tmp_path / "policy.npz", tmp_path)

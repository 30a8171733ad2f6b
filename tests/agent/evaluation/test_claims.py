"""Claims: how they are read, judged and shown; a verdict depends on nothing but the episodes."""

from dataclasses import replace
from typing import Any

import msgspec
import numpy as np
import pytest

from agent.evaluation.cases import Case, Job
from agent.evaluation.claims import Claim, JudgedClaim, claim_of
from agent.study.engine import Line, measure
from agent.study.report import Report
from agent.study.store import EpisodeStore, simulate_missing
from agent.study.user import evaluate, study
from cosim.base.errors import UserError
from cosim.base.jobs import Workers
from cosim.model.config import CoSimConfig
from cosim.model.outcome import ENDS, Outcome
from cosim.simulation.result import EpisodeResult
from tests.agent.study.test_evaluate import rows

SUCCESS = EpisodeResult(
    Outcome.SUCCESS, 1.5, 8.0, 9.0, None, ((0, 0),), (1.5, 1.5), 0.0, 7.0, 1.0, (0.5, 0.5), 0
)
TIMEOUT = msgspec.structs.replace(SUCCESS, outcome=Outcome.TIMEOUT)
TEXT, CONFIDENCE = "success > 0.5", 0.9  # five successes certify it


def claim(text: str = TEXT, confidence: float | None = CONFIDENCE) -> Claim:
    found = claim_of(text, confidence)
    assert found is not None
    return found


@pytest.fixture(scope="module")
def case(near_policy, motor_fmu):
    return Case(near_policy, CoSimConfig(), motor_fmu, 0)


def test_claims_are_read():
    assert claim("collision < 1e-3", None) == (
        "collision < 1e-3", frozenset({Outcome.COLLISION}), 1e-3, 0.999,
    )  # fmt: skip
    assert claim("success>.999")[1:] == claim("failure < 0.001")[1:]
    assert claim("timeout > 0.25").against == set(ENDS) - {Outcome.TIMEOUT}
    assert claim_of(None, None) is None


NO_CLAIMS = (
    "", "collision", "collision <= 0.1", "crash < 0.1", "0.1 > collision", "collision < 1e-9",
    "success > 1", "collision < nan", "collision < -1", "collision < 1e-3 or so", "running < 1",
)  # fmt: skip


def test_invalid_claims_and_confidences_are_refused_before_anything_is_kept(tmp_path, command):
    for options in (("--confidence", 0.9), ("--claim", TEXT, "--confidence", 1.0)):
        done = command("evaluate", "shortest", "--scenario", "1a", *options, "--out", tmp_path)
        assert done.returncode == 2
        assert done.stderr.startswith("error: confidence = ")
    wrong: Any = (
        *(({"claim": text}, "claim ") for text in NO_CLAIMS),
        *(
            ({"claim": TEXT, "confidence": value}, "confidence = .* is invalid")
            for value in (0.0, 1.0, -0.1, 99.9, np.nan, "high")
        ),
        ({"confidence": 0.9}, "has no effect without a claim"),
        ({"claim": ["success > 0.5"]}, "takes one value"),
        ({"claim": TEXT, "on_collision": "continue"}, "leave out --on-collision continue"),
    )
    for options, message in wrong:
        with pytest.raises(UserError, match=message):
            evaluate("shortest", "1a", starts=1, out=tmp_path / "out", **options)
    assert not list(tmp_path.iterdir())


def test_episodes_decide_in_their_order():
    judged = claim().judge([SUCCESS] * 9)
    assert judged == JudgedClaim(TEXT, 0.9, "certified", 5, 0, enough=5)
    judged = claim("failure < 0.05").judge([TIMEOUT] * 9)
    assert (judged.verdict, judged.episodes, judged.against) == ("refused", 2, 2)
    assert claim().judge([]).verdict == "undecided"
    judged = claim().judge([SUCCESS, TIMEOUT, SUCCESS])
    assert str(judged) == (
        f"success > 0.5 at confidence 0.9; 1 of 3 episodes contradict it; {judged.enough} certify "
        "it if no more do"
    )


def test_starts_are_covered_evenly_with_noise_of_their_own(case):
    indices = case.rounds(12)
    assert sorted(indices) == list(range(12))
    assert indices[:4] == case.sample(4)
    for k in (0, 4, 8):
        cells = [case.start_cells(index) for index in indices[k : k + 4]]
        assert len(set(cells)) == 4
    seeds = {case.noise_seed(k).generate_state(1)[0] for k in indices}
    assert len(seeds) == 12


class Faked:
    """Episodes without a simulation, which end in an order of their own."""

    def __init__(self, failing: set[int], together: int) -> None:
        self.failing, self.together = failing, together
        self.simulated: list[int] = []

    def compute(self, jobs, threads, may_begin=lambda: True):
        """The last episodes of a group end first."""
        for first in range(0, len(jobs), self.together):
            if not may_begin():
                return
            for job in reversed(jobs[first : first + self.together]):
                self.simulated.append(job.index)
                yield job, TIMEOUT if job.index in self.failing else SUCCESS


@pytest.mark.parametrize("seed", range(3))
def test_a_verdict_depends_on_no_order_and_no_interruption(case, tmp_path, monkeypatch, seed):
    failing = set(np.random.default_rng(seed).permutation(200)[:20].tolist())
    line = Line(case, case.rounds(200), "near", claim=claim("success > 0.75"))
    assert line.claim is not None
    results = [TIMEOUT if k in failing else SUCCESS for k in line.indices]
    expected = line.claim.judge(results)
    assert expected.verdict == "certified"
    for together in (1, 7, 200):
        store, fake = EpisodeStore(tmp_path / str(together)), Faked(failing, together)
        monkeypatch.setattr("agent.study.store.run_jobs", fake.compute)
        monkeypatch.setattr("agent.study.store.compile_kernels", lambda *_: None)
        few = iter([True] * 5)  # looks at the time, after which it is over
        measure([line], store, Workers(jobs=1), may_begin=lambda few=few: next(few, False))
        measure([line], EpisodeStore(tmp_path / str(together)), Workers(jobs=1))
        again = EpisodeStore(tmp_path / str(together))
        assert line.claim.judge(line.results(again).values()) == expected
        assert list(line.results(again)) == line.indices[: expected.episodes]
        assert len(fake.simulated) == len(set(fake.simulated)) < expected.episodes + together


def test_results_of_other_processes_are_those_of_their_jobs(case, tmp_path, monkeypatch):
    """Also where the episodes of a group end in another order."""
    fake = Faked({2, 3, 9}, 5)
    monkeypatch.setattr("agent.study.store.run_jobs", fake.compute)
    here: Any = lambda work, groups, *_: enumerate(map(work, groups))  # noqa: E731
    monkeypatch.setattr("cosim.base.backends.sweep", here)
    store, where = EpisodeStore(tmp_path), Workers(jobs=1, backend="loky")
    found = list(simulate_missing([Job(case, k) for k in range(12)], store, where=where))
    assert {job.index for job, result in found if result == TIMEOUT} == {2, 3, 9}
    assert sorted(job.index for job, _ in found) == list(range(12))


def test_a_refused_claim_ends_early(near_policy, case, tmp_path):
    bad = replace(near_policy, q=-near_policy.q)
    options: Any = {"claim": "failure < 0.05", "confidence": CONFIDENCE, "time_limit": 10.0}
    row = evaluate(bad, starts=4, jobs=1, out=tmp_path, **options)
    assert row.claim is not None
    assert (row.claim.verdict, row.claim.episodes, row.claim.against) == ("refused", 2, 2)
    assert (row.episodes, row.success, len(row.results)) == (2, 0.0, 2)
    assert "| refused |" in repr(row)


@pytest.mark.long
def test_more_episodes_than_starts_go_round_again(near_file, tmp_path):
    table = study(
        near_file, episodes=9, claim=TEXT, confidence=CONFIDENCE, jobs=2, out=tmp_path, noise=[0.05]
    )
    (row,) = table.rows
    assert row.claim is not None
    assert (row.claim.verdict, row.claim.episodes, row.starts) == ("certified", 5, 4)
    assert sorted(row.results)[:4] == [0, 1, 2, 3]
    assert len({result.path_length_cm for result in row.results.values()}) == 5
    assert row.path_ratio_to_grid == pytest.approx(1.0, abs=0.15)
    (written,) = msgspec.json.decode((tmp_path / "study.json").read_bytes())["rows"]
    assert written["claim"] == msgspec.to_builtins(row.claim)
    assert table.to_markdown().splitlines()[0].startswith(f"| policy | scenario | noise | {TEXT} |")


@pytest.mark.long
def test_the_command_resumes_and_says_the_verdict(near_file, tmp_path, command):
    options = ("--claim", TEXT, "--confidence", CONFIDENCE, "--recordings", 0, "--out", tmp_path)
    done = command("evaluate", near_file, *options, "--json")
    assert done.returncode == 1, done.stderr
    assert f"undecided for {near_file}: {TEXT} at confidence 0.9; 0 of 4 episodes" in done.stdout
    assert "5 certify it if no more do" in done.stdout
    kept = rows(tmp_path)
    assert len(kept) == 4
    done = command("evaluate", near_file, *options, "--starts", 20, "--json")
    assert done.returncode == 0, done.stderr
    assert rows(tmp_path).items() >= kept.items()
    (row,) = msgspec.json.decode(done.stdout.splitlines()[-1], type=Report).rows
    assert row.claim is not None
    assert (row.claim.verdict, row.claim.episodes, row.claim.against) == ("certified", 5, 0)
    assert (row.episodes, row.starts) == (5, 4)

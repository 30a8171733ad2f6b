"""Certificates of real short episodes: made, continued, refused, checked."""

import lzma
from dataclasses import replace
from pathlib import Path
from zipfile import ZipFile

import msgspec
import numpy as np
import pytest

from agent.certification import certify as certifying
from agent.certification import check as checking
from agent.certification.certificate import (
    Certificate,
    claim_test,
    issue,
    judge,
    read_certificate,
    show_certificate,
)
from agent.certification.certify import certify_case
from agent.certification.check import CheckReport, check
from agent.certification.claims import parse_claim
from agent.certification.collisions import SplittingReport, estimate_collisions
from agent.evaluation.cases import Job, run_jobs
from agent.evaluation.statistics import rate
from agent.method import method_policy
from agent.policies import load_policy
from agent.study.episodes import EPISODES, case_of
from agent.study.store import IndexedResult, ResultFile, RowFile
from cosim.base.errors import UserError
from cosim.base.jobs import Workers
from cosim.base.storage import write_json
from cosim.model.outcome import Outcome
from cosim.model.params import SHIELD
from cosim.model.scenario_file import find_scenario
from cosim.model.world import Sensor, World
from cosim.simulation.options import SimulationOptions
from cosim.simulation.result import EpisodeResult
from cosim.simulation.tasks import simulate_tasks
from minirobots.commands.certify import Certify

RESULT = EpisodeResult(
    Outcome.SUCCESS, 1.5, 8.0, 9.0, None, ((0, 0),), (1.5, 1.5), 0.0, 7.0, 1.0, (0.5, 0.5), 0
)
ONE = Workers(jobs=1)
PUBLISHED = Path(__file__).parents[3] / "docs" / "examples"
CLAIM, CONFIDENCE = parse_claim("success > 0.5"), 0.9  # five successes certify it
FORGED = 7248  # episodes without collision that certify a rate below 0.002 at 0.999999


@pytest.fixture(scope="module")
def case(near_file, motor_fmu):
    return case_of(near_file, SimulationOptions(), 0)


@pytest.fixture(scope="module")
def out(case, tmp_path_factory):
    """A certificate of five episodes."""
    folder = tmp_path_factory.mktemp("certificate")
    certify_case(case, CLAIM, CONFIDENCE, folder, where=ONE)
    return folder


def read(folder) -> Certificate:
    return read_certificate(folder / "certificate.json")


def without_timing(certificate: Certificate) -> Certificate:
    """A certificate without what differs from run to run."""
    evidence = msgspec.structs.replace(certificate.evidence, wall_s=0.0)
    return msgspec.structs.replace(certificate, evidence=evidence, issued="")


@pytest.mark.parametrize("name", ["certificate", "certificate-rough"])
def test_the_published_certificates_can_be_read(name):
    certificate = read(PUBLISHED / name)
    assert (certificate.claim, certificate.verdict) == ("collision < 1e-2", "certified")
    assert certificate.config.shield is not None
    assert certificate.config.shield.stopping_m == certificate.case.parameters["stopping_m"]


@pytest.mark.long
def test_the_published_certificate_verifies(tmp_path):
    """As docs/certificates.md says how: its rows, and an episode with the present code."""
    (tmp_path / "certificate.json").write_bytes(
        (PUBLISHED / "certificate" / "certificate.json").read_bytes()
    )
    (packed,) = (PUBLISHED / "certificate").glob("*.xz")
    (tmp_path / packed.stem).write_bytes(lzma.decompress(packed.read_bytes()))
    method_policy("shortest", find_scenario("4"))[0].save(tmp_path / "policy.npz")
    report = check(tmp_path / "certificate.json", sample=1, where=ONE)
    assert report.differences == ()
    assert (report.verdict, report.compared) == ("certified", 1)


def test_a_certificate_says_what_it_stands_on(out, case, near_policy):
    certificate = read(out)
    assert certificate.verdict == "certified"
    evidence = certificate.evidence
    assert (evidence.episodes, evidence.against, evidence.outcomes) == (5, 0, {"success": 5})
    assert [(look.episodes, look.allowed, look.chance) for look in evidence.looks] == [
        (5, 0, 0.5**5)
    ]
    assert certificate.starts.rounds == 5 / 4
    assert certificate.starts.all
    assert certificate.case.policy_digest == near_policy.digest()
    assert certificate.config == case.config
    assert load_policy(out / "policy.npz").digest() == near_policy.digest()


def test_starts_are_covered_evenly_with_noise_of_their_own(case):
    indices = case.rounds(12)
    assert sorted(indices) == list(range(12))
    assert indices[:4] == case.sample(None)
    for k in (0, 4, 8):
        cells = [case.start_cells(index) for index in indices[k : k + 4]]
        assert len(set(cells)) == 4
    assert len({Job(case, k).task().seed.generate_state(1)[0] for k in indices}) == 12


def test_it_goes_on_where_it_ended(out, case, tmp_path):
    first = certify_case(case, CLAIM, CONFIDENCE, tmp_path, episodes=2, where=ONE)
    assert (first.verdict, first.evidence.episodes, first.evidence.enough) == ("undecided", 2, 5)
    (file,) = tmp_path.glob("*.jsonl")
    kept = file.read_bytes()
    none = certify_case(case, CLAIM, CONFIDENCE, tmp_path, budget_minutes=0.0)
    assert without_timing(none) == without_timing(first)
    second = certify_case(case, CLAIM, CONFIDENCE, tmp_path, where=Workers(jobs=2))
    assert file.read_bytes().startswith(kept)
    assert without_timing(second) == without_timing(read(out))


def test_a_verdict_is_final_and_other_attempts_are_kept(out, case, command, tmp_path):
    """Another seed, claim or confidence replaces no certificate unless it lists it."""
    for path in out.iterdir():
        (tmp_path / path.name).write_bytes(path.read_bytes())
    first = (tmp_path / "certificate.json").read_bytes()
    assert certify_case(case, CLAIM, CONFIDENCE, tmp_path) == read(tmp_path)
    other, claim = replace(case, seed=1), parse_claim("success > 0.4")
    for tried in ((other, CLAIM, CONFIDENCE), (case, claim, CONFIDENCE), (case, CLAIM, 0.8)):
        with pytest.raises(UserError, match=r"holds another attempt \(certified: .*--supersede"):
            certify_case(*tried, tmp_path)
    assert (tmp_path / "certificate.json").read_bytes() == first
    certify_case(other, CLAIM, CONFIDENCE, tmp_path, episodes=1, supersede=True, where=ONE)
    second = certify_case(other, CLAIM, CONFIDENCE, tmp_path, episodes=2, supersede=True, where=ONE)
    assert (second.verdict, second.evidence.episodes, second.case.seed) == ("undecided", 2, 1)
    third = certify_case(case, claim, CONFIDENCE, tmp_path, supersede=True, where=ONE)
    tried = [(a.case.seed, a.claim, a.verdict, a.evidence.episodes) for a in third.attempts]
    assert tried == [(0, CLAIM.text, "certified", 5), (1, CLAIM.text, "undecided", 2)]
    assert read(tmp_path) == third
    done = command("certify", "--check", tmp_path / "certificate.json", "--sample", 0)
    assert done.returncode == 0, done.stderr
    assert "attempt 1, superseded 20" in done.stdout
    assert "this is attempt 3; the probability that any of these verdicts" in done.stdout
    assert "is wrong is at most 0.3" in done.stdout


def test_an_attempt_is_registered_before_its_episodes(case, tmp_path, monkeypatch):
    """One that is interrupted has a certificate of what is known."""

    def interrupted(*_):
        assert read(tmp_path).verdict == "undecided"
        raise KeyboardInterrupt

    monkeypatch.setattr(certifying, "EPISODES", EPISODES._replace(compute=interrupted))
    with pytest.raises(KeyboardInterrupt):
        certify_case(case, CLAIM, CONFIDENCE, tmp_path)
    assert (read(tmp_path).verdict, read(tmp_path).evidence.episodes) == ("undecided", 0)
    assert check(tmp_path / "certificate.json").differences == ()


def test_the_verdict_names_its_conditions(case, tmp_path, capsys):
    world = World(motor_spread=0.1, floor_tilt_deg=1.0)
    rough = replace(case, config=replace(case.config, world=world))
    show_certificate(certify_case(rough, CLAIM, CONFIDENCE, tmp_path, episodes=1, where=ONE))
    said = capsys.readouterr().out
    assert "shield off, time limit 600 s" in said
    assert 'world {"motor_spread":0.1,"floor_tilt_deg":1.0}' in said
    assert "the rate is the mean over the starts; of any single start" in said
    assert "against the claim is at most 1 (95 %)" in said


def test_a_single_start_is_known_far_worse_than_the_mean(case):
    plain = dict(enumerate([RESULT] * 9))
    test = claim_test(CLAIM, 0.999)

    def worst(results):
        known = {k: results[n] for n, k in enumerate(case.rounds(len(results)))}
        return judge(case, test, CLAIM, known)[1].worst_start

    assert worst({k: plain[k] for k in range(8)}) == pytest.approx(1.0 - 0.05**0.5)
    # one of two episodes from a start
    failed = msgspec.structs.replace(RESULT, outcome=Outcome.TIMEOUT)
    assert worst({k: failed if k == 0 else plain[k] for k in range(8)}) == pytest.approx(0.95**0.5)
    assert worst({k: plain[k] for k in range(3)}) == 1.0  # a start without an episode


def test_a_bad_policy_is_refused(near_policy, case, tmp_path):
    config = replace(case.config, timing=case.config.timing._replace(episode_limit_s=10.0))
    bad = replace(case, policy=replace(near_policy, q=-near_policy.q), config=config)
    certificate = certify_case(
        bad, parse_claim("failure < 0.05"), CONFIDENCE, tmp_path, episodes=4, where=ONE
    )
    assert certificate.verdict == "refused"
    evidence = certificate.evidence
    assert evidence.against == evidence.episodes == 2
    assert Outcome.SUCCESS not in evidence.outcomes


def test_a_check_finds_every_bit_again(out, command):
    done = command("certify", "--check", out / "certificate.json", "--sample", 2, "--json")
    assert done.returncode == 0, done.stderr
    report = msgspec.json.decode(done.stdout.splitlines()[-1], type=CheckReport)
    assert (report.compared, report.differences, report.changes) == (2, (), {})


@pytest.fixture
def copied(out, tmp_path):
    for path in out.iterdir():
        (tmp_path / path.name).write_bytes(path.read_bytes())
    return tmp_path


def test_a_check_finds_a_changed_result(copied, command):
    (file,) = copied.glob("*.jsonl")
    header, line, *rest = file.read_bytes().splitlines(keepends=True)
    changed = msgspec.json.decode(line)
    changed["path_length_cm"] += 1e-6
    line = msgspec.json.encode(changed) + b"\n"
    file.write_bytes(b"".join([header, line, *rest]))
    done = command("certify", "--check", copied / "certificate.json", "--sample", 5)
    assert done.returncode == 1
    assert "verdict and evidence are not what the results say" in done.stdout
    assert f"episode {changed['index']}: success then, success now" in done.stdout
    assert done.stdout.count("then,") == 1


@pytest.fixture(scope="module")
def forged(case, tmp_path_factory):
    """A certificate of many episodes, of which those that seed 0 draws are true."""
    folder, claim = tmp_path_factory.mktemp("forged"), parse_claim("collision < 2e-3")
    indices = case.rounds(FORGED)
    true = np.random.default_rng(0).permutation(indices)[:10].tolist()
    rows = {job.index: result for job, result in run_jobs([Job(case, k) for k in true], 1)}
    file = ResultFile(folder, case)
    file.add(true[0], rows.pop(true[0]))
    for k in indices:
        if k not in rows and k != true[0]:
            result = msgspec.structs.replace(RESULT, starts=case.start_cells(k), energy_j=1e-6 * k)
            rows[k] = result
    lines = [IndexedResult(**msgspec.structs.asdict(row), index=k) for k, row in rows.items()]
    with file.path.open("ab") as opened:
        opened.writelines(msgspec.json.encode(line) + b"\n" for line in lines)
    certificate = issue(ResultFile(folder, case), claim, 0.999999)
    assert (certificate.verdict, certificate.evidence.episodes) == ("certified", FORGED)
    write_json(folder / "certificate.json", certificate)
    case.policy.save(folder / "policy.npz")
    return folder / "certificate.json"


@pytest.mark.long
def test_a_check_finds_fabricated_rows_whatever_seed_they_were_made_for(forged):
    report = check(forged, sample=10, where=ONE)
    assert report.compared == 10
    assert len(report.differences) >= 7  # chance draws a true row in one run of 70, four never
    assert all("success then" in difference for difference in report.differences)


@pytest.mark.parametrize(
    ("change", "difference"),
    [
        (lambda row: {"energy_j": 1.0}, "episodes are copies of others"),
        (lambda row: {"starts": row["starts"][::-1]}, f"{FORGED} episodes begin elsewhere"),
    ],
)
def test_a_check_looks_at_all_rows(forged, tmp_path, change, difference):
    for path in forged.parent.iterdir():
        (tmp_path / path.name).write_bytes(path.read_bytes())
    (file,) = tmp_path.glob("*.jsonl")
    header, *lines = file.read_bytes().splitlines()
    rows = [msgspec.json.decode(line) for line in lines]
    lines = [msgspec.json.encode(row | change(row)) for row in rows]
    file.write_bytes(b"\n".join([header, *lines, b""]))
    found = check(tmp_path / "certificate.json", sample=0).differences
    assert any(difference in text for text in found)


def test_the_default_sample_finds_one_altered_row_in_100(monkeypatch, forged, out):
    sizes = []
    monkeypatch.setattr(checking, "run", lambda jobs, *_, **__: sizes.append(len(jobs)) or iter(()))
    report = check(forged)
    assert report.compared == sizes[0] == 290
    assert report.found >= 0.95
    altered, rng = 146, np.random.default_rng(0)  # rows of 14 502
    hits = [(rng.permutation(14_502)[:294] < altered).any() for _ in range(1000)]
    assert np.mean(hits) == pytest.approx(0.95, abs=0.02)
    assert check(out / "certificate.json").compared == 5  # all of a small file


def test_a_check_writes_nothing(copied):
    (file,) = copied.glob("*.jsonl")
    file.write_bytes(file.read_bytes() + b'{"outcome": "succ')
    before = {path: (path.read_bytes(), path.stat().st_mtime_ns) for path in copied.iterdir()}
    assert check(copied / "certificate.json", sample=1).differences == ()
    after = {path: (path.read_bytes(), path.stat().st_mtime_ns) for path in copied.iterdir()}
    assert after == before


@pytest.mark.parametrize(("factor", "stands"), [(1.0 + 1e-9, True), (1.01, False)])
def test_a_check_leaves_the_last_digits_of_chances_to_libraries(copied, factor, stands):
    path = copied / "certificate.json"
    certificate = msgspec.json.decode(path.read_bytes())
    for look in certificate["evidence"]["looks"]:
        look["chance"] *= factor
    path.write_bytes(msgspec.json.encode(certificate))
    assert (check(path, sample=0).differences == ()) == stands


@pytest.mark.parametrize(
    ("keys", "value", "difference"),
    [
        (("starts", "all"), False, "the starts are not those"),
        (("starts", "rounds"), 9.0, "the starts are not those"),
        (("method",), "optimal", "not trained by the method"),
        (("case", "parameters", "mu"), 0.3, "mu was 0.15 by the configuration, and 0.3"),
        (("case", "parameters", "shield"), True, "shield was False"),
        (("case", "seed"), 1, "verdict and evidence"),
        (("config", "shield"), list(SHIELD), "shield was True by the configuration, and False"),
        (("confidence",), 0.99, "verdict and evidence"),
        (("verdict",), "refused", "verdict and evidence"),
        (("claim",), "success > 0.6", "verdict and evidence"),
    ],
)
def test_a_check_finds_whatever_else_was_changed(copied, keys, value, difference):
    path = copied / "certificate.json"
    certificate = msgspec.json.decode(path.read_bytes())
    part = certificate
    for key in keys[:-1]:
        part = part[key]
    assert part[keys[-1]] != value
    part[keys[-1]] = value
    path.write_bytes(msgspec.json.encode(certificate))
    assert difference in "\n".join(check(path, sample=0).differences)


def test_a_check_says_what_has_changed(copied, near_policy):
    path = copied / "certificate.json"
    certificate = msgspec.json.decode(path.read_bytes())
    certificate["versions"]["numpy"] = "1.0"
    path.write_bytes(msgspec.json.encode(certificate))
    report = check(path, sample=0)
    assert report.differences == ()
    assert {name: then for name, (then, _) in report.changes.items()} == {"numpy": "1.0"}
    del certificate["case"]["parameters"]["shield"]
    certificate["code_digest"] = "other"
    certificate["case"]["motor_fmu_digest"] = "the built-in one of then"
    path.write_bytes(msgspec.json.encode(certificate))
    report = check(path, sample=0)
    assert report.differences == ()
    assert report.changes["shield"] == ("", "False")
    assert report.changes["code_digest"][0] == "other"
    assert report.changes["motor_fmu_digest"][0] == "the built-in one of then"
    replace(near_policy, q=near_policy.q + 1.0).save(copied / "other.npz")
    report = check(path, policy=copied / "other.npz", sample=0)
    assert "the policy is another one" in report.differences
    assert "policy_digest" in report.changes


def test_a_check_finds_another_scenario_and_another_motor(copied, near_policy, motor_fmu):
    near = near_policy.config.scenario
    moved = replace(near, targets=tuple(reversed(near.targets)))
    config = msgspec.structs.replace(near_policy.config, scenario=moved)
    replace(near_policy, config=config).save(copied / "o.npz")
    other = copied / "other.fmu"
    other.write_bytes(motor_fmu.read_bytes())
    with ZipFile(other, "a") as archive:
        archive.writestr("resources/note.txt", "another one")
    report = check(copied / "certificate.json", policy=copied / "o.npz", motor_fmu=other, sample=0)
    names = ("the policy's scenario", "the motor FMU")
    assert {f"{name} is another one" for name in names} <= set(report.differences)


def test_a_missing_file_is_named(copied, command):
    (file,) = copied.glob("*.jsonl")
    file.unlink()
    done = command("certify", "--check", copied / "certificate.json")
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert f"{file}: no such file of the certificate's results" in done.stderr


def test_undecided_exits_with_one(copied, command, near_file):
    options = ("--policy", near_file, "--claim", "timeout < 0.1", "--episodes", 5, "--supersede")
    options += ("--out", copied)
    done = command("certify", *options, "--json")
    assert done.returncode == 1, done.stderr
    assert "138 episodes would certify it" in done.stdout
    certificate = msgspec.json.decode(done.stdout.splitlines()[-1], type=Certificate)
    assert (certificate.verdict, certificate.evidence.episodes) == ("undecided", 5)


@pytest.fixture
def camera_case(near_policy, case):
    seen = World(sensor=Sensor(30.0, 50.0, 0.5, 1.0), motor_spread=0.05)
    return replace(case, config=replace(case.config, world=seen))


def test_a_branch_has_the_past_of_its_root_and_noise_of_its_own(camera_case):
    tracks, drawn = [], []

    def simulate(**redrawn):
        track = []

        def watch(step, episode, _):
            track.append((step.samples.position.copy(), step.samples.omega.copy()))
            drawn.append(episode.drawn)

        task = replace(Job(camera_case, 0).task(), watch=watch, **redrawn)
        ((_, result),) = simulate_tasks([task], 1)
        tracks.append(track)
        return result

    first = simulate()
    assert simulate(redrawn={1: np.random.SeedSequence(5)}).path_length_cm != first.path_length_cm
    past, future = list(zip(*tracks, strict=False))[:2]
    assert all((a == b).all() for a, b in zip(*past, strict=True))
    assert not any((a == b).all() for a, b in zip(*future, strict=True))
    assert all(world == drawn[0] for world in drawn)


def test_splitting_simulates_and_keeps_branches(case, tmp_path, monkeypatch):
    def estimate() -> SplittingReport:
        return estimate_collisions(case, tmp_path, roots=2, branches=2, gaps_mm=(30.0,), where=ONE)

    report = estimate()
    # robots are so close at once: each root is split after its first RL step
    assert [level.probability for level in report.levels] == [1.0, 0.0]
    assert (report.simulated, report.collision, report.low) == (4, 0.0, 0.0)
    assert report.high == pytest.approx(rate(0, 2).high)
    assert report.roots_with_collision == 0
    assert report.highest == pytest.approx(1.0 - 0.025**0.5)
    assert report.worth == 2.0
    assert (report.levels[0].low, report.levels[0].high) == pytest.approx(rate(2, 2)[1:])

    monkeypatch.setattr(RowFile, "append", lambda *_: pytest.fail("simulated again"))
    assert estimate() == report


@pytest.mark.long
def test_every_branch_of_robots_that_drive_at_each_other_collides(case, near_policy, tmp_path):
    q = np.zeros_like(near_policy.q)
    q[:, 0, :, 0] = q[:, 1, :, 4] = 1.0  # east and west
    bad = replace(case, policy=replace(near_policy, q=q))
    report = estimate_collisions(bad, tmp_path, roots=2, branches=2, gaps_mm=(15.0, 8.0), where=ONE)
    assert (report.collision, report.low, report.high) == pytest.approx(rate(2, 2))
    assert (report.roots_with_collision, report.highest) == (2, 1.0)
    assert report.simulated > 2 * 2


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({}, "give one of --claim, --check and --splitting"),
        ({"claim": "collision < 0.1", "splitting": True}, "give one of"),
        ({"claim": "collision < 0.1"}, "--policy is missing"),
        ({"claim": "safe"}, "claim 'safe' is invalid"),
        ({"claim": "collision < 0.1", "confidence": 1.0}, "--confidence"),
        ({"claim": "collision < 0.1", "roots": 5}, "--roots has no effect without --splitting"),
        ({"splitting": True, "budget_minutes": 1.0}, "--budget-minutes has no effect"),
        ({"splitting": True, "gaps": (5.0, 10.0)}, "--gaps must be positive and decreasing"),
        ({"claim": "collision < 0.1", "episodes": 0}, "--episodes must be at least 1"),
        ({"splitting": True, "seed": -1}, "--seed must not be negative"),
        ({"check": Path("c.json"), "out": Path("elsewhere")}, "--out has no effect with --check"),
        ({"check": Path("c.json"), "seed": 1}, "--seed has no effect with --check"),
        ({"splitting": True, "supersede": True}, "--supersede has no effect without --claim"),
    ],
)
def test_options_that_cannot_be_are_refused(options, message, tmp_path):
    policy = {} if message.startswith("--policy") else {"policy": tmp_path / "policy.npz"}
    with pytest.raises(UserError, match=message):
        Certify(**policy, **options)


def test_a_claim_needs_an_episode(tmp_path):
    with pytest.raises(UserError, match="episodes = 0 must be at least 1"):
        certifying.certify("shortest", "success > 0.5", "1a", episodes=0, out=tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_robots_that_push_each_other_on_have_no_collisions(near_file, tmp_path, command):
    options = ("--policy", near_file, "--on-collision", "continue", "--out", tmp_path / "out")
    for work in (("--claim", "collision < 0.5"), ("--splitting",)):
        done = command("certify", *options, *work)
        assert done.returncode == 2
        assert "leave out --on-collision continue" in done.stderr
    assert not (tmp_path / "out").exists()

"""Checks a certificate: its episodes judged again, and a sample of them simulated again."""

import math
from bisect import bisect_left
from collections.abc import Iterator, Mapping
from pathlib import Path

import msgspec
import numpy as np
from scipy.stats import hypergeom

from agent.certification.certificate import (
    POLICY_FILE,
    Certificate,
    Evidence,
    claim_test,
    code_of_certificates,
    covered,
    judge,
    known,
    read_certificate,
    without_timing,
)
from agent.certification.claims import parse_claim
from agent.evaluation.cases import Case, CaseIdentity, Job
from agent.policies import load_policy, method_name
from agent.study.episodes import EPISODES
from agent.study.store import EpisodeStore, Header, IndexedResult, RowFile
from cosim.base.errors import UserError
from cosim.base.jobs import Workers, run
from cosim.base.progress import Progress, silent
from cosim.base.provenance import versions
from cosim.base.reading import Kind, require_file
from cosim.simulation.options import Physics
from cosim.simulation.result import EpisodeResult

_RESULTS = Kind("file of the certificate's results", "keep both in one folder", UserError)
# What a certificate is about: with another one it says nothing.
_SUBJECT = {"policy_digest": "the policy", "scenario_digest": "the policy's scenario"}

# The default sample finds with this probability that a share of the rows was altered.
ALTERED, FOUND = 0.01, 0.95


class CheckReport(msgspec.Struct, frozen=True, kw_only=True):
    """A certificate compared with the present findings.

    Attributes:
        certificate: file.
        claim, verdict: of it.
        compared: episodes that were simulated again.
        found: probability that they show it where a share of `ALTERED` of all rows was altered.
        differences: as text; none if it stands. Of an episode that ended alike other numbers
            differ.
        changes: versions and digests that are not those of the certificate, then and now. They do
            no harm while there are no differences.
    """

    certificate: str
    claim: str
    verdict: str
    compared: int
    found: float
    differences: tuple[str, ...]
    changes: dict[str, tuple[str, str]]


def check(
    path: Path,
    *,
    policy: Path | None = None,
    motor_fmu: Path | None = None,
    sample: int | None = None,
    where: Workers = Workers(),  # noqa: B008 - a constant
    progress: Progress = silent,
) -> CheckReport:
    """Judge the results of a certificate again, and simulate some of its episodes again.

    Args:
        path: certificate.json, next to its results.
        policy: by default that next to the certificate.
        motor_fmu: of the episodes, the built-in one by default.
        sample: how many episodes to simulate, drawn with fresh entropy; by default enough that
            altered rows, if they are a share of `ALTERED`, are found with a probability of `FOUND`.
        where: backend and number of workers.
        progress: receives how many episodes are simulated.

    Raises:
        UserError: a file is missing, damaged or another's; or of the FMU.
    """
    certificate = read_certificate(path)
    claim, then = parse_claim(certificate.claim), certificate.case
    header = Header(**msgspec.structs.asdict(then), digest=certificate.digest)
    file = path.parent / Path(certificate.results).name
    if certificate.evidence.episodes:
        require_file(file, _RESULTS)
    results = {row.index: row.result for row in RowFile(file, header, IndexedResult).rows}
    loaded = load_policy(policy or path.parent / POLICY_FILE)
    fmu = Physics(motor_fmu=motor_fmu).fmu(progress)
    case = Case(loaded, certificate.config, fmu, then.seed)
    before, now = _facts(then, certificate), _facts(case.identity)
    differences = [f"{name} is another one" for k, name in _SUBJECT.items() if before[k] != now[k]]
    # The built-in motor FMU is compiled from this code, and a change of it as harmless.
    own_motor = motor_fmu is not None or certificate.config.motor_fmu
    if own_motor and then.motor_fmu_digest != case.identity.motor_fmu_digest:
        differences.append("the motor FMU is another one")
    episodes = certificate.evidence.episodes
    looked_at = known(case, results, episodes)
    test = claim_test(claim, certificate.confidence)
    verdict, evidence = judge(case, test, claim, looked_at)
    if verdict != certificate.verdict or _rounded(evidence) != _rounded(certificate.evidence):
        differences.append("verdict and evidence are not what the results say")
    if certificate.starts != covered(case, evidence.episodes):
        differences.append("the starts are not those of the episodes")
    if certificate.method != method_name(loaded):
        differences.append("the policy was not trained by the method")
    differences += _invented(case, looked_at)
    used = case.identity.parameters
    differences += [
        f"{name} was {used[name]} by the configuration, and {value} by the list of parameters"
        for name, value in then.parameters.items()
        if used.get(name, value) != value
    ]
    for name in then.parameters.keys() ^ used.keys():
        before[name] = str(then.parameters.get(name, ""))
        now[name] = str(used.get(name, ""))
    rows = len(looked_at)
    if sample is None:
        sample = bisect_left(range(rows), FOUND, key=lambda size: _found(rows, size))
    drawn = np.random.default_rng().permutation(list(looked_at))[:sample].tolist()
    jobs = [Job(case, index) for index in drawn]
    for job, result in run(jobs, EpisodeStore(), EPISODES, where, progress=progress):
        was = results[job.index]
        if without_timing(result) != without_timing(was):
            differences.append(f"episode {job.index}: {was.outcome} then, {result.outcome} now")
    return CheckReport(
        certificate=str(path),
        claim=certificate.claim,
        verdict=certificate.verdict,
        compared=len(drawn),
        found=_found(rows, len(drawn)),
        differences=tuple(differences),
        changes={k: (v, now.get(k, "")) for k, v in before.items() if v != now.get(k)},
    )


def show_check(report: CheckReport) -> None:
    """Print what differs, and what has changed since."""
    print(f"{report.certificate}: {report.verdict}: {report.claim}")
    for name, (then, now) in report.changes.items():
        print(f"{name} was {then}, and is {now or 'missing'} now")
    for difference in report.differences:
        print(difference)
    equal = "differ" if report.differences else "are equal in every bit"
    print(f"the certificate and {report.compared} of its episodes, simulated again, {equal}")
    print(
        f"if {ALTERED:.0%} of all rows had been altered, such a sample would show it with a "
        f"probability of {report.found:.1%}"
    )


def _found(rows: int, sample: int) -> float:
    """Probability that a sample has an altered row, where a share of `ALTERED` was altered."""
    return float(1.0 - hypergeom.pmf(0, rows, math.ceil(ALTERED * rows), sample)) if rows else 1.0


def _invented(case: Case, results: Mapping[int, EpisodeResult]) -> Iterator[str]:
    """Return what shows without any simulation that results are none of the case."""
    moved = [k for k, result in results.items() if result.starts != case.start_cells(k)]
    if moved:
        yield f"{len(moved)} episodes begin elsewhere than their index says, as episode {moved[0]}"
    copies = len(results) - len({msgspec.json.encode(without_timing(r)) for r in results.values()})
    if copies and case.config.noise.relative_amplitude:
        yield f"{copies} episodes are copies of others, which their noise rules out"


def _rounded(evidence: Evidence) -> Evidence:
    """Chances to six digits: the last ones are those of a library, and not of the episodes."""
    looks = (msgspec.structs.replace(k, chance=float(f"{k.chance:.6g}")) for k in evidence.looks)
    worst = float(f"{evidence.worst_start:.6g}")
    return msgspec.structs.replace(evidence, looks=tuple(looks), worst_start=worst)


def _facts(case: CaseIdentity, certificate: Certificate | None = None) -> dict[str, str]:
    """Digests and versions, of a certificate or of today."""
    digests = {k: v for k, v in msgspec.structs.asdict(case).items() if k.endswith("_digest")}
    if certificate is None:
        return digests | {"code_digest": code_of_certificates()} | versions()
    return digests | {"code_digest": certificate.code_digest} | certificate.versions

"""Certificates: the claim about a policy, the verdict, and the episodes behind it.

A certificate is a folder: `certificate.json`, the policy and the results of the episodes.
"""

from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path

import msgspec
import numpy as np
from scipy.stats import beta

from agent.certification.claims import LEAST_CONFIDENCE, Claim, complement
from agent.certification.sequential import ClaimDecision, SequentialTest, Verdict
from agent.evaluation.cases import Case, CaseIdentity
from agent.evaluation.statistics import CONFIDENCE
from agent.mdp.exact import enumerable
from agent.policies import method_name
from agent.study.store import ResultFile, completed_prefix
from cosim.base.errors import UserError
from cosim.base.provenance import digest_of, versions
from cosim.base.reached_code import code_digest
from cosim.base.reading import Kind, parsing, read_json
from cosim.model.config import CoSimConfig
from cosim.model.world import IDEAL
from cosim.simulation.result import EpisodeResult

_CERTIFICATE = Kind("certificate", "move it away and make it again with --claim", UserError)
CERTIFICATE_FILE, POLICY_FILE = "certificate.json", "policy.npz"


class Look(msgspec.Struct, frozen=True):
    """A look at the episodes that would have certified the claim.

    Attributes:
        episodes: after which it was.
        allowed: most of them that may speak against the claim.
        level: its share of 1 - confidence.
        chance: bound of the probability to pass it for a policy with the limit as its rate.
    """

    episodes: int
    allowed: int
    level: float
    chance: float


class Evidence(msgspec.Struct, frozen=True, kw_only=True):
    """Evidence that decided a claim.

    Attributes:
        episodes: until the decision, or known so far.
        against: those that speak against the claim.
        outcomes: how many ended how.
        enough: episodes after which the claim is certified if no more speak against it.
        looks: up to that one.
        results_digest: of the episodes' results, but for the wall-clock time.
        simulated_s: simulated time of the episodes together.
        wall_s: wall-clock time that they took, of all threads together.
        worst_start: largest of the upper bounds (95 %, Clopper-Pearson) of the rate of what speaks
            against the claim, of every start on its own.
    """

    episodes: int
    against: int
    outcomes: dict[str, int]
    enough: int
    looks: tuple[Look, ...]
    results_digest: str
    simulated_s: float
    wall_s: float
    worst_start: float


class CoveredStarts(msgspec.Struct, frozen=True):
    """Starts that the claim is about.

    Attributes:
        starts: combinations of start cells without contact.
        all: whether these are all that there are, or a sample of them.
        rounds: how many times the episodes went round them.
    """

    starts: int
    all: bool
    rounds: float


class Certificate(msgspec.Struct, frozen=True, kw_only=True):
    """The content of certificate.json.

    Attributes:
        claim: as text.
        confidence: with which a verdict is right, for any policy.
        verdict: certified, refused, or undecided as the episodes are too few.
        evidence, starts: see the classes.
        method: by which the policy was trained.
        case: what decides the results: digests of policy, scenario, motor FMU and code, parameters,
            and the seed of starts and noise.
        digest: of the case.
        config: of the co-simulation, with its world.
        results: name of the file with the results of all episodes.
        code_digest: of all that simulates and judges.
        versions: of packages.
        issued: when.
        superseded: when another one replaced it.
        attempts: those of the same folder that this one has replaced, the first one first.
    """

    schema_version: int = 1
    claim: str
    confidence: float
    verdict: Verdict
    evidence: Evidence
    starts: CoveredStarts
    method: str
    case: CaseIdentity
    digest: str
    config: CoSimConfig
    results: str
    code_digest: str
    versions: dict[str, str]
    issued: str
    superseded: str | None = None
    attempts: tuple["Certificate", ...] = ()

    def __post_init__(self) -> None:
        if not LEAST_CONFIDENCE <= self.confidence < 1.0 or self.case.seed < 0:
            raise ValueError("its confidence or its seed is invalid")


def read_certificate(path: Path) -> Certificate:
    """A certificate by its file.

    Raises:
        UserError: there is none, or it is damaged.
    """
    content = read_json(path, _CERTIFICATE, dict)
    with parsing(path, _CERTIFICATE):
        for one in (content, *content.get("attempts", ())):
            config = one["config"]
            if "shielding" in config:  # until commit 0ec7247 next to a bool of the shield
                config["shield"] = config.pop("shielding") if config["shield"] else None
        return msgspec.convert(content, Certificate)


def now() -> str:
    """Return the time, for certificates."""
    return datetime.now(UTC).isoformat(timespec="seconds")


def said(certificate: Certificate) -> str:
    """Return the verdict as text."""
    claim, confidence = certificate.claim, certificate.confidence
    seed = certificate.case.seed
    return f"{certificate.verdict}: {claim} at confidence {confidence:.10g}, seed {seed}"


def claim_test(claim: Claim, confidence: float) -> SequentialTest:
    """The test that a claim has to pass."""
    return SequentialTest(claim.limit, complement(confidence))


def known(
    case: Case, results: Mapping[int, EpisodeResult], most: int | None = None
) -> dict[int, EpisodeResult]:
    """The completed prefix of the episodes of `Case.rounds`.

    Args:
        case: the case of the episodes.
        results: by index.
        most: of them that are looked at, None for all.
    """
    count = len(results) if most is None else min(most, len(results))
    return completed_prefix(results, case.rounds(count))


def decide(
    claim: Claim, test: SequentialTest, results: Mapping[int, EpisodeResult]
) -> ClaimDecision:
    """Return what episodes in their order have decided."""
    return test.decide(result.outcome in claim.against for result in results.values())


def without_timing(result: EpisodeResult) -> EpisodeResult:
    """A result without what differs from run to run."""
    return msgspec.structs.replace(result, realtime_factor=1.0, recording=None)


def judge(
    case: Case, test: SequentialTest, claim: Claim, results: Mapping[int, EpisodeResult]
) -> tuple[Verdict, Evidence]:
    """The verdict on a claim, and its evidence.

    Args:
        case: the case of the episodes.
        test: that the claim has to pass.
        claim: to be judged.
        results: `known` ones.
    """
    verdict, episodes, against = decide(claim, test, results)
    indices = case.rounds(episodes)
    decisive = [results[k] for k in indices]
    ended = [str(result.outcome) for result in decisive]
    looks = tuple(
        Look(n, k, test.level(k), test.chance(k, n))
        for k in range(against + 1)
        for n in [test.episodes_to_certify(k)]
    )
    return verdict, Evidence(
        episodes=episodes,
        against=against,
        outcomes={outcome: ended.count(outcome) for outcome in sorted(set(ended))},
        enough=looks[-1].episodes,
        looks=looks,
        results_digest=digest_of(indices, [without_timing(result) for result in decisive]),
        simulated_s=sum(result.sim_time_s for result in decisive),
        wall_s=sum(result.wall_s for result in decisive),
        worst_start=_worst_start(
            np.array(indices, dtype=int) % len(case.starts),
            np.array([result.outcome in claim.against for result in decisive], dtype=bool),
            len(case.starts),
        ),
    )


def _worst_start(starts: np.ndarray, against: np.ndarray, count: int) -> float:
    """Return the bound of the worst start, see `Evidence`; `against`: which episodes fail."""
    episodes, failed = (np.bincount(of, minlength=count) for of in (starts, starts[against]))
    bounds = beta.ppf(CONFIDENCE, failed + 1, np.maximum(episodes - failed, 1))
    return float(np.where(episodes > failed, bounds, 1.0).max())


def code_of_certificates() -> str:
    """Hash of all code that simulates and judges."""
    return code_digest(f"{__package__}.certify:certify_case")


def covered(case: Case, episodes: int) -> CoveredStarts:
    """The starts of a number of episodes."""
    starts = len(case.starts)
    return CoveredStarts(starts, enumerable(case.policy.process), episodes / starts)


def issue(
    file: ResultFile, claim: Claim, confidence: float, episodes: int | None = None
) -> Certificate:
    """The certificate of the episodes that are known.

    Args:
        file: their results.
        claim: to be judged.
        confidence: declared, below 1.
        episodes: most that are looked at, None for all.
    """
    case = file.case
    test = claim_test(claim, confidence)
    verdict, evidence = judge(case, test, claim, known(case, file.results, episodes))
    return Certificate(
        claim=claim.text,
        confidence=confidence,
        verdict=verdict,
        evidence=evidence,
        starts=covered(case, evidence.episodes),
        method=method_name(case.policy),
        case=case.identity,
        digest=case.digest,
        config=case.config,
        results=file.path.name,
        code_digest=code_of_certificates(),
        versions=versions(),
        issued=now(),
    )


def show_certificate(certificate: Certificate) -> None:
    """Print the verdict and its evidence."""
    evidence, starts = certificate.evidence, certificate.starts
    ended = ", ".join(f"{count} {outcome}" for outcome, count in evidence.outcomes.items())
    print(said(certificate))
    print(
        f"{evidence.episodes} episodes ({ended or 'none'}), {evidence.against} against the claim; "
        f"{starts.rounds:.2f} rounds of {'all' if starts.all else 'a sample of'} {starts.starts} "
        f"starts; {evidence.simulated_s / 3600.0:.1f} simulated hours in "
        f"{evidence.wall_s / 3600.0:.2f} hours of threads"
    )
    config, attempts = certificate.config, certificate.attempts
    world = msgspec.structs.asdict(config.world).items()
    differs = {name: value for name, value in world if value != getattr(IDEAL, name)}
    print(
        f"the rate is the mean over the starts; of any single start that against the claim is at "
        f"most {evidence.worst_start:.3g} (95 %); shield {'on' if config.shield else 'off'}, time "
        f"limit {config.timing.episode_limit_s:g} s, world "
        f"{msgspec.json.encode(differs).decode() if differs else 'ideal'}"
    )
    for number, attempt in enumerate(attempts, 1):
        print(
            f"attempt {number}, superseded {attempt.superseded}: {said(attempt)}, "
            f"{attempt.evidence.episodes} episodes, {attempt.evidence.against} against"
        )
    if attempts:
        wrong = sum(1.0 - tried.confidence for tried in (*attempts, certificate))
        print(
            f"this is attempt {len(attempts) + 1}; the probability that any of these verdicts is "
            f"wrong is at most {min(wrong, 1.0):.3g}"
        )
    if certificate.verdict == "undecided":
        print(
            f"{evidence.enough} episodes would certify it if no more of them speak against it; go "
            "on with more --episodes or --budget-minutes"
        )

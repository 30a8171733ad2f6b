"""Simulates the episodes that a claim needs, and keeps each as it ends."""

from pathlib import Path
from typing import Any

import msgspec

from agent.certification.certificate import (
    CERTIFICATE_FILE,
    POLICY_FILE,
    Certificate,
    claim_test,
    decide,
    issue,
    known,
    now,
    read_certificate,
    said,
)
from agent.certification.claims import LEAST_CONFIDENCE, USUAL_CONFIDENCE, Claim, parse_claim
from agent.certification.sequential import ClaimDecision
from agent.evaluation.cases import Case
from agent.mdp.greedy import GreedyPolicy
from agent.study.episodes import EPISODES, case_of
from agent.study.store import EpisodeStore
from cosim.base.arguments import ConfigError, taken, taken_seed
from cosim.base.errors import UserError, shown
from cosim.base.jobs import Backend, Workers, run, until
from cosim.base.progress import Progress, automatic, showing, silent
from cosim.base.storage import write_json
from cosim.simulation.options import options_of

_AT_ONCE = 10_000  # episodes that are planned


@showing
def certify(
    policy: Any,
    claim: str,
    scenario: Any = None,
    *,
    confidence: float = USUAL_CONFIDENCE,
    out: str | Path = Path("runs/certificate"),
    episodes: int | None = None,
    seed: int = 0,
    supersede: bool = False,
    world: Any = None,
    jobs: int = -1,
    backend: Backend = "threads",
    address: str | None = None,
    budget_minutes: float | None = None,
    progress: Progress | None = automatic,
    **options: Any,
) -> Certificate:
    """Certify or refuse a claim about a policy in the dynamics.

    >>> import minirobots as mr
    >>> policy = mr.train("1a", method="shortest", progress=None)
    >>> mr.certify(policy, "success > 0.5", confidence=0.6, out="claim", progress=None).verdict
    'certified'

    Args:
        policy: trained one, its file, or name of a method.
        claim: "RATE < p" or "RATE > p" with the rate of collision, out_of_board, timeout, failure
            or success.
        scenario: name, file or record; by default that of the policy's file.
        confidence: probability, at least, that the verdict is right.
        out: folder of certificate.json, the policy and the results, from which the same call
            resumes.
        episodes: most that are looked at.
        seed: of training, of the order of the starts and of what episodes draw.
        supersede: replace the certificate of another attempt in the folder, and list it.
        world, jobs, backend, address, budget_minutes, progress, options: one value each, see
            `minirobots.study`.

    Returns:
        The certificate: its verdict is certified, refused or undecided.

    Raises:
        UserError: see its message.
    """
    parsed = parse_claim(claim)
    if not LEAST_CONFIDENCE <= taken("confidence", confidence, float) < 1.0:
        raise ConfigError(
            f"confidence = {confidence} must be at least {LEAST_CONFIDENCE} and less than 1"
        )
    if episodes is not None and taken("episodes", episodes, int) < 1:
        raise ConfigError(f"episodes = {episodes} must be at least 1")
    report, physics = progress or silent, options_of("certify", options)
    where = Workers(jobs=jobs, backend=backend, address=address)
    case = case_of(policy, physics, taken_seed(seed), scenario, world=world, progress=report)
    if not isinstance(case.policy, GreedyPolicy):
        raise ConfigError(
            f"policy = {shown(policy)} cannot be kept with its certificate; give a trained policy, "
            'its file or the name of a method, such as "moves"'
        )
    return certify_case(
        case,
        parsed,
        confidence,
        Path(out),
        episodes=episodes,
        budget_minutes=budget_minutes,
        supersede=supersede,
        where=where,
        progress=report,
    )


def certify_case(
    case: Case,
    claim: Claim,
    confidence: float,
    out: Path,
    *,
    episodes: int | None = None,
    budget_minutes: float | None = None,
    supersede: bool = False,
    where: Workers = Workers(),  # noqa: B008 - a constant
    progress: Progress = silent,
) -> Certificate:
    """Simulate missing episodes until the claim is decided, and write the certificate.

    An undecided one is written before any episode, so that no attempt goes unseen. A certificate
    that has decided is final: it is returned as it is.

    Args:
        case: policy and configuration.
        claim, confidence, out, episodes, budget_minutes, supersede, where, progress: see `certify`.

    Raises:
        UserError: robots that push each other on do not collide; the folder has the certificate of
            another attempt; or of an FMU.
    """
    if case.config.on_collision != "end":
        raise UserError(
            "claims are about episodes that end where robots collide; leave out --on-collision "
            "continue"
        )
    path, attempts = out / CERTIFICATE_FILE, ()
    if path.exists():
        last = read_certificate(path)
        attempts = last.attempts
        if (last.digest, last.claim, last.confidence) == (case.digest, claim.text, confidence):
            if last.verdict != "undecided":
                return last
        elif supersede:
            attempts += (msgspec.structs.replace(last, attempts=(), superseded=now()),)
        else:
            raise UserError(
                f"{path}: holds another attempt ({said(last)}); choose another --out, or replace "
                "and list it with --supersede"
            )
    in_time, store, test = until(budget_minutes), EpisodeStore(out), claim_test(claim, confidence)
    file = store.file(case)

    def so_far() -> ClaimDecision:
        return decide(claim, test, known(case, file.results, episodes))

    def may_begin() -> bool:
        return in_time() and decision.verdict == "undecided"

    def keep() -> Certificate:
        issued = issue(file, claim, confidence, episodes)
        write_json(path, certificate := msgspec.structs.replace(issued, attempts=attempts))
        return certificate

    case.policy.save(out / POLICY_FILE)
    keep()
    try:
        decision = so_far()
        while may_begin():
            needed = test.episodes_to_certify(decision.against)
            wanted = min(needed, episodes or needed, decision.episodes + _AT_ONCE)
            if not (missing := file.missing(case.rounds(wanted))):
                break
            ended = run(missing, store, EPISODES, where, may_begin=may_begin, progress=progress)
            for _, result in ended:
                if result.outcome in claim.against:
                    decision = so_far()
            decision = so_far()
    finally:
        certificate = keep()
    return certificate

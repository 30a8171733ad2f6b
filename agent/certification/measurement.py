"""Simulates the episodes that a claim needs, and keeps each as it ends."""

from pathlib import Path

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
from agent.certification.claims import Claim
from agent.certification.sequential import ClaimDecision
from agent.evaluation.cases import Case
from agent.policies import load_policy
from agent.study.episodes import EPISODES, case_of
from agent.study.store import EpisodeStore
from cosim.base.errors import UserError
from cosim.base.jobs import Workers, run, until
from cosim.base.progress import Progress, silent
from cosim.base.storage import write_json
from cosim.model.scenario_file import read_world
from cosim.model.world import IDEAL
from cosim.simulation.options import SimulationOptions

_AT_ONCE = 10_000  # episodes that are planned


def case_of_file(
    policy: Path, physics: SimulationOptions, seed: int, progress: Progress = silent
) -> Case:
    """Return a policy by its file under the options of a command.

    Raises:
        UserError: see its message.
    """
    world = IDEAL if physics.world is None else read_world(physics.world)
    name = f"{policy}: the policy"
    return case_of(load_policy(policy), physics, seed, world, name=name, progress=progress)


def certify(
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
    """Simulate what is missing until the claim is decided, and write the certificate.

    An undecided one is written before any episode, so that no attempt goes unseen. A certificate
    that has decided is final: it is returned as it is.

    Args:
        case: policy and configuration.
        claim: to be judged.
        confidence: with which the verdict has to be right, below 1.
        out: folder of certificate, policy and results.
        episodes: most that are looked at.
        budget_minutes: after which no episode is started.
        supersede: replace the certificate of another attempt in the folder, and list it.
        where: backend and number of workers; the results do not depend on it.
        progress: receives how many episodes have ended.

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
            needed = test.enough(decision.against)
            wanted = min(needed, episodes or needed, decision.episodes + _AT_ONCE)
            if not (missing := file.missing(case.cover(wanted))):
                break
            ended = run(missing, store, EPISODES, where, may_begin=may_begin, progress=progress)
            for _, result in ended:
                if result.outcome in claim.against:
                    decision = so_far()
            decision = so_far()
    finally:
        certificate = keep()
    return certificate

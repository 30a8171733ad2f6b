"""Simulates the episodes that a claim needs, and keeps each as it ends."""

import time
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
from agent.certification.sequential import Decision
from agent.evaluation.cases import Case, run_jobs
from agent.evaluation.result_file import ResultFile
from agent.policies import load_policy
from cosim.base.errors import UserError
from cosim.base.progress import Progress, silent
from cosim.base.storage import write_json
from cosim.base.world import IDEAL
from cosim.navigation.options import Driving
from cosim.scenarios.file import in_world, read_world

_AT_ONCE = 10_000  # episodes that are planned


def case_of(policy: Path, physics: Driving, seed: int, progress: Progress = silent) -> Case:
    """A policy by its file under the options of a command.

    Raises:
        UserError: see its message.
    """
    loaded = load_policy(policy)
    world = IDEAL if physics.world is None else read_world(physics.world)
    scenario = loaded.config.scenario
    loaded.require_scenario(in_world(scenario, world), f"{policy}: the policy")
    return Case(loaded, *physics.prepare(scenario.robot_diameter_m, progress, world), seed)


def certify(
    case: Case,
    claim: Claim,
    confidence: float,
    out: Path,
    *,
    episodes: int | None = None,
    budget_minutes: float | None = None,
    supersede: bool = False,
    jobs: int = 2,
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
        jobs: threads; the results do not depend on it.
        progress: is told how many episodes are known.

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
    end = None if budget_minutes is None else time.monotonic() + 60.0 * budget_minutes
    file, test = ResultFile(out, case), claim_test(claim, confidence)

    def so_far() -> Decision:
        return decide(claim, test, known(case, file.results, episodes))

    def may_begin() -> bool:
        in_time = end is None or time.monotonic() < end
        return in_time and decision.verdict == "undecided"

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
            missing = file.missing(case.cover(wanted))
            if not missing:
                break
            for job, result in run_jobs(missing, jobs, may_begin):
                file.add(job.index, result)
                done = len(file.results)
                progress("episodes", done, needed, f"{done}/{needed}  {decision.against} against")
                if result.outcome in claim.against:
                    decision = so_far()
            decision = so_far()
    finally:
        certificate = keep()
    return certificate

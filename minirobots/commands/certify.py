"""A claim about a policy, certified or refused with a declared confidence."""

from collections.abc import Iterator
from dataclasses import fields, replace
from pathlib import Path
from typing import Annotated, Any

import tyro

from agent.certification.claims import LEAST_CONFIDENCE, USUAL_CONFIDENCE, parse_claim
from cosim.base.command import require_falling
from cosim.base.errors import UserError
from cosim.base.progress import Progress
from cosim.simulation.options import SimulationOptions
from minirobots.options import (
    BudgetMinutes,
    Count,
    Distributed,
    File,
    Folder,
    Resumable,
    Seed,
    Simulating,
)

_MOST = 10**6
# Options that only one kind of work has.
_OF = {
    "claim": ("confidence", "episodes", "budget_minutes", "supersede"),
    "check": ("sample",),
    "splitting": ("roots", "branches", "gaps"),
}


class Certify(Distributed, Simulating, Resumable):
    """Certify or refuse a claim about a policy in the dynamics, such as 'collision < 1e-3'.

    Episodes run over all starts, each with its own noise, until the claim is decided at the
    declared confidence or the budget is used up; the same command resumes. Exits with status 0 if
    the claim is certified, 1 if it is refused or undecided. --check evaluates a certificate again
    and repeats a sample of its episodes (status 0 if every bit is equal, else 1). --splitting
    estimates how often robots collide where that is rare, and certifies nothing.
    """

    policy: File | None = None
    """Policy (policy.npz); with --check by default the one next to the certificate."""
    claim: str | None = None
    """Claim, made before its episodes are seen: 'RATE < p' or 'RATE > p' with the rate of
    collision, out_of_board, timeout, failure or success."""
    confidence: Annotated[float, tyro.conf.arg(metavar="P")] = USUAL_CONFIDENCE
    """Least probability that the verdict is right."""
    check: Annotated[Path | None, tyro.conf.arg(metavar="CERTIFICATE")] = None
    """Check a certificate.json, with its policy and results in the same folder."""
    sample: int | None = None
    """Episodes to repeat with --check, drawn at random; by default enough to find with a
    probability of 95 % that one row in 100 was altered, about 290 of a long file."""
    splitting: bool = False
    """Estimate the rate of collisions by splitting, with an interval."""
    roots: int = 100
    """Independent episodes of --splitting."""
    branches: int = 4
    """Branches of --splitting of an episode after a level, itself included."""
    gaps: Annotated[tuple[float, ...], tyro.conf.arg(metavar="MM")] = (40.0, 20.0, 10.0, 5.0, 2.0)
    """Levels of --splitting: gaps between two robots in mm, decreasing; contact is the last."""
    out: Folder = Path("runs/certificate")
    """Folder of certificate.json, the policy and the results, or of splitting.json."""
    episodes: Count | None = None
    """Maximum number of episodes."""
    budget_minutes: BudgetMinutes = None
    supersede: bool = False
    """Replace the certificate of another attempt in --out; the new certificate lists it."""
    seed: Seed = 0

    def __post_init__(self) -> None:
        super().__post_init__()
        asked = {"claim": self.claim is not None, "check": self.check is not None}
        asked["splitting"] = self.splitting
        if sum(asked.values()) != 1:
            raise UserError("give one of --claim, --check and --splitting")
        usual = {option.name: option.default for option in fields(self)}
        for work, names in _OF.items():
            for name in names:
                if not asked[work] and getattr(self, name) != usual[name]:
                    option = name.replace("_", "-")
                    raise UserError(f"--{option} has no effect without --{work}; leave it out")
        if self.check and replace(self.physics, motor_fmu=None) != SimulationOptions():
            raise UserError("--check takes the dynamics of the certificate; leave out all others")
        for name, why in {"out": "writes nothing", "seed": "draws a new sample each time"}.items():
            if self.check and getattr(self, name) != usual[name]:
                raise UserError(f"--{name} has no effect with --check, which {why}; leave it out")
        if self.check is None and self.policy is None:
            raise UserError("--policy is missing; name a policy.npz")
        if self.claim is not None:
            parse_claim(self.claim)
        if not LEAST_CONFIDENCE <= self.confidence < 1.0:
            raise UserError(f"--confidence must be at least {LEAST_CONFIDENCE} and less than 1")
        for name, least in {"sample": 0, "roots": 2, "branches": 2}.items():
            value = getattr(self, name)
            if value is not None and not least <= value <= _MOST:
                raise UserError(f"--{name} must be from {least} to {_MOST}")
        require_falling(gaps=self.gaps)


def run(options: Certify, progress: Progress) -> Iterator[Any]:
    """Judge the claim, check the certificate, or estimate the rate of collisions."""
    from agent.certification.certificate import read_certificate, show_certificate

    if options.check:
        from agent.certification.check import check, show_check

        report = check(
            options.check,
            policy=options.policy,
            motor_fmu=options.physics.motor_fmu,
            sample=options.sample,
            where=options.where,
            progress=progress,
        )
        yield report
        show_certificate(read_certificate(options.check))
        show_check(report)
    elif options.splitting:
        from agent.certification.collisions import estimate_collisions, show_splitting
        from agent.study.episodes import case_of

        estimate = estimate_collisions(
            case_of(options.policy, options.physics, options.seed, progress=progress),
            options.out,
            roots=options.roots,
            branches=options.branches,
            gaps_mm=options.gaps,
            where=options.where,
            progress=progress,
        )
        yield estimate
        show_splitting(estimate)
        print(f"estimate in {options.out}/splitting.json")
    else:
        from agent.certification.certify import certify

        others = ("check", "splitting", "where", *_OF["check"], *_OF["splitting"])
        arguments = options.arguments(*others, progress=progress)
        certificate = certify(**arguments, **vars(options.where), **vars(options.physics))
        yield certificate
        show_certificate(certificate)
        print(f"certificate in {options.out}/certificate.json")


def failed(result: Any) -> bool:
    """Return whether the claim is not certified, or the certificate fails its check."""
    from agent.certification.certificate import Certificate
    from agent.certification.check import CheckReport

    if isinstance(result, CheckReport):
        return bool(result.differences)
    return isinstance(result, Certificate) and result.verdict != "certified"

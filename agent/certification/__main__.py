"""`python -m agent.certification`: claims about a policy in the dynamics, certified or refused."""

import sys
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Annotated

import tyro

from agent.certification.claims import LEAST_CONFIDENCE, parse_claim
from cosim.base.command import (
    Jobs,
    Json,
    parse,
    print_json,
    require_at_least,
    require_falling,
    workers,
)
from cosim.base.errors import UserError, run_command
from cosim.base.progress import progress_bars, resumable_bars
from cosim.fmi.isolation import Isolation
from cosim.navigation.options import Driving

NOT_CERTIFIED_STATUS = 1
_MOST = 10**6
# Options that only one kind of work has.
_OF = {
    "claim": ("confidence", "episodes", "budget_minutes", "supersede"),
    "check": ("sample",),
    "splitting": ("roots", "branches", "gaps"),
}


@dataclass(frozen=True, kw_only=True)
class Certify:
    """Certify or refuse a claim about a policy in the dynamics, such as 'collision < 1e-3'.

    Episodes go round all starts, each with noise of its own, until the claim is decided at the
    declared confidence or the budget is used up; the same command resumes. Exits with status 0 if
    the claim is certified, 1 if it is refused or undecided. --check judges a certificate again and
    repeats a sample of its episodes (status 0 if every bit is equal, else 1). --splitting estimates
    how often robots collide where that is rare, and certifies nothing.
    """

    policy: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    """Policy (policy.npz); with --check by default the one beside the certificate."""
    claim: str | None = None
    """What is claimed, before its episodes are seen: 'RATE < p' or 'RATE > p' with the rate of
    collision, out_of_board, timeout, failure or success."""
    confidence: Annotated[float, tyro.conf.arg(metavar="P")] = 0.999999
    """Probability, at least, that the verdict is right."""
    check: Annotated[Path | None, tyro.conf.arg(metavar="CERTIFICATE")] = None
    """Check a certificate.json, beside its policy and results."""
    sample: int | None = None
    """Episodes to repeat with --check, drawn at random; by default enough to find with a
    probability of 95 % that one row in 100 was altered, about 290 of a long file."""
    splitting: bool = False
    """Estimate the rate of collisions by splitting, with an interval."""
    roots: int = 100
    """Independent episodes of --splitting."""
    branches: int = 4
    """Branches of --splitting that an episode has after a level, itself among them."""
    gaps: Annotated[tuple[float, ...], tyro.conf.arg(metavar="MM")] = (40.0, 20.0, 10.0, 5.0, 2.0)
    """Levels of --splitting: gaps between two robots in mm, falling; contact is the last."""
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")] = Path("runs/certificate")
    """Folder of certificate.json, the policy and the results, or of splitting.json."""
    episodes: int | None = None
    """Maximum number of episodes."""
    budget_minutes: Annotated[float | None, tyro.conf.arg(metavar="M")] = None
    """Start no episode after this time in minutes."""
    supersede: bool = False
    """Replace the certificate of another attempt in --out; the new certificate lists it."""
    seed: int = 0
    """Seed of the order of starts and of what episodes draw."""
    jobs: Jobs = -1
    json: Json = False
    physics: Annotated[Driving, tyro.conf.OmitArgPrefixes] = field(default_factory=Driving)
    isolation: Annotated[Isolation, tyro.conf.OmitArgPrefixes] = field(default_factory=Isolation)

    def __post_init__(self) -> None:
        workers(self.jobs)
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
        if self.check and replace(self.physics, motor_fmu=None) != Driving():
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
        require_at_least(0, seed=self.seed, budget_minutes=self.budget_minutes)
        require_at_least(1, episodes=self.episodes)
        for name, least in {"sample": 0, "roots": 2, "branches": 2}.items():
            value = getattr(self, name)
            if value is not None and not least <= value <= _MOST:
                raise UserError(f"--{name} must be from {least} to {_MOST}")
        require_falling(gaps=self.gaps)


def main() -> None:
    """Command line; see `Certify`."""
    options = parse(Certify, "agent.certification")
    options.isolation.enter("agent.certification", options.physics.motor_fmu)
    work = _check if options.check else _split if options.splitting else _certify
    if not work(options):
        sys.exit(NOT_CERTIFIED_STATUS)


def _certify(options: Certify) -> bool:
    from agent.certification.measurement import case_of, certify
    from agent.certification.text import show_certificate

    assert options.claim and options.policy
    with resumable_bars(options.out) as progress:
        certificate = certify(
            case_of(options.policy, options.physics, options.seed, progress),
            parse_claim(options.claim),
            options.confidence,
            options.out,
            episodes=options.episodes,
            budget_minutes=options.budget_minutes,
            supersede=options.supersede,
            jobs=workers(options.jobs),
            progress=progress,
        )
    show_certificate(certificate)
    print(f"certificate in {options.out}/certificate.json")
    if options.json:
        print_json(certificate)
    return certificate.verdict == "certified"


def _check(options: Certify) -> bool:
    from agent.certification.certificate import read_certificate
    from agent.certification.check import check
    from agent.certification.text import show_certificate, show_check

    assert options.check
    with progress_bars() as progress:
        report = check(
            options.check,
            policy=options.policy,
            motor_fmu=options.physics.motor_fmu,
            sample=options.sample,
            jobs=workers(options.jobs),
            progress=progress,
        )
    show_certificate(read_certificate(options.check))
    show_check(report)
    if options.json:
        print_json(report)
    return not report.differences


def _split(options: Certify) -> bool:
    from agent.certification.collisions import estimate_collisions
    from agent.certification.measurement import case_of
    from agent.certification.text import show_splitting

    assert options.policy
    with resumable_bars(options.out) as progress:
        report = estimate_collisions(
            case_of(options.policy, options.physics, options.seed, progress),
            options.out,
            roots=options.roots,
            branches=options.branches,
            gaps_mm=options.gaps,
            jobs=workers(options.jobs),
            progress=progress,
        )
    show_splitting(report)
    print(f"estimate in {options.out}/splitting.json")
    if options.json:
        print_json(report)
    return True


if __name__ == "__main__":
    run_command(main)

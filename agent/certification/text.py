"""Certificates, checks and estimates as text, for the terminal."""

import msgspec

from agent.certification.certificate import Certificate, said
from agent.certification.check import ALTERED, CheckReport
from agent.certification.collisions import SplittingReport
from cosim.base.command import show_table
from cosim.model.world import IDEAL


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


def show_splitting(report: SplittingReport) -> None:
    """Print the probabilities of the levels, and the estimate with its interval."""
    rows = [
        (f"{at.gap_mm:g} mm", f"{at.probability:.3g}", f"[{at.low:.3g}, {at.high:.3g}]")
        for at in report.levels
    ]
    show_table(None, ("gap", "probability", "95 %"), rows, numbers=2)
    print(
        f"collision {report.collision:.3g} [{report.low:.3g}, {report.high:.3g}] (95 %, Wilson "
        f"interval); {report.roots_with_collision} of {report.roots} roots showed one, so the rate "
        f"is at most {report.highest:.3g} (97.5 %); {report.simulated} episodes, worth "
        f"{report.worth:.0f} plain ones"
    )
    print("an estimate certifies nothing; --claim does")

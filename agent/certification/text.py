"""Certificates, checks and estimates in words, for the terminal."""

from agent.certification.certificate import Certificate
from agent.certification.check import CheckReport
from agent.certification.collisions import SplittingReport
from cosim.base.command import show_table


def show_certificate(certificate: Certificate) -> None:
    """Print the verdict and what it stands on."""
    evidence, starts = certificate.evidence, certificate.starts
    ended = ", ".join(f"{count} {outcome}" for outcome, count in evidence.outcomes.items())
    print(f"{certificate.verdict}: {certificate.claim} at confidence {certificate.confidence:.10g}")
    print(
        f"{evidence.episodes} episodes ({ended or 'none'}), {evidence.against} against the claim; "
        f"{starts.rounds:.2f} rounds of {'all' if starts.all else 'a sample of'} {starts.starts} "
        f"starts; {evidence.simulated_s / 3600.0:.1f} simulated hours in "
        f"{evidence.wall_s / 3600.0:.2f} hours of threads"
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


def show_splitting(report: SplittingReport) -> None:
    """Print the probabilities of the levels, and the estimate with its interval."""
    rows = [
        (f"{at.gap_mm:g} mm", f"{at.probability:.3g}", f"[{at.low:.3g}, {at.high:.3g}]")
        for at in report.levels
    ]
    show_table(None, ("gap", "probability", "95 %"), rows, numbers=2)
    worth = f", worth {report.worth:.0f} plain ones" if report.worth else ""
    print(
        f"collision {report.collision:.3g} [{report.low:.3g}, {report.high:.3g}] (95 %, bootstrap "
        f"over {report.roots} roots); {report.roots_with_collision} of the roots showed one, so "
        f"the rate is at most {report.highest:.3g} (97.5 %); {report.simulated} episodes{worth}"
    )
    print("an estimate certifies nothing; --claim does")

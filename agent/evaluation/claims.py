"""Claims about rates of outcomes, such as `collision < 1e-3`, judged by episodes in their order.

docs/studies.md describes what a claim is about and how it is judged.
"""

import re
from collections.abc import Iterable
from decimal import Decimal
from typing import NamedTuple

import msgspec

from agent.evaluation.sequential import SequentialTest, Verdict
from cosim.base.arguments import ConfigError
from cosim.model.outcome import ENDS, Outcome
from cosim.simulation.result import EpisodeResult

RATES: dict[str, frozenset[Outcome]] = {
    **{str(outcome): frozenset({outcome}) for outcome in ENDS},
    "failure": frozenset(ENDS) - {Outcome.SUCCESS},
}
CONFIDENCE = 0.999  # by default
_FORM = re.compile(r"\s*(\w+)\s*([<>])\s*((?:\d+\.?\d*|\.\d+)(?:e[+-]?\d{1,3})?)\s*", re.ASCII)
_LEAST = 1e-6  # of a limit: some ten million episodes


class JudgedClaim(msgspec.Struct, frozen=True):
    """A claim, its verdict and the evidence."""

    text: str
    confidence: float  # least probability that the verdict is right, for any policy
    verdict: Verdict  # undecided if there are too few episodes
    episodes: int  # until the decision, or in all
    against: int  # number of these that contradict the claim
    enough: int  # number of episodes that certifies it if no more of them contradict it

    def __str__(self) -> str:
        """Return the claim with its evidence."""
        more = f"; {self.enough} certify it if no more do" if self.verdict == "undecided" else ""
        return (
            f"{self.text} at confidence {self.confidence:.10g}; {self.against} of {self.episodes} "
            f"episodes contradict it{more}"
        )


class Claim(NamedTuple):
    """A statement about a policy: the rate of the outcomes that contradict it is below a limit."""

    text: str
    against: frozenset[Outcome]
    limit: float
    confidence: float

    def judge(self, results: Iterable[EpisodeResult]) -> JudgedClaim:
        """Return the verdict of a sequential test, which uses no episode after its decision."""
        test = SequentialTest(self.limit, _complement(self.confidence))
        verdict, episodes, against = test.decide(r.outcome in self.against for r in results)
        enough = test.episodes_to_certify(against)
        return JudgedClaim(self.text, self.confidence, verdict, episodes, against, enough)


def claim_of(text: str | None, confidence: float | None) -> Claim | None:
    """Return the claim `RATE < p` or `RATE > p`, None if there is neither text nor confidence."""
    if text is None:
        if confidence is not None:
            raise ConfigError(
                f"confidence = {confidence:g} has no effect without a claim; leave it out, or give "
                "a claim such as 'collision < 1e-2'"
            )
        return None
    match = _FORM.fullmatch(text)
    if match is None or match[1] not in RATES:
        raise ConfigError(
            f"claim {text!r} is invalid; write RATE < p or RATE > p with a rate of "
            f"{', '.join(RATES)}, such as 'collision < 1e-2'"
        )
    name, relation, number = match.groups()
    limit = float(number) if relation == "<" else _complement(number)
    if not _LEAST <= limit <= 1.0 - _LEAST:
        raise ConfigError(
            f"claim {text!r} cannot be certified; give a rate from {_LEAST:g} to 1 - {_LEAST:g}"
        )
    against = RATES[name] if relation == "<" else frozenset(ENDS) - RATES[name]
    return Claim(f"{name} {relation} {number}", against, limit, confidence or CONFIDENCE)


def _complement(share: float | str) -> float:
    """Return 1 - share, in the decimals that it is written with."""
    return float(1 - Decimal(str(share)))

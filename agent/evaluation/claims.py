"""Claims about rates of outcomes, such as `collision < 1e-3`, judged by episodes in their order.

docs/studies.md describes what a claim is about, how it is judged, and the sources of the method.
"""

import re
from bisect import bisect_left
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from decimal import Decimal
from functools import cache
from typing import Literal, NamedTuple

import msgspec
from scipy.stats import binom

from cosim.base.arguments import ConfigError
from cosim.model.outcome import ENDS, Outcome
from cosim.simulation.result import EpisodeResult

Verdict = Literal["certified", "refused", "undecided"]
RATES: dict[str, frozenset[Outcome]] = {
    **{str(outcome): frozenset({outcome}) for outcome in ENDS},
    "failure": frozenset(ENDS) - {Outcome.SUCCESS},
}
CONFIDENCE = 0.999  # by default
_FORM = re.compile(r"\s*(\w+)\s*([<>])\s*((?:\d+\.?\d*|\.\d+)(?:e[+-]?\d{1,3})?)\s*", re.ASCII)
_LEAST = 1e-6  # of a limit: some ten million episodes


@dataclass(frozen=True)
class SequentialTest:
    """Test of whether the rate of what speaks against a claim is below a limit; may end any time.

    Both errors are bounded at once: the probability to certify a rate that is not below the limit,
    and that to refuse one that is not above it, are each at most alpha, however long it takes.
    Episodes go round strata (starts) in a random order, each round on its own, or are independent
    draws; what is tested is the mean rate over all strata.
    """

    limit: float  # of the rate, between 0 and 1
    alpha: float  # bound of the probability of either error

    def level(self, look: int) -> float:
        """Share of alpha that a look may spend, look = 0, 1, ...; all together spend alpha."""
        return self.alpha / ((look + 1) * (look + 2))

    @cache  # noqa: B019 - by the test's numbers, of which there are few
    def episodes_to_certify(self, against: int) -> int:
        """Episodes after which the claim is certified if at most that many speak against it."""
        level = self.level(against)
        return _first(lambda n: _at_most(against, n, self.limit) <= level, against + 1)

    @cache  # noqa: B019
    def episodes_to_refute(self, against: int) -> int:
        """Episodes within which that many (at least one) against the claim refuse it."""
        level = self.level(against - 1)
        # this number against of n are no more than the rest that are for the claim
        return _first(lambda n: _at_most(n - against, n, 1.0 - self.limit) > level, against) - 1

    def decide(self, episodes: Iterable[bool]) -> tuple[Verdict, int, int]:
        """Return the verdict after episodes, of which each speaks against the claim or does not.

        With it the number of episodes until the decision, and how many of these speak against it.
        Episodes after the one that decides are not used.
        """
        count = against = 0
        needed = self.episodes_to_certify(0)
        for speaks_against in episodes:
            count += 1
            if speaks_against:
                against += 1
                if count <= self.episodes_to_refute(against):
                    return "refused", count, against
                needed = self.episodes_to_certify(against)
            if count >= needed:
                return "certified", count, against
        return "undecided", count, against


def _at_most(successes: int, trials: int, rate: float) -> float:
    """P(at most that many successes) for any strata of this mean rate, bounded (Hoeffding 1956)."""
    if successes > trials * rate - 1.0:
        return 1.0
    return float(binom.cdf(successes, trials, rate))


def _first(holds: Callable[[int], bool], begin: int) -> int:
    """The first number from `begin` on for which something holds that then holds for all."""
    end = begin + 1
    while not holds(end):
        end = begin + 2 * (end - begin)
    return begin + bisect_left(range(begin, end), x=True, key=holds)


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

"""A test of a rate, episode by episode, that may end at any of them.

Both errors are bounded at once: the probability to certify a rate that is not below the limit, and
that to refuse one that is not above it, are each at most 1 - confidence, however long it takes.
Methods and sources are in docs/studies.md.
"""

from bisect import bisect_left
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cache
from typing import Literal, NamedTuple

from scipy.stats import binom

Verdict = Literal["certified", "refused", "undecided"]


class ClaimDecision(NamedTuple):
    """Result of a sequential test of a claim.

    Attributes:
        verdict: undecided if they are too few.
        episodes: of them until the decision.
        against: how many of these speak against the claim.
    """

    verdict: Verdict
    episodes: int
    against: int


@dataclass(frozen=True)
class SequentialTest:
    """Sequential test of whether the rate of what speaks against a claim is below a limit.

    Episodes go round strata (starts) in a random order, each round on its own, or are independent
    draws; what is tested is the mean rate over all strata.

    Attributes:
        limit: of the rate, between 0 and 1.
        alpha: bound of the probability of either error.
    """

    limit: float
    alpha: float

    def level(self, look: int) -> float:
        """Share of alpha that a look may spend, look = 0, 1, ...; all together spend alpha."""
        return self.alpha / ((look + 1) * (look + 2))

    def episodes_to_certify(self, against: int) -> int:
        """Episodes after which the claim is certified if at most that many speak against it."""
        return _enough(against, self.limit, self.level(against))

    def episodes_to_refute(self, against: int) -> int:
        """Episodes within which that many (at least one) against the claim refuse it."""
        return _refuted(against, self.limit, self.level(against - 1))

    def decide(self, episodes: Iterable[bool]) -> ClaimDecision:
        """The decision after episodes, of which each speaks against the claim or does not.

        Episodes after the one that decides are not looked at.
        """
        count = against = 0
        needed = self.episodes_to_certify(0)
        for speaks_against in episodes:
            count += 1
            if speaks_against:
                against += 1
                if count <= self.episodes_to_refute(against):
                    return ClaimDecision("refused", count, against)
                needed = self.episodes_to_certify(against)
            if count >= needed:
                return ClaimDecision("certified", count, against)
        return ClaimDecision("undecided", count, against)


def _at_most(successes: int, trials: int, rate: float) -> float:
    """P(at most that many successes) for any strata of this mean rate, bounded (Hoeffding 1956)."""
    if successes > trials * rate - 1.0:
        return 1.0
    return float(binom.cdf(successes, trials, rate))


@cache
def _enough(against: int, limit: float, level: float) -> int:
    return _first(lambda n: _at_most(against, n, limit) <= level, against + 1)


@cache
def _refuted(against: int, limit: float, level: float) -> int:
    # this number against of n are no more than the rest that are for the claim
    return _first(lambda n: _at_most(n - against, n, 1.0 - limit) > level, against) - 1


def _first(holds: Callable[[int], bool], begin: int) -> int:
    """The first number from `begin` on for which something holds that then holds for all."""
    end = begin + 1
    while not holds(end):
        end = begin + 2 * (end - begin)
    return begin + bisect_left(range(begin, end), x=True, key=holds)

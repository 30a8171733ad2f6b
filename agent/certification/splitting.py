"""Probabilities of rare events by splitting: what comes close to the event is tried again.

An episode passes levels on the way to the event, which is the last one. Where it first reaches a
level it is split: several branches share its past and have random futures of their own. Their
number is fixed, and a branch weighs so much less, so that the estimate has no bias (Glasserman,
Heidelberger, Shahabuddin and Zajic, "Multilevel splitting for estimating rare event
probabilities", 1999). Nothing here knows what an episode is.
"""

from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple

import numpy as np

# Steps at the ends of which an episode first reached the levels; never decreasing.
Entrances = tuple[int, ...]


class Branch(NamedTuple):
    """An episode by its seeds.

    Attributes:
        root: the root that it shares its past with.
        forks: steps from the start of which it has other random numbers, and which ones.
    """

    root: int
    forks: tuple[tuple[int, int], ...] = ()


def split(
    roots: Sequence[int],
    branches: int,
    levels: int,
    simulate: Callable[[Sequence[Branch]], Iterable[tuple[Branch, Entrances, int]]],
) -> np.ndarray:
    """Return how probable the levels are, root by root.

    Args:
        roots: numbers of independent episodes.
        branches: that an episode has after a level, itself among them.
        levels: including the event.
        simulate: gives the entrances of every branch asked for and its last step, in any order.

    Returns:
        (roots, levels) float64, unbiased estimates of the probabilities to reach the levels,
        independent between roots.
    """
    reached = np.zeros((len(roots), levels))
    rows = {root: row for row, root in enumerate(roots)}
    # Branches with the number of levels that they had passed when they began, and their weight.
    waiting = {Branch(root): (0, 1.0) for root in roots}
    while waiting:
        begun, waiting = waiting, {}
        for branch, entrances, last in simulate(list(begun)):
            passed, weight = begun[branch]
            while passed < len(entrances):
                step = entrances[passed]
                before, passed = passed, sum(entrance <= step for entrance in entrances)
                reached[rows[branch.root], before:passed] += weight
                if passed == levels or step == last:
                    break  # there is no future to be split
                weight /= branches
                for number in range(1, branches):
                    fork = Branch(branch.root, (*branch.forks, (step + 1, number)))
                    waiting[fork] = passed, weight
    return reached

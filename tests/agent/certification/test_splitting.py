"""Splitting, on a walk whose probabilities are known exactly."""

import numpy as np
import pytest
from scipy.stats import binom

from agent.certification.splitting import Branch, split
from agent.evaluation.statistics import rate_of_weights

STEPS, LEVELS = 100, (10, 20, 30, 40)


def walk(branches):
    """Steps of 1 up or down; the entrances of a walk are when it first is so high."""
    for branch in branches:
        steps = np.random.default_rng([7, branch.root]).choice([-1, 1], STEPS)
        for count, (begin, _) in enumerate(branch.forks, 1):
            key = [7, branch.root, *np.ravel(branch.forks[:count])]
            steps[begin:] = np.random.default_rng(key).choice([-1, 1], STEPS - begin)
        height = np.cumsum(steps)
        entrances = tuple(int(np.argmax(height >= k)) for k in LEVELS if height.max() >= k)
        yield branch, entrances, STEPS - 1


def reflected(height: int) -> float:
    """P(a walk is ever so high), by the reflection principle."""
    ends = (STEPS + height) / 2
    return float(binom.sf(ends - 1, STEPS, 0.5) + binom.sf(ends, STEPS, 0.5))


@pytest.fixture(scope="module")
def reached():
    return split(range(800), 6, len(LEVELS), walk)


def test_estimates_have_no_bias(reached):
    for values, level in zip(reached.T, LEVELS, strict=True):
        error = values.std(ddof=1) / len(values) ** 0.5
        assert abs(values.mean() - reflected(level)) < 3.5 * error


def test_rare_events_are_seen_with_intervals_that_cover_them(reached):
    rare = reached[:, -1]
    assert reflected(LEVELS[-1]) < 1e-4
    share, variance = float(rare.mean()), float(rare.var(ddof=1)) / len(rare)
    _, low, high = rate_of_weights(share, share * (1.0 - share) / variance)
    assert 0.0 < low < reflected(LEVELS[-1]) < high < 3e-4
    plain = reflected(LEVELS[-1]) / len(rare)
    assert rare.var(ddof=1) / len(rare) < plain / 5  # a fifth of the episodes' own variance


def test_roots_do_not_depend_on_each_other(reached):
    assert (split([3, 1, 20], 6, len(LEVELS), walk) == reached[[3, 1, 20]]).all()


def test_what_is_certain_has_the_probability_one():
    asked = []

    def certain(branches):
        asked.extend(branches)
        return [(branch, (0, 2, 2, 5), 9) for branch in branches]

    assert (split([0, 4], 4, 4, certain) == 1.0).all()
    assert Branch(4, ((1, 2), (3, 1))) in asked
    # four of level 1, each of them four of levels 2 and 3, which are reached together
    assert len(asked) == 2 * 4 * 4


def test_what_is_reached_at_the_end_counts_and_has_no_branches():
    asked = []

    def ending(branches):
        asked.extend(branches)
        return [(branch, (3, 5), 5) for branch in branches]

    assert (split([0], 4, 3, ending) == [[1.0, 1.0, 0.0]]).all()
    assert len(asked) == 4  # of the first level only

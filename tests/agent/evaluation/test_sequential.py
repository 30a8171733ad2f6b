"""The sequential test: its sizes, and both errors computed exactly, step by step."""

import math
from itertools import combinations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import beta, binom

from agent.evaluation.claims import SequentialTest


def chances(test: SequentialTest, rates: list[float], most: int) -> tuple[float, float]:
    """Probabilities to certify and to refuse within some episodes.

    Strata have one of two rates; the state is how many episodes spoke against the claim, and how
    many strata of the first rate this round has had.
    """
    low, high = min(rates), max(rates)
    firsts, seconds = rates.count(low), len(rates) - rates.count(low)
    state = np.zeros((most + 2, firsts + 1))
    state[0, 0] = 1.0
    certified = refused = 0.0
    enough = [test.episodes_to_certify(k) for k in range(60)] + [most + 1] * most
    refuted = [0] + [test.episodes_to_refute(k) for k in range(1, 60)] + [0] * most
    for count in range(1, most + 1):
        at = (count - 1) % len(rates)
        after = np.zeros_like(state)
        for had in range(min(firsts, at) + 1):
            left = firsts - had, seconds - (at - had)
            for share, rate, then in ((left[0], low, had + 1), (left[1], high, had)):
                if share <= 0:
                    continue
                p = state[:, had] * share / sum(left)
                column = 0 if at + 1 == len(rates) else then
                after[:, column] += (1.0 - rate) * p
                after[1:, column] += rate * p[:-1]
        state = after
        for against in range(min(count, most) + 1):
            if count >= enough[against]:
                certified += state[against].sum()
                state[against] = 0.0
            elif against and count <= refuted[against]:
                refused += state[against].sum()
                state[against] = 0.0
    assert certified + refused + state.sum() == pytest.approx(1.0)
    return certified, refused


@pytest.mark.parametrize("limit", [0.05, 0.3])
@pytest.mark.parametrize("alpha", [0.2, 0.01])
def test_errors_are_bounded_at_the_limit_and_not_idle(limit, alpha):
    certified, refused = chances(SequentialTest(limit, alpha), [limit], 400)
    assert alpha / 5 < certified <= alpha
    assert alpha / 50 < refused <= alpha


def test_a_clear_rate_is_decided():
    test = SequentialTest(0.2, 1e-3)
    assert chances(test, [0.05], 400)[0] > 0.999
    assert chances(test, [0.5], 400)[1] > 0.999
    assert chances(test, [0.25], 400)[0] < 1e-3


@pytest.mark.parametrize("rates", [[0.0] * 6 + [0.5] * 4, [0.1] * 5 + [0.3] * 5])
def test_strata_of_different_rates_make_no_error_more_probable(rates):
    alpha, limit = 0.05, float(np.mean(rates))
    certified, refused = chances(SequentialTest(limit, alpha), rates, 240)
    assert 0.0 < certified <= alpha
    assert 0.0 < refused <= alpha


def test_what_the_start_decides_is_no_error_at_all():
    rates = [0.0] * 8 + [1.0] * 2
    assert chances(SequentialTest(0.2, 0.05), rates, 240) == (0.0, 0.0)


@pytest.mark.parametrize("against", range(5))
def test_sizes_are_those_of_clopper_and_pearson(against):
    limit, test = 1e-3, SequentialTest(1e-3, 1e-6)
    n, level = test.episodes_to_certify(against), test.level(against)
    assert beta.isf(level, against + 1, n - against) <= limit
    assert beta.isf(level, against + 1, n - 1 - against) > limit
    assert binom.cdf(against, n, limit) <= level < binom.cdf(against, n - 1, limit)
    n, level = test.episodes_to_refute(against + 6), test.level(against + 5)
    assert beta.ppf(level, against + 6, n - against - 5) >= limit
    assert beta.ppf(level, against + 6, n - against - 4) < limit


def test_no_round_has_to_be_complete():
    test = SequentialTest(1e-3, 1e-6)
    assert test.episodes_to_certify(0) == math.ceil(math.log(0.5e-6) / math.log1p(-1e-3)) == 14_502
    assert test.episodes_to_certify(1) == 18_574  # 20.6 rounds of 900 starts


@given(st.lists(st.floats(0.0, 1.0), min_size=2, max_size=7), st.data())
def test_a_part_of_a_round_is_less_spread_than_the_binomial(rates, data):
    """So that sizes are the binomial's: episodes of some of the starts, drawn at random."""
    n = data.draw(st.integers(1, len(rates)))
    counts = np.zeros(n + 1)
    for chosen in combinations(rates, n):
        p = np.ones(1)
        for rate in chosen:
            p = np.convolve(p, [1.0 - rate, rate])
        counts += p
    at_most = np.cumsum(counts / counts.sum())
    mean = float(np.mean(rates))
    for k in range(n + 1):
        if k <= n * mean - 1.0:
            assert at_most[k] <= binom.cdf(k, n, mean) + 1e-12


def test_levels_spend_alpha():
    test = SequentialTest(0.1, 0.01)
    assert sum(map(test.level, range(100_000))) == pytest.approx(0.01, rel=1e-4)


def test_decisions_come_at_the_first_look_that_allows_them():
    test = SequentialTest(0.1, 0.05)
    clean, one = test.episodes_to_certify(0), test.episodes_to_certify(1)
    assert test.decide([False] * 1000) == ("certified", clean, 0)
    assert test.decide([False] * (clean - 1)) == ("undecided", clean - 1, 0)
    assert test.decide([True] + [False] * 1000) == ("certified", one, 1)
    at = next(k for k in range(1, 20) if k <= test.episodes_to_refute(k))
    assert test.decide([True] * 1000) == ("refused", at, at)

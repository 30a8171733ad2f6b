"""Intervals that hold what they are for as often as they say, and the interquartile mean."""

import numpy as np
import pytest

from agent.evaluation.statistics import (
    Interval,
    interquartile_mean,
    interval_text,
    mean_intervals,
    paired_difference,
    paired_test,
    rate,
    rate_over_trainings,
    summarise,
)


def test_interquartile_mean_is_the_mean_of_the_middle_half():
    assert interquartile_mean(np.array([100.0, 1, 2, 3, 4, 5, 6, -50])) == 3.5
    # five values: the middle half is 2.5 values wide and takes 3/4 of two of them
    assert interquartile_mean(np.array([0.0, 1, 2, 4, 99])) == pytest.approx(
        (0.75 * 1 + 2 + 0.75 * 4) / 2.5
    )
    assert interquartile_mean(np.array([7.0])) == 7.0


def test_interval_has_the_width_of_the_normal_one():
    values = np.random.default_rng(0).normal(3.0, 2.0, size=400)
    s = summarise(values)
    half = 1.966 * values.std(ddof=1) / 20.0
    assert s.mean == pytest.approx(values.mean())
    assert s.low is not None
    assert s.high is not None
    assert (s.high - s.low) / 2.0 == pytest.approx(half, rel=1e-3)


def test_interval_of_curves_is_that_of_each_point():
    curves = np.random.default_rng(1).random((20, 5))
    curves[3, 2] = np.nan
    curves[:, 4] = np.nan
    low, high = mean_intervals(curves)
    assert low.shape == high.shape == (5,)
    for k in range(4):
        s = summarise(curves[:, k])
        assert (s.low, s.high) == (low[k], high[k])
    assert np.isnan([low[4], high[4]]).all()


def within(value: float, of: Interval) -> bool:
    assert of.low is not None
    assert of.high is not None
    return of.low <= value <= of.high


def drawn(rng, trainings, starts, effects):
    """Successes of trainings that differ, from starts that do."""
    odds = 2.0 + rng.normal(size=(trainings, 1)) + effects[:starts]
    return rng.random((trainings, starts)) < 1.0 / (1.0 + np.exp(-odds))


def test_intervals_over_trainings_and_of_paired_differences_cover():
    """Those of all episodes alone would cover in 30 of 40."""
    rng = np.random.default_rng(5)
    true = drawn(rng, 4000, 500, rng.normal(size=500)).mean()
    covers = zero = 0
    for _ in range(40):
        effects = rng.normal(size=15)
        first, second = (drawn(rng, n, 15, effects) for n in (8, 5))
        covers += within(true, rate_over_trainings(first))
        zero += within(0.0, paired_difference(first, second))
    assert min(covers, zero) >= 37


def test_what_is_paired_is_tested_as_paired():
    first = np.arange(20) < 18
    second = np.arange(20) < 10
    pairs = first[None], second[None]
    difference = paired_difference(*pairs)
    assert difference.mean == pytest.approx(0.4)
    assert not within(0.15, difference)
    assert paired_difference(first[None], first[None]) == (0.0, 0.0, 0.0)  # the same starts
    assert paired_test(first, second) == pytest.approx(2.0 * 0.5**8)
    assert paired_test(second, first) == paired_test(first, second)
    assert paired_test(first, first) == 1.0
    alike = rate_over_trainings(np.ones((10, 20), bool))
    assert alike == rate(200, 200)  # a bootstrap would have no spread


@pytest.mark.parametrize("runs", [2, 5, 20])
def test_intervals_of_few_runs_cover(runs):
    """Also of skewed values, and where half of the runs succeed from every start."""
    shape = runs, 1000

    def wrong(draw, mean):
        low, high = mean_intervals(draw(np.random.default_rng([0, runs])))
        return np.mean(low > mean) + np.mean(high < mean)  # NaN where there is none

    assert wrong(lambda rng: rng.normal(size=shape), 0.0) == pytest.approx(0.05, abs=0.03)
    assert wrong(lambda rng: rng.exponential(size=shape), 1.0) < 0.12
    assert wrong(lambda r: 1.0 - 0.1 * r.random(shape) * (r.random(shape) < 0.5), 0.975) < 0.12


@pytest.mark.parametrize(
    ("values", "known"),
    [
        ([3.0], False),
        ([1.0, 1.0], False),
        ([1.0, 1.0, 1.0, 0.9, 0.8], False),
        ([1.0, 1.0, 0.7, 0.9, 0.8], True),
        ([1.0] * 30 + [0.01 * k for k in range(9)], False),
        ([1.0] * 30 + [0.01 * k for k in range(10)], True),
    ],
)
def test_runs_of_which_most_agree_have_no_interval(values, known):
    s = summarise(values)
    assert (s.low is not None, s.high is not None) == (known, known)
    assert s.mean == pytest.approx(np.mean(values))
    some = summarise([*values, np.nan])  # runs without a value are left out
    assert (some.mean, some.low, some.high, some.runs) == (s.mean, s.low, s.high, len(values))


def test_intervals_of_shares_end_at_0_and_1_and_nothing_has_none():
    s, empty = summarise([1.0, 0.99, 0.1], 0.0, 1.0), summarise(np.array([np.nan]))
    assert (s.low, s.high) == (0.0, 1.0)
    assert (empty.mean, empty.runs) == (None, 0)
    assert interval_text(Interval(0.5, 0.25, 0.75), 1, 100.0, " %") == "50.0 % [25.0, 75.0]"
    assert interval_text(Interval(-0.5, None, None), 2) == "−0.50 [–]"
    assert interval_text(Interval(None, None, None), 2) == "–"


@pytest.mark.parametrize(
    ("count", "episodes", "low", "high"),
    [(0, 30, 0.0, 0.11351), (30, 30, 0.88649, 1.0), (95, 100, 0.88825, 0.97846)],
)
def test_wilson_interval(count, episodes, low, high):
    assert rate(count, episodes) == pytest.approx((count / episodes, low, high), abs=1e-5)

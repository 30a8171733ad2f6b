"""Interquartile mean and bootstrap against known values."""

import numpy as np
import pytest

from agent.evaluation.statistics import bootstrap_interval, interquartile_mean, summarise


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
    half = 1.96 * values.std() / 20.0
    assert s.mean == pytest.approx(values.mean())
    assert s.low is not None
    assert s.high is not None
    assert (s.high - s.low) / 2.0 == pytest.approx(half, rel=0.05)
    assert s == summarise(values)


def test_runs_without_a_value_are_left_out():
    s = summarise(np.array([1.0, np.nan, 3.0]))
    assert (s.mean, s.runs) == (2.0, 2)
    empty = summarise(np.array([np.nan]))
    assert empty.runs == 0
    assert empty.mean is None


def test_interval_of_curves_is_that_of_each_point():
    curves = np.random.default_rng(1).random((20, 5))
    curves[3, 2] = np.nan
    low, high = bootstrap_interval(curves)
    assert low.shape == high.shape == (5,)
    for k in (0, 2):
        s = summarise(curves[:, k])
        assert (s.low, s.high) == pytest.approx((low[k], high[k]), abs=5e-3)

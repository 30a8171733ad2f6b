"""Lanes do to each of their numbers what numpy does to it, special values included."""

import itertools
import math

import numpy as np
import pytest
from numba.core import config

from cosim.base.jit import kernel
from cosim.physics.lanes import any_lane, floor, host_lanes, load, select, store, width_of

SPECIAL = (math.nan, math.inf, -math.inf, 0.0, -0.0, 2.5, -0.5, 1e-310)
PAIRS = np.array(list(itertools.product(SPECIAL, repeat=2))).T  # (2, 64)
SCALE = 0.1
ROWS = 23


@kernel
def every_operation(numbers, results, scale, width):
    for column in range(0, numbers.shape[1], len(width)):
        x, y = load(numbers, 0, column, width), load(numbers, 1, column, width)
        store(results, 0, column, width, x + y)
        store(results, 1, column, width, x - y)
        store(results, 2, column, width, x * y)
        store(results, 3, column, width, x / y)
        store(results, 4, column, width, -x)
        store(results, 5, column, width, abs(x))
        store(results, 6, column, width, math.sqrt(x))
        store(results, 7, column, width, floor(x))
        store(results, 8, column, width, select(x < y, 1.0, 0.0))
        store(results, 9, column, width, select(x <= y, 1.0, 0.0))
        store(results, 10, column, width, select(x > y, 1.0, 0.0))
        store(results, 11, column, width, select(x >= y, 1.0, 0.0))
        store(results, 12, column, width, select(x == y, 1.0, 0.0))
        store(results, 13, column, width, select((x < y) & (y > 0.0), x, y))
        store(results, 14, column, width, select((x < y) | (scale > 1.0), x, scale))
        # numbers that stand for all lanes, whole ones too
        store(results, 15, column, width, 2 - x)
        store(results, 16, column, width, x / scale + 3)
        store(results, 17, column, width, scale)
        # variables that begin as one number and become lanes
        grown, below = 1.0, False
        for _ in range(2):
            grown += x
            below = below | (x < y)
        store(results, 18, column, width, grown)
        store(results, 19, column, width, select(below, 1.0, 0.0))
        # one truth of all lanes
        store(results, 20, column, width, 1.0 if any_lane(x < y) else 0.0)
        store(results, 21, column, width, 1.0 if any_lane((x < y) & (y < x)) else 0.0)
    store(results, ROWS - 1, 1, width, load(numbers, 0, 1, width))


def expected(lanes: int) -> np.ndarray:
    x, y = PAIRS
    with np.errstate(all="ignore"):
        rows = [x + y, x - y, x * y, x / y, -x, abs(x), np.sqrt(x), np.floor(x)]
        rows += [x < y, x <= y, x > y, x >= y, x == y]
        rows += [np.where((x < y) & (y > 0.0), x, y), np.where(x < y, x, SCALE)]
        rows += [2 - x, x / SCALE + 3, np.full_like(x, SCALE), 1.0 + x + x, x < y]
    anywhere = np.repeat((x < y).reshape(-1, lanes).any(axis=1), lanes)
    moved = np.zeros_like(x)
    moved[1 : 1 + lanes] = x[1 : 1 + lanes]
    return np.array([*rows, anywhere, np.zeros_like(x), moved], dtype=np.float64)


@pytest.mark.parametrize("lanes", [1, 2, 8])
def test_each_lane_has_the_bits_of_numpy(lanes):
    # memory that no vector is aligned to
    numbers = np.zeros(PAIRS.size + 1)[1:].reshape(PAIRS.shape)
    numbers[:] = PAIRS
    results = np.zeros((ROWS, PAIRS.shape[1]))
    every_operation(numbers, results, SCALE, width_of(lanes))
    wanted = expected(lanes)
    np.testing.assert_array_equal(results, wanted)
    there = ~np.isnan(wanted)
    np.testing.assert_array_equal(np.signbit(results[there]), np.signbit(wanted[there]))


@pytest.mark.parametrize(
    ("features", "lanes"), [("+avx2,+avx512f", 8), ("+avx2,-avx512f", 4), ("+sse2", 2)]
)
def test_a_register_has_the_lanes_that_numba_is_told_of(features, lanes, monkeypatch):
    monkeypatch.setattr(config, "CPU_FEATURES", features)
    assert host_lanes() == lanes

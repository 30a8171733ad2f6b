"""Searches: they depend on their seed and on what they are told, and evolution learns."""

from typing import Literal

import numpy as np
import pytest

from agent.falsification.ranges import folded
from agent.falsification.search import GENERATION, new_search


def searched(
    name: Literal["cma", "random"], seed: int, dimensions: int = 6, generations: int = 25
) -> np.ndarray:
    """(generations GENERATION,) distances from a point, all vectors told."""
    search, found = new_search(name, np.full(dimensions, 0.2), seed), []
    for _ in range(generations):
        vectors = search.ask()
        assert vectors.shape == (GENERATION, dimensions)
        costs = np.linalg.norm(folded(vectors) - 0.8, axis=1)
        search.tell(vectors, costs)
        found.append(costs)
    return np.concatenate(found)


@pytest.mark.parametrize("name", ["cma", "random"])
def test_a_search_is_asked_the_same_again(name):
    np.random.seed(3)  # noqa: NPY002 - what others draw from
    expected = np.random.random(2)  # noqa: NPY002
    np.random.seed(3)  # noqa: NPY002
    first = searched(name, 0)
    assert np.array_equal(first, searched(name, 0))
    assert not np.array_equal(first, searched(name, 1))
    assert np.array_equal(np.random.random(2), expected)  # noqa: NPY002


def test_evolution_learns_what_random_vectors_do_not():
    for seed in range(3):
        assert searched("cma", seed).min() < 0.5 * searched("random", seed).min()


def test_a_single_coordinate_is_searched_too_and_anew_after_convergence():
    found = searched("cma", 0, dimensions=1, generations=80)
    assert found.min() < 0.01
    best = int(found.argmin())
    assert found[best + 1 :].max() > 0.1

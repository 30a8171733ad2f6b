"""Choose the next episodes of a search: by evolution (CMA-ES), or at random as a baseline.

A search is asked for vectors (see `agent.falsification.ranges`) and told what became of them; it
depends on its seed and on what it receives alone, so that it can be asked again.
"""

from typing import Any, Literal, Protocol, get_args

import numpy as np

Sought = Literal["gap", "time"]
SearchName = Literal["surrogate", "cma", "random"]
SEARCHES: tuple[SearchName, ...] = get_args(SearchName)
GENERATION = 8  # episodes that are asked for at once
_FINEST = 0.01  # of a coordinate: what is nearer to each other is taken for the same
_SILENT = -9


class Search(Protocol):
    """A search that requests episodes in generations."""

    def ask(self) -> np.ndarray:
        """(GENERATION, D) vectors of the next episodes."""
        ...

    def tell(self, vectors: np.ndarray, costs: np.ndarray) -> None:
        """Learn the costs (GENERATION,) of the requested vectors; the least is searched."""
        ...


class RandomSearch:
    """Vectors drawn uniformly."""

    def __init__(self, steps: np.ndarray, seed: int) -> None:
        self._dimensions, self._rng = len(steps), np.random.default_rng(seed)

    def ask(self) -> np.ndarray:
        """See `Search.ask`."""
        return self._rng.random((GENERATION, self._dimensions))

    def tell(self, vectors: np.ndarray, costs: np.ndarray) -> None:
        """See `Search.tell`; nothing is learnt."""


class EvolutionSearch:
    """CMA-ES (Hansen 2016, "The CMA Evolution Strategy: A Tutorial"), by the package cma.

    It begins with a generation drawn uniformly, around the best of which it continues, and begins
    again when it has converged.
    """

    def __init__(self, steps: np.ndarray, seed: int) -> None:
        self._dimensions = len(steps)
        # one coordinate alone is less than cma takes: a second one has no meaning
        self._steps = np.resize(steps, max(len(steps), 2))
        self._rng = np.random.default_rng(seed)
        self._strategy: Any = None

    def ask(self) -> np.ndarray:
        """See `Search.ask`."""
        if self._strategy is None:
            self._asked = list(self._rng.random((GENERATION, len(self._steps))))
        else:
            self._asked = self._strategy.ask()
        return np.array(self._asked)[:, : self._dimensions]

    def tell(self, vectors: np.ndarray, costs: np.ndarray) -> None:
        """See `Search.tell`."""
        if self._strategy is None:
            self._strategy = self._around(self._asked[int(costs.argmin())])
            return
        self._strategy.tell(self._asked, costs.tolist())
        if self._strategy.stop():
            self._strategy = None

    def _around(self, vector: np.ndarray) -> Any:
        import cma  # noqa: PLC0415 - takes seconds

        options = {
            "CMA_stds": self._steps,
            "popsize": GENERATION,
            "randn": lambda *shape: self._rng.standard_normal(shape),
            "seed": np.nan,  # leaves numpy's global generator alone
            "tolx": _FINEST,
            "verbose": _SILENT,
        }
        return cma.CMAEvolutionStrategy(vector, 1.0, options)


def new_search(name: Literal["cma", "random"], steps: np.ndarray, seed: int) -> Search:
    """A search from its beginning without a model; see `agent.falsification.surrogate`.

    Args:
        name: how it chooses.
        steps: (D,) first standard deviation of each coordinate.
        seed: of the search.
    """
    return {"cma": EvolutionSearch, "random": RandomSearch}[name](steps, seed)

"""A search with a cheap model first: episodes on observed moves (`agent.moves.foresight`).

In an ideal world the start decides most of an episode. So starts are simulated in the order of what
the model expects of them, the worst first, and those that came near once come again.
"""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from agent.falsification.ranges import START, RangeError, Space
from agent.falsification.search import GENERATION, Sought
from agent.mdp.greedy import GreedyPolicy, PolicyError
from agent.mdp.rng import seeded_state
from agent.moves.foresight import foresee
from agent.moves.model import MoveModel, build_model
from agent.moves.observe import cached_moves
from agent.training.policy import Policy
from cosim.base.progress import Progress, silent
from cosim.model.scenario import Cell

_POOL = 4096  # vectors drawn at once, of which the first one from every start is kept
_NEAREST = 16  # starts that come again
_REPEATS = 64  # episodes of the model from a start


@dataclass(frozen=True)
class _Visited:
    """Starts that were simulated.

    Attributes:
        vector: with which they came first.
        costs: of their episodes.
    """

    vector: np.ndarray
    costs: list[float] = field(default_factory=list)

    def mean(self) -> float:
        """Of the costs."""
        return float(np.mean(self.costs))


class SurrogateSearch:
    """Half of a generation has new starts, the worst first; the other half has the nearest again.

    These are the `_NEAREST` starts with the least mean cost so far, in turn. Whatever else is
    chosen is drawn uniformly.
    """

    def __init__(
        self, space: Space, policy: Policy, model: MoveModel, objective: Sought, seed: int
    ) -> None:
        self._space, self._policy, self._model = space, policy, model
        self._objective: Sought = objective
        self._seed, self._rng = seed, np.random.default_rng(seed)
        self._of_starts = [name.startswith(START) for name in space.coordinates]
        self._waiting: list[np.ndarray] = []
        self._visited: dict[tuple[Cell, ...], _Visited] = {}

    def ask(self) -> np.ndarray:
        """See `agent.falsification.search.Search.ask`."""
        nearest = sorted(self._visited.values(), key=_Visited.mean)[:_NEAREST]
        again = sorted(nearest, key=lambda visited: len(visited.costs))[: GENERATION // 2]
        drawn = self._rng.random((len(again), len(self._of_starts)))
        asked = [
            np.where(self._of_starts, visited.vector, fresh)
            for visited, fresh in zip(again, drawn, strict=True)
        ]
        while len(asked) < GENERATION:
            self._waiting = self._waiting or self._pool()
            asked.append(self._waiting.pop(0))
        return np.array(asked)

    def tell(self, vectors: np.ndarray, costs: np.ndarray) -> None:
        """See `agent.falsification.search.Search.tell`."""
        for vector, cost in zip(vectors, costs.tolist(), strict=True):
            starts = self._space.point(vector).starts
            self._visited.setdefault(starts, _Visited(vector)).costs.append(cost)

    def _pool(self) -> list[np.ndarray]:
        """Vectors from different starts, the worst one first."""
        by_starts: dict[tuple[Cell, ...], np.ndarray] = {}
        for vector in self._rng.random((_POOL, len(self._of_starts))):
            by_starts.setdefault(self._space.point(vector).starts, vector)
        gaps, seconds = foresee(
            self._policy.process,
            self._model,
            self._policy.values,
            np.array(list(by_starts)),
            _REPEATS,
            seeded_state(self._seed),
        )
        order = np.argsort(gaps if self._objective == "gap" else -seconds, kind="stable")
        vectors = list(by_starts.values())
        return [vectors[k] for k in order.tolist()]


def surrogate_search(
    space: Space,
    policy: GreedyPolicy,
    fmu: Path,
    objective: Sought,
    seed: int,
    progress: Progress = silent,
) -> SurrogateSearch:
    """A search with a model of moves observed under the configuration of a space.

    Args:
        space: to choose from.
        policy: policy of the episodes that are searched.
        fmu: motor FMU file.
        objective: the smallest gap, or the longest time.
        seed: of the search.
        progress: receives what is observed.

    Raises:
        PolicyError: the policy has no tables.
        RangeError: there is one start only.
        MovesError, FmuError: see `agent.moves.observe.observe_moves`.
    """
    if not isinstance(policy, Policy):
        raise PolicyError("--search surrogate needs a policy with tables; choose --search cma")
    if not any(name.startswith(START) for name in space.coordinates):
        raise RangeError(
            "--search surrogate orders starts, and there is only one; choose --search cma"
        )
    moves = cached_moves(space.config, fmu, progress)
    scenario = space.scenario
    model = build_model(moves, scenario.robot_diameter_m / scenario.cell_m)
    return SurrogateSearch(space, policy, model, objective, seed)

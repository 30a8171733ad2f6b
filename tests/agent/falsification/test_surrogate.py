"""The search that asks a model: bad starts first, and those that came near again."""

import numpy as np
import pytest

from agent.falsification.ranges import RangeError, Space
from agent.falsification.search import GENERATION
from agent.falsification.surrogate import SurrogateSearch, surrogate_search
from agent.mdp.config import ProcessConfig
from agent.mdp.rng import seeded_state
from agent.moves.foresight import foresee
from agent.moves.model import build_model
from agent.training.policy import Policy, PolicyConfig, Seed
from agent.training.settings import LearningConfig
from agent.training.store import train_policy
from cosim.model.config import CoSimConfig
from cosim.model.scenario import Scenario
from tests.agent.moves.test_moves import ideal_moves

pytestmark = pytest.mark.long  # it searches

# Robots that swap sides.
SWAP = Scenario(
    "swap",
    "",
    targets=((3, 10), (17, 10)),
    starts=(
        tuple((x, y) for x in (12, 14, 16) for y in (6, 8, 10, 12, 14)),
        tuple((x, y) for x in (4, 6, 8) for y in (6, 8, 10, 12, 14)),
    ),
    columns=20,
    rows=20,
    zone=(0, 0, 0, 0),
)
MODEL = build_model(ideal_moves(duration_s=7.0, turn_s=3.0, drift=0.1, stop=0.05), 5.0)


@pytest.fixture(scope="module")
def policy() -> Policy:
    config = PolicyConfig(SWAP, ProcessConfig(), LearningConfig(episodes=20_000), Seed(0))
    return train_policy(config)[0]


def new(policy: Policy, seed: int = 0, **ranges) -> SurrogateSearch:
    return SurrogateSearch(Space(SWAP, CoSimConfig(), ranges), policy, MODEL, "gap", seed)


def starts_of(vectors: np.ndarray) -> np.ndarray:
    space = Space(SWAP, CoSimConfig(), {})
    return np.array([space.point(vector).starts for vector in vectors])


@pytest.mark.slow
def test_starts_of_which_the_model_expects_the_worst_come_first(policy):
    asked = starts_of(new(policy).ask())
    assert len({tuple(start.ravel()) for start in asked}) == GENERATION
    everything = np.array([[a, b] for a in SWAP.starts[0] for b in SWAP.starts[1]])
    process, values = policy.process, policy.values
    first, _ = foresee(process, MODEL, values, asked, 64, seeded_state(1))
    of_all, _ = foresee(process, MODEL, values, everything, 64, seeded_state(2))
    assert first.mean() <= np.quantile(of_all, 0.1) < 0.5 * of_all.mean()


def test_half_of_a_generation_has_the_nearest_starts_again_with_other_noise(policy):
    search = new(policy)
    first = search.ask()
    costs = np.array([5.0, 1.0, 7.0, 2.0, 6.0, 4.0, 8.0, 3.0])
    search.tell(first, costs)
    second = search.ask()
    again, others = starts_of(second[: GENERATION // 2]), starts_of(second[GENERATION // 2 :])
    assert np.array_equal(again, starts_of(first[costs.argsort()][: GENERATION // 2]))
    assert not (
        second[: GENERATION // 2, 2:] == first[costs.argsort()][: GENERATION // 2, 2:]
    ).any()
    known = {tuple(start.ravel()) for start in starts_of(first)}
    assert known.isdisjoint(tuple(start.ravel()) for start in others)
    search.tell(second, np.zeros(GENERATION))
    third = starts_of(search.ask()[: GENERATION // 2])  # in turn: those that came once
    assert np.array_equal(third, others)


@pytest.mark.long
def test_a_search_is_asked_the_same_again(policy):
    asked = [new(policy, seed).ask() for seed in (0, 0, 1)]
    assert np.array_equal(asked[0], asked[1])
    assert not np.array_equal(asked[0], asked[2])


def test_what_has_no_order_is_refused(policy, array_fmu):
    space = Space(SWAP, CoSimConfig(), {"start": (0.0, 0.0)})
    with pytest.raises(RangeError, match=r"starts.* only one; choose --search"):
        surrogate_search(space, policy, array_fmu, "gap", 0)

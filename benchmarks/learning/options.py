"""Options of the benchmarks of this folder."""

from dataclasses import dataclass

from benchmarks.options import Benchmark


@dataclass(frozen=True, kw_only=True)
class Envs(Benchmark):
    """Time the environments of many boards on the grid, PettingZoo's of one, and the dynamics.

    With random actions, on one core.
    """

    scenario: str = "2"
    """Scenario, of any number of robots."""
    boards: int = 4096
    """Boards that are stepped together."""
    repeats: int = 10
    """Rounds of both, in turn; the best of each counts."""


@dataclass(frozen=True, kw_only=True)
class MovesLearning(Benchmark):
    """Train on observed moves with several variants and play the greedy policies on them."""

    episodes: int = 1_500_000
    """Training episodes of each variant."""
    test_episodes: int = 50_000
    """Greedy episodes of each variant."""
    scenario: str = "4"
    """Scenario of two robots or more."""
    variants: tuple[str, ...] = ()
    """Variants to train, by default all."""


@dataclass(frozen=True, kw_only=True)
class Training(Benchmark):
    """Time the training of scenario 4 over Section V's 5 000 000 episodes."""

    repeats: int = 3
    """Timed trainings of each kind; the fastest counts."""
    all: bool = False
    """Also time 20 runs of each of the five scenarios on all cores (a few minutes)."""

"""Compare features, learning rates and costs of failure on moves observed in co-simulation.

Trains scenario 4 on the observed moves with each variant and plays the greedy policy on the same
moves: fast enough for tens of thousands of episodes, but no substitute for `cosim.evaluate`.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import binomtest

from agent.mdp.config import Feature, ProcessConfig
from agent.mdp.readings import build_process
from agent.method import method_config
from agent.training.learning import (
    EPISODES,
    PATH_CELLS,
    SUCCESSES,
    TrainingState,
    build_learning,
    initial_state,
)
from agent.training.loop import move_model
from agent.training.moves_qlearning import advance_moves
from agent.training.policy import PolicyConfig
from agent.training.settings import LearningConfig
from cosim.model.scenario_file import find_scenario
from minirobots.options import CommandOptions, Count

PAPER: tuple[Feature, ...] = ("x", "y", "d", "g")
WITH_BEARING: tuple[Feature, ...] = (*PAPER, "b")
VARIANTS: dict[str, tuple[tuple[Feature, ...], float, float]] = {
    "paper's features, η 0.01, L 100": (PAPER, 0.01, 100.0),
    "paper's features, η 0.03, L 300": (PAPER, 0.03, 300.0),
    "with bearing, η 0.01, L 100": (WITH_BEARING, 0.01, 100.0),
    "with bearing, η 0.03, L 100": (WITH_BEARING, 0.03, 100.0),
    "with bearing, η 0.03, L 300": (WITH_BEARING, 0.03, 300.0),
    "with bearing and heading, η 0.03, L 300": ((*WITH_BEARING, "h"), 0.03, 300.0),
}
CONFIDENCE = 0.95


@dataclass(frozen=True, kw_only=True)
class Options(CommandOptions):
    """Train on observed moves with several variants and play the greedy policies on them."""

    episodes: Count = 1_500_000
    """Training episodes of each variant."""
    test_episodes: Count = 50_000
    """Greedy episodes of each variant."""
    scenario: str = "4"
    """Scenario of two robots or more."""
    variants: tuple[str, ...] = ()
    """Variants to train, by default all."""


def play(config: PolicyConfig, trained: TrainingState, episodes: int) -> np.ndarray:
    """Curve sums (see `TrainingState`) of greedy episodes on the moves, with nothing learnt."""
    learning = LearningConfig(
        episodes=episodes, epsilon=0.0, log_episodes=episodes, log_window=episodes
    )
    process, model = build_process(config.scenario, config.process), move_model(config)
    assert model is not None
    state = initial_state(process, learning, 1)
    state.q[:] = trained.q
    still = build_learning(learning)
    still.eta[:] = 0.0
    advance_moves(process, model, still, state, episodes)
    return state.curve[0]


def measure(
    episodes: int, test_episodes: int, scenario: str, variants: Sequence[str]
) -> dict[str, Any]:
    """One row per variant."""
    base = method_config("moves", find_scenario(scenario))
    rows: list[dict[str, Any]] = []
    for name in variants or VARIANTS:
        features, eta, goal_reward = VARIANTS[name]
        config = PolicyConfig(
            base.scenario,
            ProcessConfig(features=features, goal_reward=goal_reward),
            LearningConfig(episodes=episodes, eta=eta),
            base.seed,
            base.moves,
        )
        process, model = build_process(config.scenario, config.process), move_model(config)
        assert model is not None
        state = initial_state(process, config.learning, 0)
        advance_moves(process, model, build_learning(config.learning), state, episodes)
        curve = play(config, state, test_episodes)
        failed = round(curve[EPISODES] - curve[SUCCESSES])
        interval = binomtest(failed, test_episodes).proportion_ci(CONFIDENCE, "wilson")
        rows.append(
            {
                "variant": name,
                "failure": failed / test_episodes,
                "failure_low": float(interval.low),
                "failure_high": float(interval.high),
                "path_length_cells": float(curve[PATH_CELLS] / max(curve[SUCCESSES], 1.0)),
            }
        )
    return {"variants": rows}

"""Compare features, learning rates and costs of failure on moves observed in co-simulation.

Trains scenario 4 on the observed moves with each variant and plays the greedy policy on the same
moves: fast enough for tens of thousands of episodes, but no substitute for `cosim.evaluate`.
"""

from typing import Any

import numpy as np
from msgspec.structs import replace

from agent.evaluation.statistics import rate
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


class Options(CommandOptions):
    episodes: Count = 1_500_000
    """Training episodes of each variant."""
    test_episodes: Count = 50_000
    """Greedy episodes of each variant."""
    scenario: str = "4"
    """Scenario of two robots or more."""
    variants: tuple[str, ...] = ()
    """Variants to train, by default all."""


def learn(config: PolicyConfig, seed: int, trained: TrainingState | None = None) -> TrainingState:
    """Train on the moves, or play what is trained with nothing learnt."""
    process, model = build_process(config.scenario, config.process), move_model(config)
    assert model is not None
    state, learning = initial_state(process, config.learning, seed), build_learning(config.learning)
    if trained is not None:
        state.q[:] = trained.q
        learning.eta[:] = 0.0
    advance_moves(process, model, learning, state, config.learning.episodes)
    return state


def failures(curve: np.ndarray) -> dict[str, float]:
    """Share of greedy episodes that fail, with its interval, and mean path of the others."""
    failed = round(curve[EPISODES] - curve[SUCCESSES])
    share, low, high = rate(failed, round(curve[EPISODES]))
    path = float(curve[PATH_CELLS] / max(curve[SUCCESSES], 1.0))
    names = ("failure", "failure_low", "failure_high", "path_length_cells")
    return dict(zip(names, (share, low, high, path), strict=True))


def measure(options: Options) -> dict[str, Any]:
    base = method_config("moves", find_scenario(options.scenario))
    rows: list[dict[str, Any]] = []
    for name in options.variants or VARIANTS:
        features, eta, goal_reward = VARIANTS[name]
        config = replace(
            base,
            process=ProcessConfig(features=features, goal_reward=goal_reward),
            learning=LearningConfig(episodes=options.episodes, eta=eta),
        )
        count = options.test_episodes
        greedy = {"epsilon": 0.0, "log_episodes": count, "log_window": count}
        test = replace(config, learning=LearningConfig(episodes=count, **greedy))
        curve = learn(test, 1, learn(config, 0)).curve[0]
        rows.append({"variant": name, **failures(curve)})
    return {"variants": rows}

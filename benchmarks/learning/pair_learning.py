"""Compare how a pair explores and what its values begin at, on moves observed in co-simulation.

Trains the method `pair` with each variant and plays the greedy policy on the same moves: fast
enough for tens of thousands of episodes, but no substitute for `cosim.evaluate`.
"""

import time
from dataclasses import replace
from typing import Any

import msgspec
import numpy as np

from agent.mdp.readings import build_process
from agent.method import method_config
from agent.moves.pair import GRAIN_S, PairTimes, moves_of_pair, solve_pair
from agent.training.learning import RETURNS, build_learning
from agent.training.loop import fresh_state, move_model
from agent.training.pair_learning import advance_pair, first_delay, kept_delay, of_both
from agent.training.policy import PolicyConfig
from benchmarks.learning.moves_learning import failures
from cosim.model.scenario_file import find_scenario
from minirobots.options import CommandOptions, Count, Seed

VARIANTS = (
    "one robot explores",
    "both robots explore",
    "no robot explores",
    "values begin at the times alone",
    "values begin at 0",
    "values begin at those of fastest",
)


class Options(CommandOptions):
    episodes: Count = 400_000
    """Training episodes of each variant."""
    test_episodes: Count = 20_000
    """Greedy episodes of each variant."""
    scenario: str = "4"
    """Scenario of two robots."""
    seed: Seed = 0
    variants: tuple[str, ...] = VARIANTS
    """Variants to train, by default all."""


def first_values(config: PolicyConfig, times: PairTimes, variant: str) -> np.ndarray | None:
    """Return the delays that a variant begins with; None if they are the method's own."""
    if variant.endswith("fastest"):
        assert config.moves is not None
        return solve_pair(build_process(config.scenario, config.process), config.moves).delay
    known = np.where(np.isfinite(times.alone), times.alone, 0.0)
    scale = {VARIANTS[3]: 0.0, VARIANTS[4]: -1.0 / GRAIN_S}.get(variant)
    return None if scale is None else of_both(scale * known)


def measure(options: Options) -> dict[str, Any]:
    episodes, test_episodes = options.episodes, options.test_episodes
    scenario = find_scenario(options.scenario)
    base = method_config("pair", scenario, options.seed, episodes=episodes)
    process, model = build_process(base.scenario, base.process), move_model(base)
    assert model is not None
    assert base.moves is not None
    times, rows = moves_of_pair(process, base.moves), []
    for variant in options.variants:
        config = base
        if variant == VARIANTS[2]:
            config = msgspec.structs.replace(base, learning=replace(base.learning, epsilon=0.0))
        state, first = fresh_state(config), first_values(config, times, variant)
        unseen = None if first is not None else of_both(first_delay(process, times))
        if first is not None:
            state.q[:] = first
        began, explorers = time.perf_counter(), 2 if variant == VARIANTS[1] else 1
        learning = build_learning(config.learning)
        advance_pair(process, model, learning, times, state, episodes, explorers, unseen)
        seconds = time.perf_counter() - began
        window = {"log_episodes": test_episodes, "log_window": test_episodes}
        play = replace(config.learning, episodes=test_episodes, epsilon=0.0, **window)
        test = fresh_state(msgspec.structs.replace(config, learning=play))
        test.q[:] = kept_delay(state.q)
        test.visits[:] = 1 << 31  # the learning rate is as good as 0
        still = build_learning(play)
        still.eta[:] = 0.0
        advance_pair(process, model, still, times, test, test_episodes)
        mean_s = float(-test.curve[0, RETURNS:].sum() / 2.0 / test_episodes)
        row = {"variant": variant, "training_s": seconds, **failures(test.curve[0])}
        rows.append(row | {"mean_time_s": mean_s})
    return {"variants": rows}

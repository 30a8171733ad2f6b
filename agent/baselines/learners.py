"""The learners of the table, by name: what each is trained with, for how long, and its training.

Tables are those of `agent.method`, and `double_q` is `paper` with double Q-learning; networks are
those of `agent.deep`, which stop at the first exact evaluation in which they succeed from every
start.
"""

import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from agent.baselines import NETWORKS, Learner
from agent.deep.learning_grid import SHAPING
from agent.deep.policy import NetworkConfig
from agent.mdp.exact import Milestone
from agent.mdp.greedy import GreedyPolicy
from agent.method import method_config, method_policy
from agent.training.loop import TrainingProgress, fresh_state, run_training
from agent.training.pair_policy import trained_policy
from agent.training.policy import PolicyConfig, Seed
from agent.training.settings import COMPUTED
from cosim.base.progress import Progress
from cosim.base.provenance import digest_of
from cosim.base.reached_code import code_digest
from cosim.model.scenario import Scenario

# Moves of all robots after which a network is given up, by the number of robots.
NETWORK_STEPS = {1: 300_000, 2: 800_000, 4: 1_000_000}
QUICK_EPISODES, QUICK_STEPS = 100_000, 60_000

Config = PolicyConfig | NetworkConfig


def config_of(
    learner: Learner, scenario: Scenario, seed: int, quick: bool, progress: Progress
) -> Config:
    """Return what a learner is trained with.

    Args:
        learner: by name.
        scenario: board, starts and targets.
        seed: of training.
        quick: whether the budget is only to see that it works.
        progress: receives what is calibrated and observed.

    Raises:
        UserError: see `agent.method.method_config`.
    """
    if learner in NETWORKS:
        steps = NETWORK_STEPS.get(scenario.robots, max(NETWORK_STEPS.values()))
        if quick:
            steps = QUICK_STEPS
        return NetworkConfig(scenario, SHAPING[learner].process, learner, steps, Seed(seed))
    method = "paper" if learner == "double_q" else learner
    episodes = QUICK_EPISODES if quick and learner not in COMPUTED else None
    config = method_config(method, scenario, seed, episodes=episodes, progress=progress)
    if learner != "double_q":
        return config
    return PolicyConfig(
        scenario, config.process, replace(config.learning, algorithm=learner), config.seed
    )


def digest(config: Config) -> str:
    """Hash (16 hex digits) of everything that decides what training gives."""
    if isinstance(config, PolicyConfig):
        return digest_of(config)
    return digest_of(config, code_digest("agent.deep.learners"))


def train(config: Config, progress: Progress, watch: Callable[[Milestone], None]) -> GreedyPolicy:
    """Train, or compute, a policy.

    Args:
        config: what it is trained with.
        progress: receives reports.
        watch: receives every evaluation on the grid; none if it is computed.

    Raises:
        UserError: the scenario is too large to compute optimal paths.
    """
    if isinstance(config, NetworkConfig):
        from agent.deep import learners  # noqa: PLC0415 - needs the extra deep

        return learners.train(config, progress, watch, enough=1.0)
    if config.objective is not None:
        return method_policy(config.objective, config.scenario, progress=progress)[0]
    state = fresh_state(config)
    began, known = time.perf_counter(), 0

    def chunk(now: TrainingProgress) -> None:
        nonlocal known
        success = state.greedy[np.isfinite(state.greedy[:, 0]), 0]
        if len(success) > known:
            known = len(success)
            seconds = time.perf_counter() - began
            watch(Milestone(state.agent_steps, seconds, float(success[-1])))
        progress("training", now.episode, now.episodes, f"success {now.success:.1%}")

    run_training(config, state, progress=chunk)
    return trained_policy(config, state)

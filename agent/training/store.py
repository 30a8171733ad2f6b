"""Policies found again: train or compute once per configuration, keep policy and learning curves.

Only the cache; one run is `agent.training.loop`, many runs with checkpoints are `agent.train`.
"""

import logging
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from agent.mdp.greedy import GreedyPolicy, PolicyError
from agent.mdp.optimum import computed_tables
from agent.mdp.readings import build_process
from agent.moves.bound import fastest_tables
from agent.training.group_policy import GroupPolicy
from agent.training.loop import (
    ProgressCallback,
    TrainingLog,
    TrainingLogError,
    fresh_state,
    run_training,
    training_log,
)
from agent.training.pair_policy import PairPolicy, of_pair, trained_policy
from agent.training.policy import Policy, PolicyConfig
from cosim.base.provenance import digest_of
from cosim.base.storage import cache_dir, cached, load_or_create, require_no_folder

Trained = Any  # a `Policy`, of a pair that learns together a `PairPolicy`
POLICY_FILE = "policy.npz"
LOG_FILE = "training.npz"


_LOGGER = logging.getLogger(__name__)


def config_digest(config: PolicyConfig) -> str:
    """Hash (16 hex digits) of everything that decides a policy's bits."""
    return digest_of(config)


def policy_folder(config: PolicyConfig) -> Path:
    """Return where the cache keeps the policy of a configuration."""
    return cache_dir("policies") / f"{config.scenario.name}-{config_digest(config)}"


def train_policy(
    config: PolicyConfig, *, progress: ProgressCallback | None = None
) -> tuple[Trained, TrainingLog]:
    """Train from nothing, without looking at or writing any file."""
    state = fresh_state(config)
    run_training(config, state, progress=progress)
    log = training_log(config.learning, state, config.scenario.cell_m)
    return trained_policy(config, state), log


def save_run(folder: Path, policy: GreedyPolicy, log: TrainingLog) -> Path:
    """Write learning curves and policy; the policy comes last, so that it marks a whole run."""
    log.save(folder / LOG_FILE)
    policy.save(folder / POLICY_FILE)
    return folder / POLICY_FILE


def load_run(folder: Path, config: PolicyConfig) -> tuple[Trained, TrainingLog] | None:
    """Policy and learning curves of a configuration; None if they are missing or damaged."""
    path = folder / POLICY_FILE  # written last
    if not path.exists():
        return None
    try:
        policy = policy_kind(config).load(path)
        log = TrainingLog.load(folder / LOG_FILE)
    except (PolicyError, TrainingLogError) as error:
        _LOGGER.warning("%s: it is rebuilt", error)
        return None
    return (policy, log) if policy.config == config else None


def find_or_train(
    config: PolicyConfig, *, again: bool = False, progress: ProgressCallback | None = None
) -> tuple[Trained, TrainingLog, Path]:
    """The policy of a configuration: found in the cache, or trained and kept there.

    Args:
        config: everything that decides the policy's bits.
        again: train even if the policy is there.
        progress: called after every chunk of training; not at all if the policy is found.

    Returns:
        The policy, its learning curves and the path of its file.

    Raises:
        ScenarioError: the scenario cannot be used with these readings.
        StorageError: a folder is where a file of the cache goes.
        OSError: the cache cannot be written.
    """
    folder = policy_folder(config)
    for name in (POLICY_FILE, LOG_FILE):
        require_no_folder(folder / name)  # before training, not after

    def train() -> tuple[Trained, TrainingLog]:
        trained = train_policy(config, progress=progress)
        save_run(folder, *trained)
        return trained

    found = train() if again else load_or_create(folder, lambda: load_run(folder, config), train)
    return *found, folder / POLICY_FILE


def find_or_compute(
    config: PolicyConfig, *, again: bool = False
) -> tuple[Policy | PairPolicy | GroupPolicy, Path]:
    """The policy of a configuration with an objective: found in the cache, or computed and kept.

    Args:
        config: everything that decides the policy's bits.
        again: compute even if the policy is there.

    Returns:
        The policy and the path of its file.

    Raises:
        UserError: the scenario is too large to compute optimal paths.
        StorageError: a folder is where a file of the cache goes.
        OSError: the cache cannot be written.
    """
    path = policy_folder(config) / POLICY_FILE
    make = partial(_computed, config)
    return cached(path, policy_kind(config).load, make, GreedyPolicy.save, again=again), path


def policy_kind(config: PolicyConfig) -> type[Policy | PairPolicy | GroupPolicy]:
    """Return the class of the policy of a configuration."""
    if config.objective == "planned":
        return GroupPolicy
    return PairPolicy if of_pair(config) else Policy


def _computed(config: PolicyConfig) -> Policy | PairPolicy | GroupPolicy:
    assert config.objective is not None
    if config.objective == "planned":
        return GroupPolicy.computed(config)
    if of_pair(config):
        return PairPolicy.computed(config)
    process = build_process(config.scenario, config.process)
    if config.moves is None:
        tables, decided = computed_tables(process, config.objective)
    else:
        tables, decided = fastest_tables(process, config.moves)
    unused = np.zeros(1, dtype=np.uint64)
    return Policy(config, tables[None], decided.astype(np.uint32), unused, episodes=0)

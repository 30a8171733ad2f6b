"""Policies found again: train or compute once per configuration, keep policy and learning curves.

Only the cache; one run is `agent.training.loop`, many runs are `agent.training.runs`.
"""

import logging
from functools import partial
from pathlib import Path

from agent.mdp.greedy import GreedyPolicy
from agent.training.group_policy import GroupPolicy
from agent.training.loop import ProgressCallback, TrainingLog, run_training, training_log
from agent.training.pair_policy import PairPolicy
from agent.training.policy import Policy, PolicyConfig
from cosim.base.errors import FileError
from cosim.base.provenance import digest_of
from cosim.base.storage import cache_dir, cached, load_or_create, require_no_folder

POLICY_FILE = "policy.npz"
LOG_FILE = "training.npz"

_LOGGER = logging.getLogger(__name__)


def policy_folder(config: PolicyConfig) -> Path:
    """Return where the cache keeps the policy of a configuration."""
    return cache_dir("policies") / f"{config.scenario.name}-{digest_of(config)}"


def train_policy(
    config: PolicyConfig, *, progress: ProgressCallback | None = None
) -> tuple[Policy, TrainingLog]:
    """Train from nothing, without looking at or writing any file."""
    state = run_training(config, progress=progress)
    log = training_log(config.learning, state, config.scenario.cell_m)
    return Policy.of_training(config, state), log


def save_run(folder: Path, policy: GreedyPolicy, log: TrainingLog) -> Path:
    """Write learning curves and policy; the policy comes last, so that it marks a whole run."""
    log.save(folder / LOG_FILE)
    policy.save(folder / POLICY_FILE)
    return folder / POLICY_FILE


def load_run(folder: Path, config: PolicyConfig) -> tuple[Policy, TrainingLog] | None:
    """Policy and learning curves of a configuration; None if they are missing or damaged."""
    path = folder / POLICY_FILE  # written last
    if not path.exists():
        return None
    try:
        policy = Policy.load(path)
        log = TrainingLog.load(folder / LOG_FILE)
    except FileError as error:
        _LOGGER.warning("%s: it is rebuilt", error)
        return None
    return (policy, log) if policy.config == config else None


def find_or_train(
    config: PolicyConfig, *, again: bool = False, progress: ProgressCallback | None = None
) -> tuple[Policy, TrainingLog, Path]:
    """The policy of a configuration: found in the cache, or trained and kept there.

    Args:
        config: everything that decides the policy's bits.
        again: train even if the policy is there.
        progress: called after every chunk of training; not at all if the policy is found.

    Returns:
        The policy, its learning curves and the path of its file.

    Raises:
        UserError: the scenario cannot be used with these readings.
        FileError: a folder is where a file of the cache goes.
        OSError: the cache cannot be written.
    """
    folder = policy_folder(config)
    for name in (POLICY_FILE, LOG_FILE):
        require_no_folder(folder / name)  # before training, not after

    def train() -> tuple[Policy, TrainingLog]:
        trained = train_policy(config, progress=progress)
        save_run(folder, *trained)
        return trained

    found = load_or_create(folder, lambda: None if again else load_run(folder, config), train)
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
        FileError: a folder is where a file of the cache goes.
        OSError: the cache cannot be written.
    """
    path = policy_folder(config) / POLICY_FILE
    kind = policy_kind(config.objective, config.scenario.robots)
    made = cached(path, kind.load, partial(kind.computed, config), GreedyPolicy.save, again=again)
    return made, path


def policy_kind(objective: str | None, robots: int) -> type[Policy | PairPolicy | GroupPolicy]:
    """Return the class of the policies with an objective, or trained ones, of some robots."""
    if objective == "planned":
        return GroupPolicy
    return PairPolicy if objective == "fastest" and robots > 1 else Policy

"""Policies found again: made once per configuration, kept with their learning curves.

Only the cache; learning is `agent.training.loop`, many runs are `agent.training.runs`.
"""

import logging
from pathlib import Path
from typing import Any

from agent.mdp.greedy import GreedyPolicy
from agent.training.loop import TrainingLog, learn
from agent.training.methods import find_method
from agent.training.policy import Policy, PolicyConfig, load_policy
from cosim.base.errors import FileError
from cosim.base.progress import Progress, silent
from cosim.base.provenance import digest_of
from cosim.base.storage import cache_dir, cached, load_or_create, require_no_folder

POLICY_FILE = "policy.npz"
LOG_FILE = "training.npz"

_LOGGER = logging.getLogger(__name__)


def save_run(folder: Path, policy: GreedyPolicy, log: TrainingLog) -> None:
    """Write learning curves and policy; the policy comes last, so that it marks a whole run."""
    log.save(folder / LOG_FILE)
    policy.save(folder / POLICY_FILE)


def load_run(folder: Path) -> tuple[Any, TrainingLog] | None:
    """Policy and learning curves of a run; None if they are missing or damaged."""
    path = folder / POLICY_FILE  # written last
    if not path.exists():
        return None
    try:
        return load_policy(path), TrainingLog.load(folder / LOG_FILE)
    except FileError as error:
        _LOGGER.warning("%s: it is rebuilt", error)
        return None


def find_or_make(
    config: PolicyConfig, *, again: bool = False, progress: Progress = silent
) -> tuple[Any, Any, Path]:
    """The policy of a configuration: found in the cache, or learnt or computed and kept there.

    With `again` it is made even if it is there; `progress` receives the episodes trained.

    Returns:
        The policy, its `TrainingLog` (None if it was computed) and the path of its file.
    """
    folder = cache_dir("policies") / f"{config.scenario.name}-{digest_of(config)}"
    path, compute = folder / POLICY_FILE, find_method(config.method).compute
    if compute is not None:
        make = lambda: compute(config)  # noqa: E731
        return cached(path, load_policy, make, GreedyPolicy.save, again=again), None, path
    for name in (POLICY_FILE, LOG_FILE):
        require_no_folder(folder / name)  # before training, not after

    def train() -> tuple[Policy, TrainingLog]:
        trained = learn(config, progress)
        save_run(folder, *trained)
        return trained

    found = load_or_create(folder, lambda: None if again else load_run(folder), train)
    return *found, path

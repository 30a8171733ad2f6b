"""Policies found again: made once per configuration, kept with their learning curves.

Only the cache; learning is `agent.training.loop`, many runs are `agent.training.runs`.
"""

import logging
from functools import partial
from pathlib import Path
from typing import Any

from agent.mdp.greedy import GreedyPolicy
from agent.training.loop import TrainingLog, learn
from agent.training.methods import Method, find_method
from agent.training.policy import Policy, PolicyConfig, load_policy
from cosim.base.errors import FileError
from cosim.base.progress import Progress, silent
from cosim.base.provenance import digest_of
from cosim.base.storage import (
    cache_dir,
    cached,
    load_or_create,
    require_no_folder,
    write_whole,
)

POLICY_FILE = "policy.npz"
LOG_FILE = "training.npz"
_CHECKSUM = "run.sha256"  # of both, in the cache

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
    config: PolicyConfig,
    method: Method | None = None,
    *,
    again: bool = False,
    progress: Progress = silent,
) -> tuple[Any, Any, Any]:
    """The policy of a configuration: found in the cache, or learnt or computed and kept there.

    That of a user's method is always made: its code may be another one than before.

    Args:
        method: by default the one that has the name in the configuration.
        again: whether it is made even if it is there.
        progress: receives the episodes trained.

    Returns:
        The policy, its `TrainingLog` (None if it was computed) and the path of its file, if any.
    """
    method = method or find_method(config.method)
    folder = cache_dir("policies") / f"{config.scenario.name}-{digest_of(config)}"
    path, compute = folder / POLICY_FILE, method.compute
    if method.own:
        policy, log = (compute(config), None) if compute else learn(config, progress, method)
        return policy, log, None
    if compute is not None:

        def load(place: Path) -> Any:
            policy = load_policy(place)
            return policy if policy.config == config else None

        make = partial(compute, config)
        return cached(path, load, make, GreedyPolicy.save, again=again), None, path
    for name in (POLICY_FILE, LOG_FILE):
        require_no_folder(folder / name)  # before training, not after

    def find() -> tuple[Policy, TrainingLog] | None:
        found = None if again else load_run(folder)
        if found and (found[0].config != config or not _is_kept(folder)):
            _LOGGER.warning("%s is not of its configuration: rebuilding it", path)
            return None
        return found

    def train() -> tuple[Policy, TrainingLog]:
        trained = learn(config, progress)
        save_run(folder, *trained)
        write_whole(folder / _CHECKSUM, _checksum(folder))
        return trained

    return *load_or_create(folder, find, train), path


def _checksum(folder: Path) -> str:
    """Hash of both files of a run together, which finds one that is another run's."""
    return digest_of(folder / POLICY_FILE, folder / LOG_FILE)


def _is_kept(folder: Path) -> bool:
    try:
        return (folder / _CHECKSUM).read_text("utf-8") == _checksum(folder)
    except (OSError, ValueError):
        return False

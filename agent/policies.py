"""Policies by their files, of all methods, and by their names in the zoo."""

import json
from pathlib import Path

from agent.deep.policy import NetworkPolicy
from agent.mdp.greedy import GreedyPolicy
from agent.method import method_of
from agent.training.group_policy import GroupPolicy
from agent.training.pair_policy import PairPolicy
from agent.training.policy import FILE, Policy, PolicyConfig
from agent.training.store import policy_kind
from agent.zoo import PREFIX, zoo_policy
from cosim.base.progress import Progress, silent
from cosim.base.reading import parsing, read_arrays
from cosim.model.scenario import Scenario


def load_policy(
    path: Path | str, scenario: Scenario | None = None, progress: Progress = silent
) -> Policy | PairPolicy | GroupPolicy | NetworkPolicy:
    """Return the policy of a file or of the zoo; with `scenario`, only if it has that geometry.

    Args:
        path: file, or name of a policy of the zoo, such as zoo:4-pair.
        scenario: in which it must have been trained.
        progress: receives what is trained of the zoo.

    Raises:
        PolicyError: no such file, not a policy, another schema, or another scenario.
        ConfigError: no policy of the zoo has this name.
    """
    in_zoo, name = str(path).startswith(PREFIX), f"{path}: the policy"
    policy = zoo_policy(str(path), progress) if in_zoo else _of_file(Path(path))
    if scenario is not None and isinstance(policy, NetworkPolicy):
        return policy.in_scenario(scenario, name)
    if scenario is not None:
        policy.require_scenario(scenario, name)
    return policy


def _of_file(path: Path) -> Policy | PairPolicy | GroupPolicy | NetworkPolicy:
    arrays = read_arrays(path, FILE, ("config",))
    with parsing(path, FILE):
        config = dict(json.loads(arrays["config"].tobytes()))
        robots = len(config["scenario"]["targets"])
    if "network" not in config:
        return policy_kind(config.get("objective"), robots).load(path)
    return NetworkPolicy.load(path)


def method_name(policy: GreedyPolicy) -> str:
    """The method that a policy was trained by, or a network's algorithm; "other" if it is none."""
    if isinstance(policy, NetworkPolicy):
        return policy.config.algorithm
    return (
        method_of(policy.config) if isinstance(policy.config, PolicyConfig) else None
    ) or "other"

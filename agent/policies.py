"""Policies of all methods by their files."""

import json
from pathlib import Path

from agent.deep.policy import NetworkPolicy
from agent.mdp.greedy import GreedyPolicy
from agent.method import method_of
from agent.training.group_policy import GroupPolicy
from agent.training.pair_policy import PairPolicy
from agent.training.policy import FILE, Policy, PolicyConfig
from agent.training.settings import refuse_former
from cosim.base.reading import parsing, read_arrays
from cosim.model.scenario import Scenario


def load_policy(
    path: Path | str, scenario: Scenario | None = None
) -> Policy | PairPolicy | GroupPolicy | NetworkPolicy:
    """Return the policy of a file; with `scenario`, only if it has that geometry.

    Args:
        path: of the file.
        scenario: in which it must have been trained.

    Raises:
        PolicyError: no such file, not a policy, another schema, or another scenario.
    """
    name, policy = f"{path}: the policy", _of_file(Path(path))
    if scenario is not None and isinstance(policy, NetworkPolicy):
        return policy.in_scenario(scenario, name)
    if scenario is not None:
        policy.require_scenario(scenario, name)
    return policy


def _of_file(path: Path) -> Policy | PairPolicy | GroupPolicy | NetworkPolicy:
    arrays = read_arrays(path, FILE, ("config",))
    with parsing(path, FILE):
        config = dict(json.loads(arrays["config"].tobytes()))
        refuse_former(config.get("objective"), f"{path}: a policy by the method")
        pair = config.get("objective") == "fastest" and len(config["scenario"]["targets"]) > 1
        pair |= dict(config.get("learning", {})).get("algorithm") == "pair"
    if "network" not in config:
        planned = config.get("objective") == "planned"
        return (GroupPolicy if planned else PairPolicy if pair else Policy).load(path)
    return NetworkPolicy.load(path)


def method_name(policy: GreedyPolicy) -> str:
    """The method that a policy was trained by, or a network's algorithm; "other" if it is none."""
    if isinstance(policy, NetworkPolicy):
        return policy.config.algorithm
    return (
        method_of(policy.config) if isinstance(policy.config, PolicyConfig) else None
    ) or "other"

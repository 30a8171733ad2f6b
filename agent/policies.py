"""Policies of all methods by their files."""

from pathlib import Path

from agent.mdp.greedy import GreedyPolicy
from agent.method import method_of
from agent.training.group_policy import GroupPolicy
from agent.training.pair_policy import PairPolicy
from agent.training.policy import Policy, PolicyConfig, read_policy
from agent.training.store import policy_kind
from cosim.model.scenario import Scenario


def load_policy(
    path: Path | str, scenario: Scenario | None = None
) -> Policy | PairPolicy | GroupPolicy:
    """Return the policy of a file; with `scenario`, only if it has that geometry.

    Args:
        path: of the file.
        scenario: in which it must have been trained.

    Raises:
        UserError: no such file, not a policy, another schema, or another scenario.
    """
    config, *_ = read_policy(path, ())
    policy = policy_kind(config.objective, config.scenario.robots).load(path)
    if scenario is not None:
        policy.require_scenario(scenario, f"{path}: the policy")
    return policy


def method_name(policy: GreedyPolicy) -> str:
    """Return the method that a policy was trained by; "other" if it is none."""
    method = method_of(policy.config) if isinstance(policy.config, PolicyConfig) else None
    return method or "other"

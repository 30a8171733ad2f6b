"""Policies as studies take them: files, methods by name, and any object with `act` or `drive`."""

from collections.abc import Callable, Mapping
from dataclasses import fields, replace
from functools import cached_property, partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from agent.mdp.config import ProcessConfig
from agent.mdp.greedy import GreedyPolicy
from agent.mdp.interpretations import Process, build_process
from agent.training.methods import METHODS, Method, find_method, method_config
from agent.training.policy import load_policy
from agent.training.store import find_or_make
from cosim.base.arguments import ConfigError, imported, require_names, validate_argument
from cosim.base.errors import failure, shorten
from cosim.base.progress import Progress, silent
from cosim.base.provenance import digest_of, identity_of
from cosim.coupling.rl_step import SupportsAct
from cosim.model.scenario import Scenario
from cosim.simulation.driving import SupportsDrive, drives
from cosim.simulation.options import Physics

_PAPER = Physics()  # the paper's machine and motors
_OBJECT = "a class without arguments or of an object"


class ObjectPolicy:
    """Any object with `act` or `drive`, in a scenario, as a case takes it.

    What else the object has, such as `q_values`, is recorded. Its failures are UserErrors.
    """

    episodes = 0  # of training
    require_scenario = GreedyPolicy.require_scenario

    def __init__(self, policy: SupportsAct | SupportsDrive, scenario: Scenario) -> None:
        self.policy, self.config = policy, SimpleNamespace(scenario=scenario)

    @cached_property
    def process(self) -> Process:
        """The process in the scenario, for the starts; one feature will do, as it has no tables."""
        return build_process(self.config.scenario, ProcessConfig(features=("x",)))

    def _ask(self, name: str, method: Callable[[Any], Any], given: Any) -> Any:
        try:
            return method(given)
        except (Exception, SystemExit) as error:  # whatever a user's code does
            raise failure(f"{name} of policy {type(self.policy).__name__}", error) from error

    def digest(self) -> str | None:
        """Return what the object is known by, see `identity_of`; None if by nothing."""
        kind, known = type(self.policy), self._ask("digest", identity_of, self.policy)
        return None if known is None else digest_of(kind.__module__, kind.__qualname__, known)

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__") or name == "policy":
            raise AttributeError(name)
        found = getattr(self.policy, name)
        return partial(self._ask, name, found) if name in ("act", "drive") else found


def policy_of(
    given: Any,
    scenario: Scenario | None = None,
    *,
    seed: int = 0,
    options: Physics = _PAPER,
    progress: Progress = silent,
) -> Any:
    """Return the policy, such as a `GreedyPolicy`, that a user names.

    Args:
        given: policy, file, name of a method, dict of a `method` and of some of its settings
            `process` and `learning`, "module:Name" of an object or class, or an object with `act`
            or `drive`.
        scenario: in which it acts; a file has its own, and is refused in another one.
        seed, options: of a method, see `method_config`.
    """
    found = _named(given)
    if isinstance(found, GreedyPolicy | ObjectPolicy):
        if scenario is not None:
            found.require_scenario(scenario)
        return found
    if isinstance(found, Path):
        return load_policy(found, scenario)
    if scenario is None:
        raise ConfigError(
            f"policy = {shorten(given)} needs a scenario; name one (scenario, --scenario)"
        )
    if isinstance(found, Method):
        settings = _settings(given, found, scenario) if isinstance(given, Mapping) else {}
        how = {"options": options, "progress": progress, **settings}
        return find_or_make(method_config(found, scenario, seed, **how), found, progress=progress)[
            0
        ]
    drives(found)
    return ObjectPolicy(found, scenario)


def is_trained(given: Any) -> bool:
    """Return whether what a user names is a method that learns."""
    found = _named(given)
    return isinstance(found, Method) and found.compute is None


def _named(given: Any) -> Any:
    """Return the `Method`, the object or class, or the path of the file that a user names."""
    if isinstance(given, Mapping):
        require_names("policy: ", given, ("method", "process", "learning"))
        return find_method(given.get("method", ""))
    if not isinstance(given, str | Path):
        return given
    name = str(given)
    if name in METHODS:
        return METHODS[name]
    if ":" not in name or Path(name).exists():
        return Path(name)
    return imported("policy", name, _OBJECT)


def _settings(given: Mapping[str, Any], method: Method, scenario: Scenario) -> dict[str, Any]:
    """Return the settings of a method, of which a user gives some."""
    found = {}
    for name, usual in zip(("process", "learning"), method.settings(scenario), strict=True):
        table = validate_argument(f"policy: {name}", given.get(name, {}), dict)
        require_names(f"policy: {name}.", table, [field.name for field in fields(usual)])
        found[name] = replace(usual, **table)
    return found


def name_of(given: Any) -> str:
    """Return what a policy is called in tables."""
    if isinstance(given, str | Path):
        return str(given)
    if isinstance(given, Mapping):
        return str(given.get("method"))
    return getattr(given, "name", None) or type(given).__name__

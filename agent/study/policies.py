"""Policies as studies take them: files, methods by name, and any object with `act` or `drive`."""

from collections.abc import Callable
from functools import cached_property, partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from agent.mdp.config import ProcessConfig
from agent.mdp.greedy import GreedyPolicy
from agent.mdp.interpretations import Process, build_process
from agent.training.methods import METHODS, Method, imported, method_config
from agent.training.policy import load_policy
from agent.training.store import find_or_make
from cosim.base.arguments import ConfigError
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
        given: policy, file, name of a method, "module:Name" of an object or class, or an object
            with `act` or `drive`.
        scenario: in which it acts; a file has its own, and is refused in another one.
        seed, options: of a method, see `method_config`.
    """
    name = str(given) if isinstance(given, str | Path) else None
    if isinstance(given, GreedyPolicy | ObjectPolicy):
        if scenario is not None:
            given.require_scenario(scenario)
        return given
    file = name is not None and (":" not in name or Path(name).exists())
    if name is not None and name not in METHODS and file:
        return load_policy(name, scenario)
    if scenario is None:
        raise ConfigError(
            f"policy = {shorten(given)} needs a scenario; name one (scenario, --scenario)"
        )
    found: Any = given if name is None else METHODS.get(name) or imported("policy", name, _OBJECT)
    if isinstance(found, Method):
        config = method_config(found, scenario, seed, options=options, progress=progress)
        return find_or_make(config, found, progress=progress)[0]
    drives(found)
    return ObjectPolicy(found, scenario)


def name_of(given: Any) -> str:
    """Return what a policy is called in tables."""
    if isinstance(given, str | Path):
        return str(given)
    return getattr(given, "name", None) or type(given).__name__

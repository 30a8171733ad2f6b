"""Policies as studies take them: files, methods by name, and any object with `act` or `drive`."""

import uuid
from functools import cached_property, partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from agent.mdp.config import ProcessConfig
from agent.mdp.greedy import GreedyPolicy
from agent.mdp.interpretations import Process, build_process
from agent.training.methods import METHODS, Method, find_method, imported, method_config
from agent.training.policy import load_policy
from agent.training.store import find_or_make
from cosim.base.arguments import ConfigError
from cosim.base.errors import UserError, shorten
from cosim.base.progress import Progress, silent
from cosim.base.provenance import identity_of
from cosim.coupling.rl_step import SupportsAct
from cosim.model.preset import PAPER
from cosim.model.scenario import Scenario
from cosim.simulation.driving import SupportsDrive, drives


class ObjectPolicy:
    """Any object with `act` or `drive`, in a scenario, as a case takes it.

    Args:
        policy: the object; what else it has, such as `q_values`, is recorded.
            Its own failures are UserErrors that name it.
        scenario: in which it acts.
    """

    episodes = 0  # of training
    require_scenario = GreedyPolicy.require_scenario

    def __init__(self, policy: SupportsAct | SupportsDrive, scenario: Scenario) -> None:
        self.policy, self.config = policy, SimpleNamespace(scenario=scenario)
        self._digest = identity_of(policy)
        self.recognizable = self._digest is not None
        self._digest = self._digest or uuid.uuid4().hex

    @cached_property
    def process(self) -> Process:
        """The process in the scenario, for the starts; one feature will do, as it has no tables."""
        return build_process(self.config.scenario, ProcessConfig(features=("x",)))

    def _ask(self, method: str, seen: Any) -> Any:
        try:
            return getattr(self.policy, method)(seen)
        except (Exception, SystemExit) as error:  # whatever a user's code does
            name, said = type(self.policy).__name__, f"{type(error).__name__}: {error}"
            raise UserError(
                f"{method} of policy {name} failed ({' '.join(said.split())}); correct it"
            ) from error

    def digest(self) -> str:
        """Return what the object is known by; of an object without identity a number drawn."""
        return f"{self._digest}-{self.config.scenario.digest()}"

    def maps(self) -> list[Any]:
        """Return the object's maps of the cells of the board, if it has any."""
        return getattr(self.policy, "maps", list)()

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__") or name == "policy":
            raise AttributeError(name)
        found = getattr(self.policy, name)
        return partial(self._ask, name) if name in ("act", "drive") else found


def policy_of(
    given: Any,
    scenario: Scenario | None = None,
    *,
    seed: int = 0,
    preset: Any = PAPER,
    progress: Progress = silent,
) -> Any:
    """Return the policy, such as a `GreedyPolicy`, that a user names.

    Args:
        given: policy, file, name of a method, "module:Name" of an object or class, or an object
            with `act` or `drive`.
        scenario: in which it acts; a file has its own, and is refused in another one.
        seed: of training.
        preset: machine of the moves that a method uses.
        progress: receives what is trained.
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
    found: Any = given if name is None else METHODS.get(name) or _imported(name)
    if isinstance(found, Method):
        config = method_config(found, scenario, seed, preset=preset, progress=progress)
        return find_or_make(config, progress=progress)[0]
    drives(found)
    return ObjectPolicy(found, scenario)


def trained(
    method: str, board: Scenario, out: Path, seed: int, progress: Progress = silent
) -> GreedyPolicy:
    """Return the policy of a method for a board, which is kept in the folder of a study, too."""
    config = method_config(find_method(method), board, seed, progress=progress)
    policy, *_ = find_or_make(config, progress=progress)
    policy.save(out / "policies" / f"{board.name}-{method}.npz")
    return policy


def _imported(name: str) -> Any:
    """Return the object "module:Name", an instance where that is a class."""
    try:
        found = imported(name)
        return found() if isinstance(found, type) else found
    except (Exception, SystemExit) as error:  # whatever a user's module does
        raise ConfigError(
            f"policy = {name!r} cannot be imported ({error!r}); name MODULE:NAME of a class "
            "without arguments or of an object, in a module of this folder or an installed one"
        ) from error


def name_of(given: Any) -> str:
    """Return what a policy is called in tables."""
    if isinstance(given, str | Path):
        return str(given)
    return getattr(given, "name", None) or type(given).__name__

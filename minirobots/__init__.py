"""Vibration-driven mini-robots that learn to navigate: everything under one name.

>>> import minirobots as mr
>>> policy = mr.train("1a", method="shortest", progress=None)
>>> mr.simulate("1a", policy, record="summary", progress=None).outcome
'success'

Names are imported when they are asked for, so that `import minirobots` itself takes no time.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from agent import load, train
    from agent.study.user import evaluate, study
    from agent.training.policy import Policy
    from analysis import open  # noqa: A004 - to be called as minirobots.open
    from cosim import Episode, Scenario, UserError, World, simulate
    from cosim.system.env import SystemEnv, SystemVectorEnv

    __version__: str

__all__ = [
    "Episode",
    "Policy",
    "Scenario",
    "SystemEnv",
    "SystemVectorEnv",
    "UserError",
    "World",
    "__version__",
    "evaluate",
    "load",
    "open",
    "simulate",
    "study",
    "train",
]

_MODULES = {
    "Episode": "cosim",
    "Policy": "agent",
    "Scenario": "cosim",
    "SystemEnv": "cosim.system.env",
    "SystemVectorEnv": "cosim.system.env",
    "UserError": "cosim",
    "World": "cosim",
    "evaluate": "agent.study.user",
    "load": "agent",
    "open": "analysis",
    "simulate": "cosim",
    "study": "agent.study.user",
    "train": "agent",
}


def __getattr__(name: str) -> Any:
    if name == "__version__":
        return import_module("importlib.metadata").version("minirobots")
    if name in _MODULES:
        return getattr(import_module(_MODULES[name]), name)
    raise AttributeError(f"module 'minirobots' has no attribute '{name}'")


def __dir__() -> list[str]:
    return __all__

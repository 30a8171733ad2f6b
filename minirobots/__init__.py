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
    from agent import Policy, load, train
    from agent.study.user import evaluate, study
    from analysis import open  # noqa: A004 - to be called as minirobots.open
    from cosim import Episode, Scenario, UserError, World, simulate

    __version__: str

__all__ = [
    "Episode", "Policy", "Scenario", "UserError", "World", "__version__",
    "evaluate", "load", "open", "simulate", "study", "train",
]  # fmt: skip
_MODULES = {
    "agent": ("Policy", "load", "train"),
    "agent.study.user": ("evaluate", "study"),
    "analysis": ("open",),
    "cosim": ("Episode", "Scenario", "UserError", "World", "simulate"),
}


def __getattr__(name: str) -> Any:
    if name == "__version__":
        return import_module("importlib.metadata").version("minirobots")
    for module, names in _MODULES.items():
        if name in names:
            return getattr(import_module(module), name)
    raise AttributeError(f"module 'minirobots' has no attribute '{name}'")


def __dir__() -> list[str]:
    return __all__

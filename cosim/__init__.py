"""Co-simulation of motor FMUs and rigid bodies: episodes, parameters, scenarios.

Names are imported when they are asked for, so that `import cosim` itself takes no time.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from cosim.base import errors as _errors  # noqa: F401 - from now on Ctrl-C ends a command quietly

if TYPE_CHECKING:
    from cosim.base.arguments import ConfigError
    from cosim.base.config import CoSimConfig
    from cosim.base.errors import UserError
    from cosim.base.outcome import Outcome
    from cosim.base.world import Patch, Sensor, World
    from cosim.navigation.cosimulation import CoSimulation
    from cosim.navigation.features import Observation
    from cosim.navigation.step import Decision
    from cosim.presets.preset import Preset, find_preset
    from cosim.reading.episode import Episode
    from cosim.scenarios.file import find_scenario
    from cosim.scenarios.scenario import Scenario
    from cosim.simulation import simulate

__all__ = [
    "CoSimConfig",
    "CoSimulation",
    "ConfigError",
    "Decision",
    "Episode",
    "Observation",
    "Outcome",
    "Patch",
    "Preset",
    "Scenario",
    "Sensor",
    "UserError",
    "World",
    "find_preset",
    "find_scenario",
    "simulate",
]

_MODULES = {
    "CoSimConfig": "cosim.base.config",
    "CoSimulation": "cosim.navigation.cosimulation",
    "ConfigError": "cosim.base.arguments",
    "Decision": "cosim.navigation.step",
    "Episode": "cosim.reading.episode",
    "Observation": "cosim.navigation.features",
    "Outcome": "cosim.base.outcome",
    "Patch": "cosim.base.world",
    "Preset": "cosim.presets.preset",
    "Scenario": "cosim.scenarios.scenario",
    "Sensor": "cosim.base.world",
    "UserError": "cosim.base.errors",
    "World": "cosim.base.world",
    "find_preset": "cosim.presets.preset",
    "find_scenario": "cosim.scenarios.file",
    "simulate": "cosim.simulation",
}


def __getattr__(name: str) -> Any:
    if name in _MODULES:
        return getattr(import_module(_MODULES[name]), name)
    raise AttributeError(f"module 'cosim' has no attribute '{name}'")

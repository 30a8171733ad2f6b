"""Co-simulation of motor FMUs and rigid bodies: episodes, parameters, scenarios.

Names are imported when they are asked for, so that `import cosim` itself takes no time.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from cosim.base.arguments import ConfigError
    from cosim.base.errors import UserError
    from cosim.coupling.rl_step import Decision
    from cosim.model.config import CoSimConfig
    from cosim.model.outcome import Outcome
    from cosim.model.preset import Preset, find_preset
    from cosim.model.scenario import Scenario
    from cosim.model.scenario_file import find_scenario
    from cosim.model.world import Patch, Sensor, World
    from cosim.onboard.features import Observation
    from cosim.recording.reader import Episode
    from cosim.simulation.simulate import simulate

__all__ = [
    "CoSimConfig",
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
    "CoSimConfig": "cosim.model.config",
    "ConfigError": "cosim.base.arguments",
    "Decision": "cosim.coupling.rl_step",
    "Episode": "cosim.recording.reader",
    "Observation": "cosim.onboard.features",
    "Outcome": "cosim.model.outcome",
    "Patch": "cosim.model.world",
    "Preset": "cosim.model.preset",
    "Scenario": "cosim.model.scenario",
    "Sensor": "cosim.model.world",
    "UserError": "cosim.base.errors",
    "World": "cosim.model.world",
    "find_preset": "cosim.model.preset",
    "find_scenario": "cosim.model.scenario_file",
    "simulate": "cosim.simulation.simulate",
}


def __getattr__(name: str) -> Any:
    if name in _MODULES:
        return getattr(import_module(_MODULES[name]), name)
    raise AttributeError(f"module 'cosim' has no attribute '{name}'")

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
    "CoSimConfig", "ConfigError", "Decision", "Episode", "Observation", "Outcome", "Patch",
    "Preset", "Scenario", "Sensor", "UserError", "World", "find_preset", "find_scenario",
    "simulate",
]  # fmt: skip
_MODULES = {
    "base.arguments": ("ConfigError",),
    "base.errors": ("UserError",),
    "coupling.rl_step": ("Decision",),
    "model.config": ("CoSimConfig",),
    "model.outcome": ("Outcome",),
    "model.preset": ("Preset", "find_preset"),
    "model.scenario": ("Scenario",),
    "model.scenario_file": ("find_scenario",),
    "model.world": ("Patch", "Sensor", "World"),
    "onboard.features": ("Observation",),
    "recording.reader": ("Episode",),
    "simulation.simulate": ("simulate",),
}


def __getattr__(name: str) -> Any:
    for module, names in _MODULES.items():
        if name in names:
            return getattr(import_module(f"cosim.{module}"), name)
    raise AttributeError(f"module 'cosim' has no attribute '{name}'")

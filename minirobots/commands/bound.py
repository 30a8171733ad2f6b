"""The least path length and number of moves of any policy."""

from dataclasses import field, fields
from typing import Any

from agent.mdp.config import ProcessConfig
from cosim.base.errors import UserError
from cosim.base.progress import Progress
from minirobots.options import CommandOptions, ScenarioName

_OF_PATHS = ("target_obstacle", "collision")


class BoundOptions(CommandOptions):
    """Exact optimum of a scenario: the least mean path length and number of moves of any policy.

    Path length and moves are bounded separately, each by Dijkstra's algorithm over the joint
    process; a policy need not be able to reach both at once. Results are cached.
    """

    scenario: ScenarioName = "4"
    process: ProcessConfig = field(default_factory=ProcessConfig)
    """Interpretations of the paper; only target_obstacle and collision limit the paths."""

    def __post_init__(self) -> None:
        super().__post_init__()
        for reading in fields(self.process):
            given = getattr(self.process, reading.name)
            if reading.name not in _OF_PATHS and given != reading.default:
                option = reading.name.replace("_", "-")
                raise UserError(f"--process.{option} has no effect on the optimum; leave it out")


def run(options: BoundOptions, _: Progress) -> dict[str, Any]:
    """Find or compute the bound."""
    from agent.mdp.exact import enumerable, joint_starts
    from agent.mdp.optimum import optimum, require_paths
    from agent.mdp.readings import build_process
    from cosim.model.scenario_file import find_scenario

    scenario = find_scenario(options.scenario)
    process = build_process(scenario, options.process)
    bound = optimum(process)
    require_paths(process, bound.path_cells, alone=bound.relaxed)
    starts = joint_starts(process)
    path_cells, steps = (float(mean.mean()) for mean in bound.of_starts(starts, scenario.rows))
    return {
        "scenario": scenario.name,
        "starts": len(starts),
        "drawn": not enumerable(process),
        "relaxed": bound.relaxed,
        "path_length_cm": 100.0 * scenario.cell_m * path_cells,
        "steps": steps,
    }

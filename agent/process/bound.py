"""`python -m agent.process.bound`: the least path length and number of moves of any policy."""

from dataclasses import dataclass, field, fields

from agent.process.config import ProcessConfig
from cosim.base.command import Json, parse, print_json
from cosim.base.errors import UserError, run_command

_OF_PATHS = ("target_obstacle", "collision")


@dataclass(frozen=True, kw_only=True)
class BoundOptions:
    """Exact optimum of a scenario: the least mean path length and number of moves of any policy.

    Path length and moves are bounded separately, each by Dijkstra's algorithm over the joint
    process; a policy need not be able to reach both at once. Results are cached.
    """

    scenario: str = "4"
    """Built-in scenario (1a, 1b, 2, 3, 4 of Fig. 5, and 1a-zone to 4-zone, whose zone is forbidden;
    5-corridor, 5-slalom, 5-doorway; 4-cross, 4-ring, 6-swap) or a scenario file (.toml)."""
    json: Json = False
    process: ProcessConfig = field(default_factory=ProcessConfig)
    """Readings, of which target_obstacle and collision say where paths may go."""

    def __post_init__(self) -> None:
        for reading in fields(self.process):
            given = getattr(self.process, reading.name)
            if reading.name not in _OF_PATHS and given != reading.default:
                option = reading.name.replace("_", "-")
                raise UserError(f"--process.{option} has no effect on the optimum; leave it out")


def main() -> None:
    """Command line; see `BoundOptions`."""
    options = parse(BoundOptions, "agent.process.bound")
    from agent.process.exact import enumerable, joint_starts
    from agent.process.optimum import optimum, require_paths
    from agent.process.readings import build_process
    from cosim.scenarios.file import find_scenario

    scenario = find_scenario(options.scenario)
    process = build_process(scenario, options.process)
    bound = optimum(process)
    require_paths(process, bound)
    starts = joint_starts(process)
    path_cells, steps = (mean.mean() for mean in bound.of_starts(starts, scenario.rows))
    path_length_cm = 100.0 * scenario.cell_m * path_cells
    sampled = "" if enumerable(process) else " drawn"
    relaxed = ", relaxed" * bound.relaxed
    print(f"scenario {scenario.name}, {len(starts)}{sampled} starts{relaxed}")
    print(f"path length {path_length_cm:.2f} cm, moves {steps:.2f}")
    if options.json:
        print_json(
            {
                "scenario": scenario.name,
                "starts": len(starts),
                "relaxed": bound.relaxed,
                "path_length_cm": float(path_length_cm),
                "steps": float(steps),
            }
        )


if __name__ == "__main__":
    run_command(main)

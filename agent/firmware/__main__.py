"""`python -m agent.firmware`: a policy and its steering as C for a microcontroller."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro

from cosim.base.command import Json, parse, print_json
from cosim.base.config import ConfigError
from cosim.base.errors import run_command
from cosim.fmi.isolation import Isolation
from cosim.navigation.options import Driving

# Of episodes, without meaning for a robot.
_OF_EPISODES = ("on_collision", "time_limit")


@dataclass(frozen=True, kw_only=True)
class Firmware:
    """Write a policy, the steering and the motors' speed loops as C99 for a microcontroller.

    Without heap and C library; set points and actions are those of the co-simulation in every bit
    (docs/firmware.md says of what the arctangent may differ). Robots are told apart by -DROBOT=1, 2
    and so on. The sources are compiled for a Cortex-M4 to print what each robot needs.
    """

    policy: Annotated[Path, tyro.conf.arg(metavar="FILE")]
    """Policy that acts by tables (policy.npz)."""
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")]
    """Folder that receives the sources; made if missing."""
    json: Json = False
    physics: Annotated[Driving, tyro.conf.OmitArgPrefixes] = field(default_factory=Driving)
    isolation: Annotated[Isolation, tyro.conf.OmitArgPrefixes] = field(default_factory=Isolation)

    def __post_init__(self) -> None:
        for name in _OF_EPISODES:
            if getattr(self.physics, name) != getattr(Driving, name):
                option = name.replace("_", "-")
                raise ConfigError(f"--{option} has no effect on firmware; leave it out")


def main() -> None:
    """Command line; see `Firmware`."""
    options = parse(Firmware, "agent.firmware")
    options.isolation.enter("agent.firmware", options.physics.motor_fmu)
    from agent.firmware.build import measure, write_sources
    from agent.firmware.tables import load_table, render_constants
    from cosim.base.command import show_table
    from cosim.base.progress import progress_bars, under_way
    from cosim.scenarios.file import read_world

    policy = load_table(options.policy)
    scenario = policy.config.scenario
    world = {"world": read_world(options.physics.world)} if options.physics.world else {}
    with progress_bars() as progress:
        config, _ = options.physics.prepare(scenario.robot_diameter_m, progress, **world)
        files = write_sources(options.out, render_constants(policy, config))
        with under_way(progress, "compiling"):
            sizes = [measure(options.out, robot + 1) for robot in range(scenario.robots)]
    header = ("robot", "flash", "RAM", "stack, at most")
    rows = [(f"r{s.robot}", *(f"{n:,} B" for n in (s.flash, s.ram, s.stack))) for s in sizes]
    show_table(None, header, rows, title="on a Cortex-M4", numbers=3)
    print(f"sources in {options.out}/; docs/firmware.md says what to connect")
    if options.json:
        print_json({"files": list(map(str, files)), "sizes": sizes})


if __name__ == "__main__":
    run_command(main)

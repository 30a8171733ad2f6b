"""A policy and its steering as C for a microcontroller."""

from collections.abc import Iterator
from typing import Any

from cosim.base.progress import Progress, under_way
from cosim.model.config import ConfigError
from cosim.simulation.options import SimulationOptions, resolve
from minirobots.options import File, Folder, Simulating

# Of episodes, without meaning for a robot.
_OF_EPISODES = ("on_collision", "time_limit")


class Firmware(Simulating):
    """Write a policy, the steering and the motors' speed loops as C99 for a microcontroller.

    The code needs no heap and no C library. Set points and actions are those of the co-simulation
    in every bit, except for the arctangent (docs/firmware.md). Robots differ by -DROBOT=1, 2 and so
    on. The sources are compiled for a Cortex-M4 to print what each robot needs.
    """

    policy: File
    """Policy that acts by tables (policy.npz)."""
    out: Folder
    """Folder that receives the sources; made if missing."""

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in _OF_EPISODES:
            if getattr(self.physics, name) != getattr(SimulationOptions, name):
                option = name.replace("_", "-")
                raise ConfigError(f"--{option} has no effect on firmware; leave it out")
        if self.physics.shield:  # refused before it is measured
            raise ConfigError(
                "--shield needs to see all robots, and firmware sees none; leave it out"
            )


def run(options: Firmware, progress: Progress) -> Iterator[Any]:
    """Write the sources, compile them, and print what each robot needs."""
    from agent.firmware.build import measure, write_sources
    from agent.firmware.constants import load_table, render_constants
    from cosim.base.table import show_texts

    policy = load_table(options.policy)
    scenario = policy.config.scenario
    config = resolve(options.physics, scenario, progress).config
    files = write_sources(options.out, render_constants(policy, config))
    with under_way(progress, "compiling"):
        sizes = [measure(options.out, robot + 1) for robot in range(scenario.robots)]
    yield {"files": [str(file) for file in files], "sizes": sizes}
    header = ("robot", "flash", "RAM", "stack, at most")
    rows = [(f"r{s.robot}", *(f"{n:,} B" for n in (s.flash, s.ram, s.stack))) for s in sizes]
    show_texts(header, rows, title="on a Cortex-M4", numbers=3)
    print(f"sources in {options.out}/; docs/firmware.md says what to connect")

"""Move the 1-DOF platform of Eq. (1) and write the data of Fig. 3."""

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

import tyro

from cosim.base.errors import UserError
from cosim.base.progress import Progress
from cosim.model.preset import PAPER, find_preset
from minirobots.options import CommandOptions, File, Friction, PresetName, ending

MAX_CYCLES = 100


class MovePlatform(CommandOptions):
    """Move the 1-DOF platform of Eq. (1) and write its motion: the data of Fig. 3.

    Two platforms: one that looks like the printed figure, and the robot of Tables I and II, or of
    another machine. The result file also holds a table of net speeds over friction and motor speed.
    """

    out: Annotated[File, ending(".npz")] = Path("runs/platform.npz")
    """Result file (.npz)."""
    cycles: int = 6
    """Turns of the motor to show."""
    omega: Annotated[float, tyro.conf.arg(metavar="RAD_S")] = 900.0
    """Motor speed of the platform of Tables I and II, in rad/s."""
    preset: PresetName = PAPER
    mu: Friction = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 1 <= self.cycles <= MAX_CYCLES:
            raise UserError(f"--cycles {self.cycles}: choose 1 to {MAX_CYCLES}")


def run(options: MovePlatform, _: Progress) -> Iterator[Any]:
    """Move the platforms, write what they do, and print speeds and net displacements."""
    from cosim.machine.platform.result import move_platforms

    config = find_preset(options.preset).config().having("given", mu=options.mu)
    result = move_platforms(options.cycles, options.omega, config.robot, config.motor)
    result.save(options.out)
    table, motions = result.table, {"paper": result.paper, "table_ii": result.table_ii}
    names = ("mu", "omega_rad_s", "net_speed_m_s")
    steps = {f"{n}_net_displacement_m": float(m.net_displacement_m) for n, m in motions.items()}
    yield {f"table_{name}": getattr(table, name).tolist() for name in names} | steps
    print("net speed in mm/s (motor speed in rad/s)")
    print("    mu  omega_c omega_net" + "".join(f"{omega:8.0f}" for omega in table.omega_rad_s))
    for mu, (slip, drift), row in zip(
        table.mu, table.slip_and_drift_speed_rad_s, table.net_speed_m_s, strict=True
    ):
        speeds = "".join(f"{round(1e3 * v, 3) + 0.0:8.3f}" for v in row)
        print(f"{mu:6.2f} {slip:8.1f} {drift:9.1f}{speeds}")
    for name, motion in motions.items():
        step_um = 1e6 * motion.net_displacement_m
        print(f"{name}: {step_um:.2f} um per turn at {motion.omega_rad_s:g} rad/s")
    print(f"results: {options.out}")

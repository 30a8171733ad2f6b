"""`python -m cosim.platform`: move the 1-DOF platform of Eq. (1) and write the data of Fig. 3."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from cosim.base.command import Json, parse, print_json
from cosim.base.errors import UserError, run_command
from cosim.presets.preset import PAPER, find_preset

MAX_CYCLES = 100


@dataclass(frozen=True)
class MovePlatform:
    """Move the 1-DOF platform of Eq. (1) and write its motion: the data of Fig. 3.

    Two platforms: one that looks like the printed figure, and the robot of Tables I and II, or of
    another machine. The result file also holds a table of net speeds over friction and motor speed.
    """

    out: Annotated[Path, tyro.conf.arg(metavar="FILE")] = Path("runs/platform.npz")
    """Result file (.npz)."""
    cycles: int = 6
    """Turns of the motor to show."""
    omega: Annotated[float, tyro.conf.arg(metavar="RAD_S")] = 900.0
    """Motor speed of the platform of Tables I and II, in rad/s."""
    preset: Annotated[str, tyro.conf.arg(metavar="NAME|FILE")] = PAPER
    """Machine of that platform and of the table: paper, icra2006, thesis, or a file (.toml)."""
    mu: float | None = None
    """Friction coefficient of that platform; by default the preset's, 0.15 for the paper."""
    json: Json = False

    def __post_init__(self) -> None:
        if not 1 <= self.cycles <= MAX_CYCLES:
            raise UserError(f"--cycles {self.cycles}: choose 1 to {MAX_CYCLES}")
        if self.mu is not None and self.mu <= 0.0:
            raise UserError(f"--mu {self.mu:g}: choose a friction coefficient above 0")


def main() -> None:
    """Command line; see `MovePlatform`."""
    options = parse(MovePlatform, "cosim.platform")
    from cosim.platform.result import move_platforms

    preset = find_preset(options.preset)
    robot = preset.robot if options.mu is None else preset.robot._replace(mu=options.mu)
    result = move_platforms(options.cycles, options.omega, robot, preset.motor)
    result.save(options.out)
    table = result.table
    print("net speed in mm/s (motor speed in rad/s)")
    print("    mu  omega_c omega_net" + "".join(f"{omega:8.0f}" for omega in table.omega_rad_s))
    for mu, (slip, drift), row in zip(
        table.mu, table.slip_and_drift_speed_rad_s, table.net_speed_m_s, strict=True
    ):
        speeds = "".join(f"{round(1e3 * v, 3) + 0.0:8.3f}" for v in row)
        print(f"{mu:6.2f} {slip:8.1f} {drift:9.1f}{speeds}")
    steps = {}
    for name, motion in (("paper", result.paper), ("table_ii", result.table_ii)):
        steps[f"{name}_net_displacement_m"] = step_m = float(motion.net_displacement_m)
        print(f"{name}: {1e6 * step_m:.2f} um per turn at {motion.omega_rad_s:g} rad/s")
    print(f"results: {options.out}")
    if options.json:
        names = ("mu", "omega_rad_s", "net_speed_m_s")
        rows = {f"table_{name}": getattr(table, name).tolist() for name in names}
        print_json(rows | steps)


if __name__ == "__main__":
    run_command(main)

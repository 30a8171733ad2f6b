"""`python -m analysis.motor_loop`: draw the Bode plots of the motor's speed loop."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro

from cosim.base.command import Json, MotorFmuFile, parse, print_json
from cosim.base.errors import run_command
from cosim.fmi.isolation import Isolation


@dataclass(frozen=True)
class MotorLoop:
    """Draw the Bode plots of the motor's speed loop and print its poles, bandwidth and margins.

    python-control computes them from the transfer functions; the FMU's own frequency response,
    measured without Coulomb friction and weight, is drawn with them. A table compares how the
    FMU's speed comes up to 700 rad/s with other integral gains, and without anti-windup.
    """

    out: Annotated[Path, tyro.conf.arg(metavar="FILE")] = Path("figures/motor_loop.png")
    """Figure to write; PNG and PDF are written beside each other."""
    motor_fmu: MotorFmuFile = None
    json: Json = False
    isolation: Annotated[Isolation, tyro.conf.OmitArgPrefixes] = field(default_factory=Isolation)


def main() -> None:
    """Command line; see `MotorLoop`."""
    options = parse(MotorLoop, "analysis.motor_loop")
    options.isolation.enter("analysis.motor_loop", options.motor_fmu)
    import numpy as np
    from rich.console import Console
    from rich.table import Table

    from analysis.figures.style import NOTHING, save, use_style
    from analysis.motor.gains import compare_gains
    from analysis.motor.speed_loop import draw, figures_of_merit, measured_response, speed_loop
    from cosim.base.config import CoSimConfig
    from cosim.base.params import motor_time_constant
    from cosim.base.progress import progress_bars
    from cosim.coupling.fmu import MotorFmu
    from cosim.coupling.parameters import with_motor
    from fmus.build import cached_fmu

    use_style()
    fmu = options.motor_fmu or cached_fmu("VibrationMotor")
    config = with_motor(CoSimConfig(), fmu)
    config.require_known("the loop", "K_T", "R", "J", "b", "K_p", "K_i")
    loop = speed_loop(config.motor)
    merit = figures_of_merit(loop)
    frequencies = np.logspace(0.5, 3.5, 10)
    motor = MotorFmu(fmu)
    with progress_bars() as progress:
        measured = measured_response(fmu, frequencies, progress)
    poles = ", ".join(f"{pole:.4g}" for pole in merit.poles_rad_s)
    print(f"motor alone: pole {-1.0 / motor_time_constant(config.motor):.4g} rad/s")
    print(f"closed loop: poles {poles} rad/s, bandwidth {merit.bandwidth_rad_s:.4g} rad/s")
    print(
        f"margins: gain {merit.gain_margin:g}, phase {merit.phase_margin_deg:.1f}° "
        f"at {merit.crossover_rad_s:.4g} rad/s"
    )
    with progress_bars() as progress:
        compared = compare_gains(motor, progress)
    table = Table("K_i", "anti-windup", "63 %", "90 %", "98 %", "within ±2 %", "overshoot")
    for gains in compared:
        *times, overshoot = gains.rise
        table.add_row(
            f"{gains.K_i:.3f}",
            "yes" if gains.anti_windup else "no",
            *(NOTHING if time_s is None else f"{time_s:.3f} s" for time_s in times),
            f"{100.0 * overshoot:.1f} %",
        )
    Console().print(table)
    files = [str(path) for path in save(draw(loop, frequencies, measured), options.out)]
    print(f"figure: {', '.join(files)}")
    if options.json:
        response = {
            "frequency_rad_s": frequencies.tolist(),
            "fmu_magnitude": np.abs(measured).tolist(),
            "fmu_phase_rad": np.angle(measured).tolist(),
        }
        gains = [row._asdict() | {"rise": row.rise._asdict()} for row in compared]
        print_json(merit._asdict() | response | {"gains": gains, "files": files})


if __name__ == "__main__":
    run_command(main)

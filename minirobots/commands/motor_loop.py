"""Draw the Bode plots of the motor's speed loop, with its poles and margins."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from cosim.base.command import MotorFmuFile
from cosim.base.progress import Progress
from minirobots.options import File, IsolatedOptions


class MotorLoop(IsolatedOptions):
    """Draw the Bode plots of the motor's speed loop and print its poles, bandwidth and margins.

    python-control computes them from the transfer functions; the FMU's own frequency response,
    measured without Coulomb friction and weight, is drawn with them. A table compares how the
    FMU's speed comes up to 700 rad/s with other integral gains, and without anti-windup.
    """

    out: File = Path("figures/motor_loop.png")
    """Figure to write; PNG and PDF are written next to each other."""
    motor_fmu: MotorFmuFile = None


def run(options: MotorLoop, progress: Progress) -> Iterator[Any]:
    """Compute, measure and draw the loop, and print poles, margins and the table of gains."""
    import numpy as np
    from rich.console import Console
    from rich.table import Table

    from analysis.figures.style import NOTHING, save, use_style
    from analysis.motor.gains import compare_gains
    from analysis.motor.speed_loop import draw, figures_of_merit, measured_response, speed_loop
    from cosim.coupling.fmu import MotorFmu
    from cosim.coupling.parameters import with_motor
    from cosim.model.config import CoSimConfig
    from cosim.model.params import motor_time_constant
    from fmus.build import cached_fmu

    use_style()
    fmu = options.motor_fmu or cached_fmu("VibrationMotor")
    config = with_motor(CoSimConfig(), fmu)
    config.require_known("the loop", "K_T", "R", "J", "b", "K_p", "K_i")
    loop = speed_loop(config.motor)
    frequencies = np.logspace(0.5, 3.5, 10)
    measured = measured_response(fmu, frequencies, progress)
    gains = compare_gains(MotorFmu(fmu), progress)
    found = figures_of_merit(loop)._asdict() | {
        "motor_pole_rad_s": -1.0 / motor_time_constant(config.motor),
        "frequency_rad_s": frequencies.tolist(),
        "fmu_magnitude": np.abs(measured).tolist(),
        "fmu_phase_rad": np.angle(measured).tolist(),
        "gains": [row._asdict() | {"rise": row.rise._asdict()} for row in gains],
        "files": [str(path) for path in save(draw(loop, frequencies, measured), options.out)],
    }
    yield found
    poles = ", ".join(f"{pole:.4g}" for pole in found["poles_rad_s"])
    print(f"motor alone: pole {found['motor_pole_rad_s']:.4g} rad/s")
    print(f"closed loop: poles {poles} rad/s, bandwidth {found['bandwidth_rad_s']:.4g} rad/s")
    print(
        f"margins: gain {found['gain_margin']:g}, phase {found['phase_margin_deg']:.1f}° "
        f"at {found['crossover_rad_s']:.4g} rad/s"
    )
    table = Table("K_i", "anti-windup", "63 %", "90 %", "98 %", "within ±2 %", "overshoot")
    for gains in found["gains"]:
        *times, overshoot = gains["rise"].values()
        table.add_row(
            f"{gains['K_i']:.3f}",
            "yes" if gains["anti_windup"] else "no",
            *(NOTHING if time_s is None else f"{time_s:.3f} s" for time_s in times),
            f"{100.0 * overshoot:.1f} %",
        )
    Console().print(table)
    print(f"figure: {', '.join(found['files'])}")

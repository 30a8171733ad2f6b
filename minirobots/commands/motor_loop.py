"""Draw the Bode plots of the motor's speed loop, with its poles and margins."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from cosim.base.command import MotorFmuFile
from cosim.base.progress import Progress
from minirobots.options import File, IsolatedOptions

if TYPE_CHECKING:
    import numpy as np

    from analysis.motor.gains import Gains
    from analysis.motor.speed_loop import LoopMerit


@dataclass(frozen=True, kw_only=True)
class MotorLoop(IsolatedOptions):
    """Draw the Bode plots of the motor's speed loop and print its poles, bandwidth and margins.

    python-control computes them from the transfer functions; the FMU's own frequency response,
    measured without Coulomb friction and weight, is drawn with them. A table compares how the
    FMU's speed comes up to 700 rad/s with other integral gains, and without anti-windup.
    """

    out: File = Path("figures/motor_loop.png")
    """Figure to write; PNG and PDF are written beside each other."""
    motor_fmu: MotorFmuFile = None


class MeasuredLoop(NamedTuple):
    """The speed loop, computed and measured.

    Attributes:
        pole_rad_s: of the motor without its loop.
        merit: of the closed loop.
        frequency_rad_s, response: of the FMU, complex.
        gains: what other integral gains would do.
        files: of the figure.
    """

    pole_rad_s: float
    merit: "LoopMerit"
    frequency_rad_s: "np.ndarray"
    response: "np.ndarray"
    gains: "list[Gains]"
    files: list[str]


def run(options: MotorLoop, progress: Progress) -> MeasuredLoop:
    """Compute, measure and draw the loop."""
    import numpy as np

    from analysis.figures.style import save, use_style
    from analysis.motor.gains import compare_gains
    from analysis.motor.speed_loop import draw, figures_of_merit, measured_response, speed_loop
    from cosim.base.config import CoSimConfig
    from cosim.base.params import motor_time_constant
    from cosim.coupling.fmu import MotorFmu
    from cosim.coupling.parameters import with_motor
    from fmus.build import cached_fmu

    use_style()
    fmu = options.motor_fmu or cached_fmu("VibrationMotor")
    config = with_motor(CoSimConfig(), fmu)
    config.require_known("the loop", "K_T", "R", "J", "b", "K_p", "K_i")
    loop = speed_loop(config.motor)
    frequencies = np.logspace(0.5, 3.5, 10)
    motor = MotorFmu(fmu)
    measured = measured_response(fmu, frequencies, progress)
    gains = compare_gains(motor, progress)
    files = [str(path) for path in save(draw(loop, frequencies, measured), options.out)]
    pole_rad_s = -1.0 / motor_time_constant(config.motor)
    return MeasuredLoop(pole_rad_s, figures_of_merit(loop), frequencies, measured, gains, files)


def show(_: MotorLoop, found: MeasuredLoop) -> dict[str, Any]:
    """Print poles, margins and the table of gains."""
    import numpy as np
    from rich.console import Console
    from rich.table import Table

    from analysis.figures.style import NOTHING

    merit = found.merit
    poles = ", ".join(f"{pole:.4g}" for pole in merit.poles_rad_s)
    print(f"motor alone: pole {found.pole_rad_s:.4g} rad/s")
    print(f"closed loop: poles {poles} rad/s, bandwidth {merit.bandwidth_rad_s:.4g} rad/s")
    print(
        f"margins: gain {merit.gain_margin:g}, phase {merit.phase_margin_deg:.1f}° "
        f"at {merit.crossover_rad_s:.4g} rad/s"
    )
    table = Table("K_i", "anti-windup", "63 %", "90 %", "98 %", "within ±2 %", "overshoot")
    for gains in found.gains:
        *times, overshoot = gains.rise
        table.add_row(
            f"{gains.K_i:.3f}",
            "yes" if gains.anti_windup else "no",
            *(NOTHING if time_s is None else f"{time_s:.3f} s" for time_s in times),
            f"{100.0 * overshoot:.1f} %",
        )
    Console().print(table)
    print(f"figure: {', '.join(found.files)}")
    return merit._asdict() | {
        "frequency_rad_s": found.frequency_rad_s.tolist(),
        "fmu_magnitude": np.abs(found.response).tolist(),
        "fmu_phase_rad": np.angle(found.response).tolist(),
        "gains": [row._asdict() | {"rise": row.rise._asdict()} for row in found.gains],
        "files": found.files,
    }

"""Draw the motor's speed loop, with its poles and margins, and propose gains for it."""

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

import tyro

from cosim.base.arguments import validate_unique
from cosim.base.command import MotorFmuFile, MotorParameters
from cosim.base.progress import Progress
from minirobots.options import File, IsolatedOptions, Positive


class MotorLoop(IsolatedOptions):
    """Draw the motor's speed loop, print its poles, bandwidth and margins, and propose gains.

    python-control computes them from the transfer functions; the FMU's own frequency response,
    measured without Coulomb friction and weight, is drawn with them. The proposed gains cancel the
    motor's pole (K_i = K_p/τ); K_p is as large as the voltage of a step from rest and a phase
    margin of 60° with a delay of 1 ms allow. A table compares how the FMU's speed comes up to the
    set point with its own and other gains, and without anti-windup.
    """

    out: File = Path("figures/motor_loop.png")
    """Figure to write; PNG and PDF are written next to each other."""
    motor_fmu: MotorFmuFile = None
    motor_parameters: MotorParameters = ()
    """Parameter of the motor FMU to set through FMI, in the FMU's unit, such as J=5e-9; repeat it
    for several. By default the FMU's own values hold."""
    omega_des: Annotated[Positive | None, tyro.conf.arg(metavar="RAD_S")] = None
    """Set point of the step in rad/s, for which the gains are proposed; by default 700, or 80 % of
    what the motor reaches, if that is less."""


def run(options: MotorLoop, progress: Progress) -> Iterator[Any]:
    """Compute, measure and draw the loop, and print poles, margins, gains and their responses."""
    import numpy as np
    from rich.console import Console
    from rich.table import Table

    from analysis.figures.style import NOTHING, save, use_style
    from analysis.motor import speed_loop as theory
    from analysis.motor.instance import GivenMotor
    from analysis.motor.steps import compare_gains, draw
    from cosim.fmi.motor import MotorFmu
    from cosim.model.params import motor_time_constant
    from fmus.build import cached_fmu

    use_style()
    fmu = MotorFmu(options.motor_fmu or cached_fmu("VibrationMotor"))
    at_hand = GivenMotor.of(fmu, validate_unique("motor_parameters", options.motor_parameters))
    motor = at_hand.params
    omega_des = theory.step_speed(motor, options.omega_des)
    proposed, limit = theory.propose(motor, omega_des)
    loop = theory.speed_loop(motor)
    frequencies = theory.frequencies_of(loop)
    measured = theory.measured_response(at_hand, frequencies, progress)
    steps = compare_gains(at_hand, proposed, omega_des, progress)
    merits = [theory.figures_of_merit(each) for each in (loop, theory.speed_loop(proposed))]
    figure = draw(motor, proposed, frequencies, measured, steps, omega_des)
    yield merits[0].record() | {
        "motor_pole_rad_s": -1.0 / motor_time_constant(motor),
        "motor": motor._asdict(),
        "proposed": {"K_p": proposed.K_p, "K_i": proposed.K_i, "limited_by": limit}
        | merits[1].record(),
        "frequency_rad_s": frequencies.tolist(),
        "fmu_magnitude": np.abs(measured).tolist(),
        "fmu_phase_rad": np.angle(measured).tolist(),
        "omega_des": omega_des,
        "gains": [step.record() for step in steps],
        "files": (files := [str(path) for path in save(figure, options.out)]),
    }
    print(f"motor alone: pole {-1.0 / motor_time_constant(motor):.4g} rad/s")
    print(f"closed loop, {_said(motor, merits[0])}")
    print(f"proposed, limited by the {limit}, {_said(proposed, merits[1])}")
    table = Table(
        "K_p", "K_i", "anti-\nwindup", "63 %", "90 %", "98 %", "within\n±2 %", "over-\nshoot",
        title=f"step to {omega_des:g} rad/s",
    )  # fmt: skip
    for step in steps:
        *times, overshoot = step.rise
        table.add_row(
            f"{step.K_p:.3g}",
            f"{step.K_i:.3g}",
            "FMU's" if step.anti_windup else "no",
            *(NOTHING if time_s is None else f"{time_s:.3f} s" for time_s in times),
            f"{100.0 * max(overshoot, 0.0):.1f} %",
        )
    Console().print(table)
    print(f"figure: {', '.join(files)}")


def _said(motor: Any, merit: Any) -> str:
    """Return gains, poles, bandwidth and margins as text."""
    poles = ", ".join(
        f"{p.real:.4g} ± {p.imag:.4g}j" if p.imag else f"{p.real:.4g}"
        for p in merit.poles_rad_s
        if p.imag >= 0.0
    )
    phase = "infinite"
    if merit.crossover_rad_s > 0.0:
        late = f"{merit.delayed_phase_margin_deg:.1f}° with a delay of 1 ms"
        phase = f"{merit.phase_margin_deg:.1f}° at {merit.crossover_rad_s:.4g} rad/s, {late}"
    return (
        f"K_p = {motor.K_p:.4g} V s/rad, K_i = {motor.K_i:.4g} V/rad: poles {poles} rad/s, "
        f"bandwidth {merit.bandwidth_rad_s:.4g} rad/s, gain margin {merit.gain_margin:g}, "
        f"phase margin {phase}"
    )

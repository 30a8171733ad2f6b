"""The motor's speed loop as control theory sees it, and the FMU's own.

Plant and PI controller as transfer functions from the same parameters as the FMU: poles, bandwidth,
margins and a Bode plot, in which the FMU's own measured frequency response stands next to the
curves. Without Coulomb friction, weight and saturation the two must agree; with them see
`analysis.figures.fig07`.
"""

from pathlib import Path
from typing import Any, NamedTuple

import control
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure

from analysis.figures.style import WIDTH_IN
from analysis.motor.instance import running
from cosim.base.plotting import BLUE, GREY, VERMILION
from cosim.base.progress import Progress, silent
from cosim.coupling.fmu import MotorFmu
from cosim.model.params import TABLE_II, MotorParams, motor_gain, motor_time_constant

# A sine in steps: holding each value takes 4e-5 off its amplitude, and half a step of time. The
# steps themselves, sampled at their ends, look like the sine: they must be too fast for the loop.
LEAST_SAMPLES_PER_PERIOD = 200
LEAST_SAMPLING_RAD_S = 5e3
PERIODS = 2
# Small enough to keep the voltage of the loop within its limits at every frequency.
AMPLITUDE_RAD_S = 50.0
RK4 = 2
# The fast pole's share of the start has gone after this many of its time constants.
SETTLING = 12.0


class Loop(NamedTuple):
    """Transfer functions of the speed loop, rad/s and V.

    Attributes:
        plant: from voltage to speed.
        controller: from speed error to voltage, Eq. (14).
        open: controller and plant in series.
        closed: from set point to speed.
        disturbance: from disturbance torque to speed, in the closed loop.
    """

    plant: Any
    controller: Any
    open: Any
    closed: Any
    disturbance: Any


def speed_loop(motor: MotorParams = TABLE_II) -> Loop:
    """Eq. (13) without Coulomb friction and weight, and Eq. (14) without saturation."""
    gain, tau = motor_gain(motor), motor_time_constant(motor)
    plant: Any = control.tf([gain], [tau, 1.0])
    controller: Any = control.tf([motor.K_p, motor.K_i], [1.0, 0.0])
    torque_to_volts = motor.R / motor.K_T
    return Loop(
        plant,
        controller,
        control.series(controller, plant),
        control.feedback(control.series(controller, plant)),
        control.feedback(plant, controller) * torque_to_volts,
    )


class LoopMerit(NamedTuple):
    """Figures of merit of the speed loop.

    Attributes:
        poles_rad_s: of the closed loop, slowest first.
        bandwidth_rad_s: of the closed loop, -3 dB.
        open_bandwidth_rad_s: of the motor alone.
        gain_margin: factor; infinite for a loop of first order with an integrator.
        phase_margin_deg: at the gain crossover.
        crossover_rad_s: gain crossover.
    """

    poles_rad_s: tuple[float, ...]
    bandwidth_rad_s: float
    open_bandwidth_rad_s: float
    gain_margin: float
    phase_margin_deg: float
    crossover_rad_s: float


def figures_of_merit(loop: Loop) -> LoopMerit:
    """Poles, bandwidth and margins."""
    gain_margin, phase_margin, _, crossover = control.margin(loop.open)
    poles = tuple(sorted((float(p.real) for p in control.poles(loop.closed)), reverse=True))
    return LoopMerit(
        poles,
        float(control.bandwidth(loop.closed)),
        float(control.bandwidth(loop.plant)),
        float(gain_margin),
        float(phase_margin),
        float(crossover),
    )


def measured_response(
    fmu: Path, frequencies_rad_s: np.ndarray, progress: Progress = silent
) -> np.ndarray:
    """Frequency response of the FMU's closed loop from set point to speed, complex (n,).

    Without Coulomb friction and weight, each frequency on its own: a sine of the set point, held
    between communication points, and a least-squares fit of a sine to the speed, next to what is
    left of the slow pole's answer to the start.

    Args:
        fmu: of the motor.
        frequencies_rad_s: angular frequencies (n,).
        progress: receives every frequency.

    Raises:
        FmuError: the FMU cannot be used.
    """
    motor, measured = MotorFmu(fmu), []
    for frequency_rad_s in frequencies_rad_s:
        progress("measuring the FMU", len(measured), len(frequencies_rad_s))
        measured.append(_measure(motor, frequency_rad_s))
    progress("measuring the FMU", len(measured), len(measured))
    return np.array(measured)


def _measure(motor: MotorFmu, frequency_rad_s: float) -> complex:
    period_s = 2.0 * np.pi / frequency_rad_s
    needed = int(np.ceil(LEAST_SAMPLING_RAD_S / frequency_rad_s))
    samples = max(LEAST_SAMPLES_PER_PERIOD, needed)
    step_s = period_s / samples
    slow, fast = figures_of_merit(speed_loop()).poles_rad_s
    settling = int(np.ceil(-SETTLING / fast / period_s)) * samples
    count = settling + PERIODS * samples
    # Half a step early: a held value acts on average half a step late.
    set_point = AMPLITUDE_RAD_S * np.sin(frequency_rad_s * step_s * (np.arange(count) + 0.5))
    speed = np.empty(count)
    with running(motor, c=0.0, m=0.0, solver=RK4) as (fmu, reference):
        for tick in range(count):
            fmu.setFloat64([reference["omega_des"]], [set_point[tick]])
            fmu.doStep(tick * step_s, step_s)
            (speed[tick],) = fmu.getFloat64([reference["omega"]])
    time_s = step_s * np.arange(settling + 1, count + 1)
    angle = frequency_rad_s * time_s
    shapes = np.column_stack([np.sin(angle), np.cos(angle), np.exp(slow * time_s)])
    in_phase, quadrature, _ = np.linalg.lstsq(shapes, speed[settling:], rcond=None)[0]
    return complex(in_phase, quadrature) / AMPLITUDE_RAD_S


def draw(loop: Loop, frequencies_rad_s: np.ndarray, measured: np.ndarray) -> Figure:
    """Bode plots of the open and the closed loop, with the FMU's response in the latter."""
    merit = figures_of_merit(loop)
    omega = np.logspace(-1, 4, 400)
    figure, grid = plt.subplots(2, 2, figsize=(WIDTH_IN, 4.4), sharex=True)
    columns = (("open loop L = C G", loop.open, BLUE), ("closed loop T", loop.closed, BLUE))
    for (magnitude, phase), (title, system, colour) in zip(grid.T, columns, strict=True):
        response = system(1j * omega)
        magnitude.semilogx(omega, 20.0 * np.log10(np.abs(response)), color=colour, label="theory")
        phase.semilogx(omega, np.rad2deg(np.unwrap(np.angle(response))), color=colour)
        magnitude.set_title(title, loc="left")
        phase.set_xlabel("angular frequency in rad/s")
        for each in (magnitude, phase):
            each.axvline(
                merit.crossover_rad_s if system is loop.open else merit.bandwidth_rad_s,
                color=GREY,
                linestyle=":",
                linewidth=0.8,
            )
    plant = loop.plant(1j * omega)
    grid[0, 1].semilogx(
        omega, 20.0 * np.log10(np.abs(plant / plant[0])), color=GREY, label="motor alone"
    )
    dots = {"color": VERMILION, "linestyle": "", "marker": "o", "markersize": 4}
    grid[0, 1].semilogx(frequencies_rad_s, 20.0 * np.log10(np.abs(measured)), label="FMU", **dots)
    grid[1, 1].semilogx(frequencies_rad_s, np.rad2deg(np.angle(measured)), **dots)
    grid[0, 1].legend(loc="lower left")
    grid[0, 0].set_ylabel("magnitude in dB")
    grid[1, 0].set_ylabel("phase in degrees")
    grid[1, 0].axhline(-180.0, color=GREY, linewidth=0.8)
    grid[1, 0].set_ylim(-190.0, -40.0)
    grid[1, 0].text(
        0.97, 0.9, f"phase margin {merit.phase_margin_deg:.1f}°", ha="right", va="top",
        transform=grid[1, 0].transAxes,
    )  # fmt: skip
    return figure

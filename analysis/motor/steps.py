"""Step responses of the motor FMU with several gains of Eq. (14), and the plots of its loop.

The built-in FMU holds its integral while the voltage is at its limit. Eq. (14) as printed does not:
it is computed here, and its voltage given to the FMU in open loop at every internal step.
"""

from typing import Any, NamedTuple

import control
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure

from analysis.figures.style import WIDTH_IN
from analysis.motor.instance import GivenMotor, responses, running
from analysis.motor.speed_loop import Loop, figures_of_merit, speed_loop
from analysis.reading.motor_test import Rise, rise
from cosim.base.colours import BLACK, BLUE, GREEN, GREY, VERMILION
from cosim.base.plotting import styled
from cosim.base.progress import Progress, silent
from cosim.model.params import MotorParams, motor_time_constant

LEAST_DURATION_S, SAMPLE_S = 2.0, 1e-3
TIME_CONSTANTS = 10.0  # of the motor, that a response lasts at least
STEP_S = 1e-5  # of the FMU


class StepResponse(NamedTuple):
    """A step response from rest."""

    # K_p, K_i: gains in V s/rad and V/rad
    K_p: float
    K_i: float
    anti_windup: bool  # whether it is the FMU's own loop, else Eq. (14) without anti-windup
    rise: Rise  # of the speed
    # omega, voltage: (n,) speed in rad/s and voltage at the motor in V, every ms
    omega: np.ndarray
    voltage: np.ndarray

    def record(self) -> dict[str, Any]:
        """Return the row of the table."""
        row = self._asdict() | {"rise": self.rise._asdict()}
        return {name: value for name, value in row.items() if name not in {"omega", "voltage"}}


def compare_gains(
    motor: GivenMotor, proposed: MotorParams, omega_des: float, progress: Progress = silent
) -> list[StepResponse]:
    """Step the motor to a set point in rad/s with several gains.

    Returns:
        Responses with the motor's own gains, those proposed, twice its integral gain, the one with
        a zero that cancels the motor's pole, and last its own gains without anti-windup. Gains that
        agree are there once.
    """
    own, tau = motor.params, motor_time_constant(motor.params)
    pairs = [(own.K_p, own.K_i), (proposed.K_p, proposed.K_i)]
    pairs += [(own.K_p, 2.0 * own.K_i), (own.K_p, own.K_p / tau)]
    asked = [(*pair, True) for pair in dict.fromkeys(pairs) if any(pair)] + [(*pairs[0], False)]
    count = round(max(LEAST_DURATION_S, TIME_CONSTANTS * tau) / SAMPLE_S)
    found = []
    for number, (K_p, K_i, anti_windup) in enumerate(asked):
        progress("comparing gains", number, len(asked))
        chosen = motor._replace(params=own._replace(K_p=K_p, K_i=K_i))
        simulate = closed_loop if anti_windup else printed_loop
        omega, voltage = simulate(chosen, omega_des, count).T
        risen = rise(SAMPLE_S * np.arange(count + 1), omega, omega_des)
        found.append(StepResponse(K_p, K_i, anti_windup, risen, omega, voltage))
    progress("comparing gains", len(asked), len(asked))
    return found


def closed_loop(motor: GivenMotor, omega_des: float, count: int) -> np.ndarray:
    """Return speed in rad/s and voltage in V at every ms, (count + 1, 2), in the FMU's own loop.

    The gains are those of the motor's parameters.
    """
    gains = {"K_p": motor.params.K_p, "K_i": motor.params.K_i, "omega_des": omega_des}
    return responses(motor.fmu, {**motor.given, **gains}, ("omega", "V_s"), count, SAMPLE_S)


def printed_loop(
    motor: GivenMotor, omega_des: float, count: int, *, anti_windup: bool = False
) -> np.ndarray:
    """Return the same with Eq. (14) computed here, every internal step.

    With `anti_windup` the integral holds while the voltage is at its limit.
    """
    ticks = round(SAMPLE_S / STEP_S)
    rows = np.zeros((count + 1, 2))
    speed = integral = voltage = 0.0
    gains, limit = motor.params, motor.params.V_s_max
    with running(motor.fmu, {**motor.given, "closed_loop": False}) as (fmu, reference):
        for tick in range(count * ticks + 1):
            error = omega_des - speed
            u = gains.K_p * error + gains.K_i * integral
            if not (anti_windup and abs(u) > limit and u * error > 0.0):
                integral += error * STEP_S
            voltage = min(max(u, -limit), limit)
            if tick % ticks == 0:
                rows[tick // ticks] = speed, voltage
            fmu.setFloat64([reference["V_in"]], [voltage])
            fmu.doStep(tick * STEP_S, STEP_S)
            (speed,) = fmu.getFloat64([reference["omega"]])
    return rows


@styled
def draw(
    motor: MotorParams,
    proposed: MotorParams,
    frequencies_rad_s: np.ndarray,
    measured: np.ndarray,
    steps: list[StepResponse],
    omega_des: float,
) -> Figure:
    """Bode plots of the open and the closed loop, and step responses.

    Args:
        motor, proposed: parameters of the FMU, and the same with the proposed gains.
        frequencies_rad_s, measured: (n,) the closed loop's response of the FMU.
    """
    loops = {"theory": (speed_loop(motor), BLUE), "proposed": (speed_loop(proposed), GREEN)}
    merits = {name: figures_of_merit(loop) for name, (loop, _) in loops.items()}
    figure, grid = plt.subplots(2, 3, figsize=(1.4 * WIDTH_IN, 4.4), sharex="col")
    omega = np.geomspace(
        1e-3 * merits["theory"].bandwidth_rad_s, 50.0 * merits["theory"].bandwidth_rad_s, 400
    )
    for name, (loop, colour) in loops.items():
        for column, system in ((grid[:, 0], loop.open), (grid[:, 1], loop.closed)):
            _draw_bode(column, omega, system(1j * omega), color=colour, label=name)
        grid[0, 0].axvline(merits[name].crossover_rad_s, color=colour, linestyle=":", linewidth=0.8)
        grid[0, 1].axvline(merits[name].bandwidth_rad_s, color=colour, linestyle=":", linewidth=0.8)
    loop: Loop = loops["theory"][0]
    alone = loop.plant(1j * omega) / loop.plant(0.0)
    _draw_bode(grid[:1, 1], omega, alone, color=GREY, label="motor alone")
    dots = {"color": VERMILION, "linestyle": "", "marker": "o", "markersize": 4, "label": "FMU"}
    _draw_bode(grid[:, 1], frequencies_rad_s, measured, **dots)
    grid[0, 0].set_title("open loop; dotted: crossover", loc="left")
    grid[0, 1].set_title("closed loop; dotted: bandwidth", loc="left")
    for axes in grid[1, :2]:
        axes.set_xlabel("angular frequency in rad/s")
    grid[0, 0].set_ylabel("magnitude in dB")
    grid[1, 0].set(ylabel="phase in degrees", ylim=(-190.0, 10.0))
    grid[1, 0].axhline(-180.0, color=GREY, linewidth=0.8)
    margins = (f"{name} {merit.phase_margin_deg:.1f}°" for name, merit in merits.items())
    grid[1, 0].text(
        0.97, 0.95, "phase margin\n" + "\n".join(margins), ha="right", va="top",
        transform=grid[1, 0].transAxes,
    )  # fmt: skip
    grid[0, 1].legend(loc="lower left")
    speed, voltage = grid[:, 2]
    time_s = SAMPLE_S * np.arange(len(steps[0].omega))
    linear = np.asarray(control.step_response(loop.closed, time_s).outputs)
    speed.plot(time_s, omega_des * linear, color=BLUE, linestyle="--", label="theory")
    for step, label, colour in zip(steps, ("FMU", "proposed"), (VERMILION, GREEN), strict=False):
        speed.plot(time_s, step.omega, color=colour, label=label)
        voltage.plot(time_s, step.voltage, color=colour)
    speed.axhline(omega_des, color=BLACK, linestyle=":", linewidth=0.8)
    voltage.axhline(motor.V_s_max, color=BLACK, linestyle=":", linewidth=0.8)
    speed.set_title("step response", loc="left")
    speed.set_ylabel("speed in rad/s")
    speed.legend(loc="lower right")
    voltage.set(ylabel="voltage in V", xlabel="time in s")
    return figure


def _draw_bode(axes: np.ndarray, omega: np.ndarray, response: np.ndarray, **style: Any) -> None:
    """Draw the magnitude of a response (n,) on the first axes, and its phase on the second."""
    curves = 20.0 * np.log10(np.abs(response)), np.rad2deg(np.unwrap(np.angle(response)))
    for each, curve in zip(axes, curves, strict=False):
        each.semilogx(omega, curve, **style)

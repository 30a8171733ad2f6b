"""The motor's speed loop in control theory, its gains, and the FMU's own frequency response.

Plant and PI controller are transfer functions of the parameters that the FMU has. Without Coulomb
friction, weight and saturation the FMU must agree with them. `analysis.motor.steps` has its step
responses with all of these.
"""

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import control
import numpy as np

from analysis.motor.instance import GivenMotor, responses
from cosim.base.arguments import ConfigError
from cosim.base.progress import Progress, silent
from cosim.fmi.motor import MotorFmu
from cosim.model.params import FIG_7, TIMING, MotorParams, motor_gain, motor_time_constant

# A sine in steps: holding each value takes 4e-5 off its amplitude, and half a step of time. The
# steps themselves, sampled at their ends, look like the sine: they must be too fast for the loop.
LEAST_SAMPLES_PER_PERIOD = 200
SAMPLES_OVER_FASTEST = 25.0
PERIODS = 2
# Voltage of the sine: small enough for the transient to keep within the limits.
SHARE_OF_VOLTAGE = 0.25
RK4 = 2
# The fast pole's share of the start has gone after this many of its time constants, which are
# awaited up to a limit: the rest of both is fitted.
SETTLING, MAX_SETTLING_S = 12.0, 1.0
FASTEST_RAD_S = 3000.0  # measured, for the FMU's internal step of 1e-5 s
PHASE_MARGIN_DEG = 60.0  # that proposed gains leave with a delay of one control period
SHARE_OF_SPEED = 0.8  # of what the motor can reach, for a step response


class Loop(NamedTuple):
    """Transfer functions in rad/s and V: motor, motor and controller in series, closed loop."""

    plant: Any
    open: Any
    closed: Any


def speed_loop(motor: MotorParams) -> Loop:
    """Eq. (13) without Coulomb friction and weight, and Eq. (14) without saturation."""
    plant: Any = control.tf([motor_gain(motor)], [motor_time_constant(motor), 1.0])
    # Without integral there is no pole at 0 either.
    pi = ([motor.K_p, motor.K_i], [1.0, 0.0]) if motor.K_i else ([motor.K_p], [1.0])
    opened = control.series(control.tf(*pi), plant)
    return Loop(plant, opened, control.feedback(opened))


class LoopMerit(NamedTuple):
    """Figures of merit of the speed loop."""

    poles_rad_s: tuple[complex, ...]  # of the closed loop, slowest first
    # bandwidth_rad_s, open_bandwidth_rad_s: of the closed loop, -3 dB of its gain at rest, and of
    # the motor alone
    bandwidth_rad_s: float
    open_bandwidth_rad_s: float
    gain_margin: float  # factor; infinite for a plant of first order
    # phase_margin_deg, crossover_rad_s: at the gain crossover; infinite and NaN where there is none
    phase_margin_deg: float
    crossover_rad_s: float
    # With a delay of one control period, as of a controller in firmware
    delayed_phase_margin_deg: float

    def record(self) -> dict[str, Any]:
        """Return the figures for JSON: a pole is a pair of its real and its imaginary part."""
        return self._asdict() | {"poles_rad_s": [(p.real, p.imag) for p in self.poles_rad_s]}


def figures_of_merit(loop: Loop) -> LoopMerit:
    """Poles, bandwidth and margins."""
    gain_margin, phase_margin, _, crossover = map(float, control.margin(loop.open))
    poles = (complex(pole) for pole in control.poles(loop.closed))
    return LoopMerit(
        tuple(sorted(poles, key=lambda pole: (-pole.real, -pole.imag))),
        float(control.bandwidth(loop.closed)),
        float(control.bandwidth(loop.plant)),
        gain_margin,
        phase_margin,
        crossover,
        phase_margin - float(np.nan_to_num(math.degrees(crossover * TIMING.control_period_s))),
    )


def step_speed(motor: MotorParams, omega_des: float | None) -> float:
    """Return the set point of a step: the one given, or Fig. 7's as far as the motor reaches it."""
    most = motor_gain(motor) * (motor.V_s_max - motor.c * motor.R / motor.K_T)
    if not most > 0.0:
        raise ConfigError(
            f"V_s_max = {motor.V_s_max:g} V does not turn this motor against its Coulomb friction "
            f"c = {motor.c:g} N m; raise V_s_max or K_T, or lower R or c"
        )
    if omega_des is not None and omega_des >= most:
        raise ConfigError(
            f"omega-des = {omega_des:g} rad/s is out of reach: at V_s_max this motor turns with "
            f"{most:.0f} rad/s; choose less"
        )
    return omega_des or min(FIG_7.omega_des, SHARE_OF_SPEED * most)


def propose(motor: MotorParams, omega_des: float) -> tuple[MotorParams, str]:
    """Return a motor with gains for a step to a speed, and what limits them.

    The controller's zero cancels the motor's pole, K_i = K_p/τ: the loop is then of first order,
    without overshoot. K_p is as large as two limits allow. A step from rest to the set point asks
    for no more than the "voltage" limit, and a delay of one control period leaves the "phase
    margin".
    """
    tau = motor_time_constant(motor)
    crossover = math.radians(90.0 - PHASE_MARGIN_DEG) / TIMING.control_period_s
    limits = {
        "voltage": motor.V_s_max / omega_des,
        "phase margin": crossover * tau / motor_gain(motor),
    }
    limit = min(limits, key=lambda name: limits[name])
    return motor._replace(K_p=limits[limit], K_i=limits[limit] / tau), limit


def frequencies_of(loop: Loop, count: int = 10) -> np.ndarray:
    """Return angular frequencies (count,) around the bandwidth, as far as the FMU's step allows."""
    bandwidth = figures_of_merit(loop).bandwidth_rad_s
    return np.geomspace(bandwidth / 60.0, min(16.0 * bandwidth, FASTEST_RAD_S), count)


def measured_response(
    motor: GivenMotor, frequencies_rad_s: np.ndarray, progress: Progress = silent
) -> np.ndarray:
    """Frequency response of the FMU's closed loop from set point to speed, complex (n,).

    Without Coulomb friction and weight, each frequency (n,) on its own: a sine of the set point,
    held between communication points, and a least-squares fit of a sine to the speed, next to what
    is left of the poles' answer to the start.
    """
    linear = {"c": 0.0, "m": 0.0, "solver": RK4}
    start = {**motor.given, **{k: v for k, v in linear.items() if k in motor.fmu.variables}}
    loop, measured = speed_loop(motor.params), []
    for frequency in frequencies_rad_s:
        progress("measuring the FMU", len(measured), len(frequencies_rad_s))
        volts = abs(loop.closed(1j * frequency) / loop.plant(1j * frequency))  # per rad/s
        amplitude = SHARE_OF_VOLTAGE * motor.params.V_s_max / volts
        measured.append(_measure(motor.fmu, start, loop, frequency, amplitude))
    progress("measuring the FMU", len(measured), len(measured))
    return np.array(measured)


def _measure(
    motor: MotorFmu, start: Mapping[str, float], loop: Loop, frequency: float, amplitude: float
) -> complex:
    merit, period_s = figures_of_merit(loop), 2.0 * np.pi / frequency
    needed = int(np.ceil(SAMPLES_OVER_FASTEST * merit.bandwidth_rad_s / frequency))
    samples = max(LEAST_SAMPLES_PER_PERIOD, needed)
    step_s = period_s / samples
    settling_s = min(-SETTLING / merit.poles_rad_s[-1].real, MAX_SETTLING_S)
    settling = int(np.ceil(settling_s / period_s)) * samples
    count = settling + PERIODS * samples
    # Half a step early: a held value acts on average half a step late.
    set_point = amplitude * np.sin(frequency * step_s * (np.arange(count) + 0.5))
    inputs = {"omega_des": set_point}
    speed = responses(motor, start, ["omega"], count, step_s, inputs)[1:, 0]
    time_s = step_s * np.arange(1, PERIODS * samples + 1)  # since the end of settling
    angle = frequency * (settling * step_s + time_s)
    modes = [np.exp(pole * time_s) for pole in merit.poles_rad_s]
    parts = (part(mode) for mode in modes for part in (np.real, np.imag))
    free = [part for part in parts if part.any()]
    shapes = np.column_stack([np.sin(angle), np.cos(angle), *free])
    in_phase, quadrature, *_ = np.linalg.lstsq(shapes, speed[settling:], rcond=None)[0]
    return complex(in_phase, quadrature) / amplitude

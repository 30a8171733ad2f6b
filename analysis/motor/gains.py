"""Table of the effect of the gains of Eq. (14) on the response of the motor FMU.

The FMU holds its integral while the voltage is at its limit. Without that, Eq. (14) as printed is
computed here and its voltage given to the FMU in open loop, every internal step.
"""

from typing import NamedTuple

import numpy as np

from analysis.motor.instance import running
from analysis.reading.motor_test import Rise, rise
from cosim.base.progress import Progress, silent
from cosim.coupling.fmu import MotorFmu
from cosim.model.params import FIG_7, TABLE_II, motor_time_constant

DURATION_S, SAMPLE_S = 2.0, 1e-3
STEP_S = 1e-5  # of the FMU
# From Table II to the gain with a zero that cancels the motor's pole.
INTEGRAL_GAINS = (TABLE_II.K_i, 2.0 * TABLE_II.K_i, TABLE_II.K_p / motor_time_constant(TABLE_II))


class Gains(NamedTuple):
    """A row of the table.

    Attributes:
        K_i: integral gain in V/rad.
        anti_windup: whether the integral holds while the voltage is at its limit.
        rise: of the speed.
    """

    K_i: float
    anti_windup: bool
    rise: Rise


def compare_gains(motor: MotorFmu, progress: Progress = silent) -> list[Gains]:
    """Step the motor to Fig. 7's set point with each integral gain, and without anti-windup.

    Raises:
        FmuError: the FMU cannot be used.
    """
    asked = [(gain, True) for gain in INTEGRAL_GAINS] + [(TABLE_II.K_i, False)]
    found = []
    for number, (gain, anti_windup) in enumerate(asked):
        progress("comparing gains", number, len(asked))
        omega = closed_loop(motor, gain) if anti_windup else printed_loop(motor, gain, False)
        time_s = SAMPLE_S * np.arange(len(omega))
        found.append(Gains(gain, anti_windup, rise(time_s, omega, FIG_7.omega_des)))
    progress("comparing gains", len(asked), len(asked))
    return found


def closed_loop(motor: MotorFmu, K_i: float) -> np.ndarray:
    """Return the speed in rad/s at every ms, in the FMU's own closed loop."""
    omega = np.zeros(round(DURATION_S / SAMPLE_S) + 1)
    with running(motor, omega_des=FIG_7.omega_des, K_i=K_i) as (fmu, reference):
        for k in range(1, len(omega)):
            fmu.doStep((k - 1) * SAMPLE_S, SAMPLE_S)
            (omega[k],) = fmu.getFloat64([reference["omega"]])
    return omega


def printed_loop(motor: MotorFmu, K_i: float, anti_windup: bool) -> np.ndarray:
    """Return the same with Eq. (14) computed here, every internal step.

    Args:
        motor: the FMU.
        K_i: integral gain in V/rad.
        anti_windup: whether the integral holds while the voltage is at its limit.
    """
    ticks = round(SAMPLE_S / STEP_S)
    omega = np.zeros(round(DURATION_S / SAMPLE_S) + 1)
    speed = integral = 0.0
    limit = TABLE_II.V_s_max
    with running(motor, closed_loop=False) as (fmu, reference):
        for k in range(1, len(omega)):
            for tick in range((k - 1) * ticks, k * ticks):
                error = FIG_7.omega_des - speed
                u = TABLE_II.K_p * error + K_i * integral
                if not (anti_windup and abs(u) > limit and u * error > 0.0):
                    integral += error * STEP_S
                fmu.setFloat64([reference["V_in"]], [min(max(u, -limit), limit)])
                fmu.doStep(tick * STEP_S, STEP_S)
                (speed,) = fmu.getFloat64([reference["omega"]])
            omega[k] = speed
    return omega

"""The experiment of importers: a motor that starts, saturates and settles under a torque.

Inputs are constant: importers differ in how they take inputs that change.
"""

from functools import cache

import numpy as np

INPUTS = {"omega_des": 700.0, "d": 1e-6}
STOP_S = 0.5
STEP_S = 5e-3  # communication step, and time between rows of the results
STEPS = round(STOP_S / STEP_S)
OUTPUTS = ["theta", "omega", "omega_dot", "V_s", "i"]


@cache
def reference_rows() -> np.ndarray:
    """Outputs after every step, (steps, outputs) float64, as the co-simulation steps a motor."""
    from cosim.fmi.motor import Motor, MotorFmu
    from fmus.build import cached_fmu

    motor, rows = Motor(MotorFmu(cached_fmu("VibrationMotor")), "reference", INPUTS), []
    numbers = np.concatenate([motor.fmu.outputs, motor.fmu.electrical])[: len(OUTPUTS)]
    for k in range(STEPS):
        motor.step(k * STEP_S, STEP_S)
        rows.append(motor.get(numbers))
    motor.close()
    return np.array(rows)

"""The experiment of importers: a motor that starts, saturates and settles under a torque.

Inputs are constant: importers differ in how they take inputs that change.
"""

import tempfile
from functools import cache
from typing import Any

import fmpy
import numpy as np
from fmpy.fmi3 import FMU3Slave

from fmus.build import cached_fmu

INPUTS = {"omega_des": 700.0, "d": 1e-6}
STOP_S = 0.5
STEP_S = 5e-3  # communication step, and time between rows of the results
STEPS = round(STOP_S / STEP_S)
OUTPUTS = ["theta", "omega", "omega_dot", "V_s", "i"]


@cache
def reference_rows() -> np.ndarray:
    """Outputs after every step, (steps, outputs) float64: a loop over the functions of FMI 3.0."""
    path = str(cached_fmu("VibrationMotor"))
    description: Any = fmpy.read_model_description(path)
    reference = {v.name: v.valueReference for v in description.modelVariables}
    with tempfile.TemporaryDirectory() as folder:
        fmpy.extract(path, folder)
        instance = FMU3Slave(
            guid=description.guid,
            unzipDirectory=folder,
            modelIdentifier=description.coSimulation.modelIdentifier,
            instanceName="reference",
        )
        instance.instantiate()
        for name, value in INPUTS.items():
            instance.setFloat64([reference[name]], [value])
        instance.enterInitializationMode()
        instance.exitInitializationMode()
        rows = []
        for k in range(STEPS):
            instance.doStep(k * STEP_S, STEP_S)
            rows.append(instance.getFloat64([reference[name] for name in OUTPUTS]))
        instance.terminate()
        instance.freeInstance()
    return np.array(rows)

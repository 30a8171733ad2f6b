"""The experiment of importers: a motor that starts, saturates and settles under a torque.

Inputs are constant: importers differ in how they take inputs that change.
"""

import tempfile
from functools import cache

import fmpy
import numpy as np
from fmpy.fmi3 import FMU3Slave

from fmus.build import cached_fmu
from fmus.variables import load_table

INPUTS = {"omega_des": 700.0, "d": 1e-6}
STOP_S = 0.5
STEP_S = 5e-3  # communication step, and time between rows of the results
STEPS = round(STOP_S / STEP_S)
OUTPUTS = [variable.name for variable in load_table().group("output")]


@cache
def reference_rows() -> np.ndarray:
    """Outputs after every step, (steps, outputs) float64: a loop over the functions of FMI 3.0."""
    table, path = load_table(), str(cached_fmu("VibrationMotor"))
    description = fmpy.read_model_description(path)
    with tempfile.TemporaryDirectory() as folder:
        fmpy.extract(path, folder)
        instance = FMU3Slave(
            guid=description.guid,
            unzipDirectory=folder,
            modelIdentifier=table.name,
            instanceName="reference",
        )
        instance.instantiate()
        for name, value in INPUTS.items():
            instance.setFloat64([table[name].reference], [value])
        instance.enterInitializationMode()
        instance.exitInitializationMode()
        rows = []
        for k in range(STEPS):
            instance.doStep(k * STEP_S, STEP_S)
            rows.append(instance.getFloat64([table[name].reference for name in OUTPUTS]))
        instance.terminate()
        instance.freeInstance()
    return np.array(rows)

"""A motor FMU on its own, stepped through fmpy with start values of any type."""

import contextlib
from collections.abc import Iterator
from typing import Any

from fmpy.simulation import instantiate_fmu

from cosim.coupling.fmu import MotorFmu


@contextlib.contextmanager
def running(motor: MotorFmu, **start: float | bool) -> Iterator[tuple[Any, dict[str, int]]]:
    """An instance in step mode at t = 0: fmpy's, and value references by variable name.

    Args:
        motor: the FMU.
        start: values by variable name: bool for Boolean, int for Enumeration, float for Float64.
    """
    reference = {v.name: v.valueReference for v in motor.description.modelVariables}
    fmu: Any = instantiate_fmu(
        motor.folder, motor.description, fmi_type="CoSimulation", debug_logging=True
    )
    setters = {bool: fmu.setBoolean, int: fmu.setInt64, float: fmu.setFloat64}
    try:
        for name, value in start.items():
            setters[type(value)]([reference[name]], [value])
        fmu.enterInitializationMode()
        fmu.exitInitializationMode()
        yield fmu, reference
        fmu.terminate()
    finally:
        fmu.freeInstance()

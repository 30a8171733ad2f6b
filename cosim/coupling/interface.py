"""Interface of a motor FMU, compared with its modelDescription; nothing here runs one.

Units are those of the project's own motor (`fmus.variables`). A unit is what its definition in SI
base units says, whatever its name; a variable without a unit is taken to be in the right one.

An FMU of many motors has all of them as arrays; their only dimension is one structural parameter,
and an Int64 input of that size, `restart`: a motor restarts in the step after its number has
changed. The project's own is `VibrationMotors`.
"""

import math
from collections.abc import Mapping
from functools import cache
from pathlib import Path

from fmpy.model_description import BaseUnit, CoSimulation, ModelDescription, ModelVariable

from cosim.fmi.fmu import FmuError, check_steps
from fmus.variables import Unit, load_table

INPUTS = ("omega_des", "omega_noise", "d")
# The same in open loop: a voltage instead of a set point, and the parameter that says so.
OPEN_INPUTS, CLOSED_LOOP = ("V_in", *INPUTS[1:]), "closed_loop"
OUTPUTS = ("theta", "omega", "omega_dot")
ELECTRICAL = ("V_s", "i")
LOOP = ("u", "integral")  # of the controller, which an FMU need not have
RESTART = "restart"
# Of arrays, for a driver that has many communication steps of one `doStep`: the outputs at their
# ends, the structural parameter that says how many, and the internal step.
SAMPLED, SAMPLES = tuple(f"{name}_samples" for name in OUTPUTS), "samples"
STEP_SIZE = "step_size"
PHASE = "theta_start"  # parameter: angle at the start
_BASE_UNITS = ("kg", "m", "s", "A", "K", "mol", "cd", "rad")
_DIMENSIONLESS = ("", "1", "-")  # names that many exporters do not define


def array_size(path: Path, variables: Mapping[str, ModelVariable]) -> int | None:
    """Value reference of the parameter for the number of motors of an instance; None if one.

    Args:
        path: of the FMU.
        variables: of the FMU, by name.

    Raises:
        FmuError: it has arrays of another kind than this module's head says.
    """
    first = variables.get(INPUTS[0])
    if first is None or not first.dimensions:
        return None
    size, restart = first.dimensions[0].variable, variables.get(RESTART)
    if len(first.dimensions) > 1 or size is None or size.causality != "structuralParameter":
        raise FmuError(
            f"motor FMU {path} has '{first.name}' as an array of fixed or of several dimensions; "
            "export it as a scalar, or with one structural parameter as its size"
        )
    if (
        restart is None
        or (restart.type, restart.causality) != ("Int64", "input")
        or [d.valueReference for d in restart.dimensions] != [size.valueReference]
    ):
        raise FmuError(
            f"motor FMU {path} has arrays but no Int64 input '{RESTART}' of their size; export it "
            "with one, or with scalars"
        )
    return size.valueReference


def check_variable(
    path: Path,
    description: ModelDescription,
    variable: ModelVariable,
    size: int | None,
    *causalities: str,
    samples: int | None = None,
) -> None:
    """Refuse a variable that the master cannot exchange.

    Args:
        path: of the FMU.
        description: of the FMU.
        variable: one of its variables.
        size: value reference of the size that it must have as an array, None for a scalar.
        causalities: those it may have, the usual one first.
        samples: value reference of the number of values that it must have of each motor, None for
            one.

    Raises:
        FmuError: it is no Float64 of that size and causality, is clocked, or has another unit.
    """
    said = f"motor FMU {path} has '{variable.name}'"
    if variable.type != "Float64" or variable.causality not in causalities:
        raise FmuError(
            f"{said} as {variable.type} {variable.causality}; export it as Float64 {causalities[0]}"
        )
    sizes = [dimension.valueReference for dimension in variable.dimensions]
    if sizes != [number for number in (samples, size) if number is not None]:
        needed = "a scalar" if size is None else f"an array of the size of '{INPUTS[0]}'"
        raise FmuError(f"{said} as {'an array' if sizes else 'a scalar'}; export it as {needed}")
    if variable.clocks:
        raise FmuError(f"{said} tied to a clock; export it without")
    declared = variable.unit or (variable.declaredType and variable.declaredType.unit)
    unit = _units().get(variable.name)
    if declared and unit and not _same_unit(declared, description, unit):
        raise FmuError(f"{said} in {declared}; export it in {unit.name}")


def check_use(path: Path, interface: CoSimulation, motors: int, step_s: float) -> None:
    """Refuse an FMU that lacks a capability that a run needs.

    Args:
        path: of the FMU.
        interface: its capabilities.
        motors: instances at the same time.
        step_s: communication step.

    Raises:
        FmuError: it lacks one.
        ConfigError: its internal step does not divide the communication step.
    """
    if motors > 1 and interface.canBeInstantiatedOnlyOncePerProcess:
        raise FmuError(
            f"motor FMU {path} has canBeInstantiatedOnlyOncePerProcess, and {motors} motors are "
            "needed at once; export it without"
        )
    check_steps(interface, f"motor FMU {path}", ("communication_step_s", step_s), None)


@cache
def _units() -> dict[str, Unit]:
    """Unit of each variable of a motor."""
    table = load_table()
    units = {unit.name: unit for unit in table.units}
    return {v.name: units[v.unit] for v in table.variables if v.unit}


def _same_unit(name: str, description: ModelDescription, unit: Unit) -> bool:
    defined = (u.baseUnit for u in description.unitDefinitions if u.name == name)
    base = next(defined, BaseUnit() if name in _DIMENSIONLESS else None)
    if base is None:  # a unit may go without a definition in SI base units
        return name == unit.name
    return (
        all(int(getattr(base, each)) == unit.base.get(each, 0) for each in _BASE_UNITS)
        and math.isclose(base.factor, 1.0)
        and base.offset == 0.0
    )

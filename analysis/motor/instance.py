"""A motor FMU on its own, stepped through fmpy with start values of any type."""

import contextlib
import math
from collections import deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from fmpy.fmi1 import FMICallException
from fmpy.simulation import instantiate_fmu

from cosim.base.arguments import ConfigError, require_one_of
from cosim.fmi.fmu import FmuError
from cosim.fmi.motor import MotorFmu
from cosim.model.params import MotorParams

_POSITIVE = ("K_T", "R", "J", "V_s_max")
_NEEDED = (*_POSITIVE, "b", "K_p", "K_i")


@contextlib.contextmanager
def running(
    motor: MotorFmu, start: Mapping[str, float | bool]
) -> Iterator[tuple[Any, dict[str, int]]]:
    """An instance in step mode at t = 0: fmpy's, and value references by variable name.

    Start values are bool for Boolean, int for Enumeration, float for Float64.
    """
    reference = {name: variable.valueReference for name, variable in motor.variables.items()}
    if lacking := start.keys() - reference.keys():
        raise FmuError(f"motor FMU {motor.path} has no '{min(lacking)}'; export it with one")
    messages: deque[str] = deque(maxlen=1)

    def take(_environment: Any, _status: Any, _category: Any, message: bytes) -> None:
        messages.append((message or b"").decode("utf-8", "replace"))

    fmu: Any = instantiate_fmu(
        motor.folder,
        motor.description,
        fmi_type="CoSimulation",
        debug_logging=True,
        logger=take,
    )
    setters = {bool: fmu.setBoolean, int: fmu.setInt64, float: fmu.setFloat64}
    try:
        for name, value in start.items():
            setters[type(value)]([reference[name]], [value])
        fmu.enterInitializationMode()
        fmu.exitInitializationMode()
        yield fmu, reference
        fmu.terminate()
    except FMICallException as error:
        raise FmuError(
            f"motor FMU {motor.path} failed: {' '.join([str(error), *messages])}"
        ) from error
    finally:
        fmu.freeInstance()


def responses(
    motor: MotorFmu,
    start: Mapping[str, float | bool],
    outputs: Sequence[str],
    count: int,
    step_s: float,
    inputs: Mapping[str, np.ndarray] = {},
) -> np.ndarray:
    """Outputs (count + 1, n) before each of `count` steps and after the last.

    Inputs are set before outputs are read and steps are made, as far as there are values of them.
    """
    rows = np.empty((count + 1, len(outputs)))
    with running(motor, start) as (fmu, reference):
        wanted = [reference[name] for name in outputs]
        for k in range(count + 1):
            for name, values in inputs.items():
                if k < len(values):
                    fmu.setFloat64([reference[name]], [values[k]])
            rows[k] = fmu.getFloat64(wanted)
            if k < count:
                fmu.doStep(k * step_s, step_s)
    return rows


def require_parameters(motor: MotorFmu, names: Iterable[str]) -> None:
    """Refuse names that are not those of Float64 parameters of an FMU."""
    known = [
        name
        for name, variable in motor.variables.items()
        if variable.causality == "parameter" and variable.type in {"Float64", "Real"}
    ]
    for name in names:
        require_one_of("motor-parameter", name, known)
        motor.parameter(name)  # in its unit


class GivenMotor(NamedTuple):
    """A motor FMU with values that it is given before the start, and all its parameters then.

    Parameters that it does not expose are 0.
    """

    fmu: MotorFmu
    given: Mapping[str, float]
    params: MotorParams

    @classmethod
    def of(cls, fmu: MotorFmu, given: Mapping[str, float]) -> "GivenMotor":
        """Read the parameters; those of the speed loop are known and valid."""
        require_parameters(fmu, given)
        found = fmu.read(MotorParams._fields, given)
        if lacking := [name for name in _NEEDED if name not in found]:
            raise FmuError(
                f"the motor FMU does not expose {', '.join(lacking)}, which the loop needs; export "
                "it with them"
            )
        for name in _POSITIVE:
            if not 0.0 < found[name] < math.inf:
                raise ConfigError(
                    f"motor-parameter {name} = {found[name]:g} must be positive and finite"
                )
        if found["K_p"] == found["K_i"] == 0.0:
            raise ConfigError("K_p and K_i are both 0, so there is no loop; set one of them")
        params = MotorParams(**(dict.fromkeys(MotorParams._fields, 0.0) | found))
        return cls(fmu, given, params)

"""A motor FMU on its own, stepped through fmpy with start values of any type."""

import contextlib
import math
from collections.abc import Iterable, Iterator, Mapping
from typing import Any, NamedTuple

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

    Args:
        motor: the FMU.
        start: values by variable name: bool for Boolean, int for Enumeration, float for Float64.

    Raises:
        FmuError: the FMU lacks a variable, or refuses a call.
    """
    reference = {name: variable.valueReference for name, variable in motor.variables.items()}
    if lacking := start.keys() - reference.keys():
        raise FmuError(f"motor FMU {motor.path} has no '{min(lacking)}'; export it with one")
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
    except FMICallException as error:
        raise FmuError(f"motor FMU {motor.path} failed: {error}") from error
    finally:
        fmu.freeInstance()


def require_parameters(motor: MotorFmu, names: Iterable[str]) -> None:
    """Refuse names that are not those of Float64 parameters of an FMU.

    Raises:
        ConfigError: it names the first of them and all parameters.
    """
    known = [
        name
        for name, variable in motor.variables.items()
        if variable.causality == "parameter" and variable.type in {"Float64", "Real"}
    ]
    for name in names:
        require_one_of("motor-parameter", name, known)


class GivenMotor(NamedTuple):
    """A motor FMU with values that it is given.

    Attributes:
        fmu: the FMU.
        given: values that are set before the start, by name.
        params: parameters that the FMU then has; 0 for those that it does not expose.
    """

    fmu: MotorFmu
    given: Mapping[str, float]
    params: MotorParams

    @classmethod
    def of(cls, fmu: MotorFmu, given: Mapping[str, float]) -> "GivenMotor":
        """Read the parameters; those of the speed loop are known and valid.

        Raises:
            FmuError: the FMU does not expose one of the loop's parameters.
            ConfigError: a value is invalid, or `given` names no parameter.
        """
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

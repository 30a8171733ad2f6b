"""Motor FMUs: check, instantiate and step with fmpy; the addresses of their C functions.

Any FMI 3.0 Co-Simulation FMU with the variables below can drive a robot; they are found by name in
its modelDescription. Units are those of the project's own motor (`fmus.variables`). A unit is what
its definition in SI base units says, whatever its name; a variable without a unit is taken to be in
the right one.

An FMU of many motors has all of them as arrays; their only dimension is one structural parameter,
and an Int64 input of that size, `restart`: a motor restarts in the step after its number has
changed. The project's own is `VibrationMotors`.
"""

import contextlib
import ctypes
import functools
import math
import weakref
from collections import deque
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from fmpy.fmi1 import FMICallException
from fmpy.model_description import BaseUnit

from cosim.fmi.abi import FMI_ERROR, FMI_FATAL
from cosim.fmi.fmu import Fmu, FmuError, end
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
_MESSAGES = 100  # what is kept of those of an FMU, which may come in floods


class Addresses(NamedTuple):
    """C functions of an FMI 3.0 binary, as integers for compiled code."""

    set_float64: int
    do_step: int
    get_float64: int


class Sampling(NamedTuple):
    """Samples that a step of an FMU returns: their number, and the time between two in s."""

    number: int
    interval_s: float


class MotorFmu(Fmu):
    """An unpacked motor FMU from which instances are made; see `Fmu` for more of its attributes.

    Attributes:
        inputs, outputs, electrical: value references (uint32) of INPUTS (OPEN_INPUTS in open loop),
            OUTPUTS, ELECTRICAL (and LOOP, if there is one).
        closed_loop: value reference of the parameter that instances in open loop get, else None.
        size: value reference of the number of motors of an instance of arrays; None of one motor.

    Raises:
        FmuError: the file is missing, is no FMU, or lacks a part of the interface.
        OSError: the file cannot be read, or the cache cannot be written.
    """

    def __init__(self, path: Path, *, open_loop: bool = False) -> None:
        super().__init__(path)
        self.size = self._array_size()
        self.closed_loop: int | None = None
        if open_loop:
            for name in (OPEN_INPUTS[0], CLOSED_LOOP):
                if name not in self.variables:
                    raise FmuError(
                        f"motor FMU {path} has no '{name}', which --open-loop motors needs; export "
                        "it with one"
                    )
            self.closed_loop = self.variables[CLOSED_LOOP].valueReference
        self.inputs = self._references(OPEN_INPUTS if open_loop else INPUTS, "input")
        self.outputs = self._references(OUTPUTS, "output")
        self.electrical = self._references(ELECTRICAL, "output")
        with contextlib.suppress(KeyError, FmuError):  # what else has such a name is not the loop's
            loop = [self._reference(name, "local", "output") for name in LOOP]
            self.electrical = np.append(self.electrical, np.array(loop, dtype=np.uint32))

    def _references(self, names: tuple[str, ...], causality: str) -> np.ndarray:
        for name in names:
            if name not in self.variables:
                raise FmuError(
                    f"motor FMU {self.path} has no Float64 {causality} '{name}'; a motor needs "
                    f"inputs {', '.join(INPUTS)} and outputs {', '.join(OUTPUTS + ELECTRICAL)}"
                )
        return np.array([self._reference(name, causality) for name in names], dtype=np.uint32)

    def _array_size(self) -> int | None:
        """Value reference of the parameter for the number of motors of an instance; None if one."""
        first = self.variables.get(INPUTS[0])
        if first is None or not first.dimensions:
            return None
        size, restart = first.dimensions[0].variable, self.variables.get(RESTART)
        if len(first.dimensions) > 1 or size is None or size.causality != "structuralParameter":
            raise FmuError(
                f"motor FMU {self.path} has '{first.name}' as an array of fixed or of several "
                "dimensions; export it as a scalar, or with one structural parameter as its size"
            )
        if (
            restart is None
            or (restart.type, restart.causality) != ("Int64", "input")
            or [d.valueReference for d in restart.dimensions] != [size.valueReference]
        ):
            raise FmuError(
                f"motor FMU {self.path} has arrays but no Int64 input '{RESTART}' of their size; "
                "export it with one, or with scalars"
            )
        return size.valueReference

    def _reference(self, name: str, *causalities: str, samples: int | None = None) -> int:
        """Value reference of a variable that the master can exchange.

        Args:
            name: of a variable that the FMU has.
            causalities: those it may have, the usual one first.
            samples: value reference of the number of values that it must have of each motor, None
                for one.

        Raises:
            FmuError: it is no Float64 of the motors' size and of that causality, is clocked, or has
                another unit.
        """
        variable, said = self.variables[name], f"motor FMU {self.path} has '{name}'"
        if variable.type != "Float64" or variable.causality not in causalities:
            raise FmuError(
                f"{said} as {variable.type} {variable.causality}; export it as Float64 "
                f"{causalities[0]}"
            )
        sizes = [dimension.valueReference for dimension in variable.dimensions]
        if sizes != [number for number in (samples, self.size) if number is not None]:
            scalar = self.size is None
            needed = "a scalar" if scalar else f"an array of the size of '{INPUTS[0]}'"
            found = "an array" if sizes else "a scalar"
            raise FmuError(f"{said} as {found}; export it as {needed}")
        if variable.clocks:
            raise FmuError(f"{said} tied to a clock; export it without")
        declared = variable.unit or (variable.declaredType and variable.declaredType.unit)
        unit = _units().get(name)
        if declared and unit and not self._same_unit(declared, unit):
            raise FmuError(f"{said} in {declared}; export it in {unit.name}")
        return variable.valueReference

    def _same_unit(self, name: str, unit: Unit) -> bool:
        defined = (u.baseUnit for u in self.description.unitDefinitions if u.name == name)
        base = next(defined, BaseUnit() if name in _DIMENSIONLESS else None)
        if base is None:  # a unit may go without a definition in SI base units
            return name == unit.name
        return (
            all(int(getattr(base, each)) == unit.base.get(each, 0) for each in _BASE_UNITS)
            and math.isclose(base.factor, 1.0)
            and base.offset == 0.0
        )

    @property
    def arrays(self) -> bool:
        """Return whether an instance has any number of motors."""
        return self.size is not None

    @property
    def samples(self) -> bool:
        """Return whether an instance samples within a step, see `SAMPLED`."""
        return self.arrays and {SAMPLES, *SAMPLED} <= set(self.variables)

    @functools.cached_property
    def sampled(self) -> np.ndarray:
        """Value references (uint32) of the samples of OUTPUTS.

        Raises:
            FmuError: they are no Float64 arrays of samples and motors in the usual unit.
        """
        samples = self.variables[SAMPLES].valueReference
        found = [self._reference(name, "output", samples=samples) for name in SAMPLED]
        return np.array(found, dtype=np.uint32)

    def internal_step_s(self) -> float | None:
        """Internal step unless it is set, None if the FMU has none."""
        variable = self.variables.get(STEP_SIZE)
        return None if variable is None else float(variable.start or 0.0)

    def parameter(self, name: str, *, tunable: bool = False) -> int:
        """Value reference of a variable that is set before initialisation, or in a run too.

        Raises:
            FmuError: there is none of that name, it is no Float64 of the motors' size in the usual
                unit, or it is fixed and to be set in a run.
        """
        if name not in self.variables:
            raise FmuError(f"motor FMU {self.path} has no parameter '{name}'; export it with one")
        if tunable and self.variables[name].variability == "fixed":
            raise FmuError(
                f"motor FMU {self.path} has '{name}' as fixed; export it as tunable, or let all "
                "motors be equal"
            )
        return self._reference(name, "parameter", "input")

    def read(self, names: Iterable[str], given: Mapping[str, float]) -> dict[str, float]:
        """Values that an instance has of those of some variables that it exposes in the usual unit.

        Args:
            names: of the variables.
            given: values that are set before, by name.

        Raises:
            FmuError: see `instantiate`.
        """
        exposed: dict[str, int] = {}
        for name in names:
            with contextlib.suppress(FmuError, KeyError):
                exposed[name] = self._reference(name, self.variables[name].causality)
        motor = self.instantiate("parameters", given)
        try:
            return {n: float(motor._get(np.array([k]))[0]) for n, k in exposed.items()}
        except FMICallException as error:
            what = f"does not tell its parameters ({error})"
            raise motor.error(0.0, what, error.status) from error
        finally:
            motor.close()

    def instantiate(
        self,
        name: str,
        parameters: Mapping[str, float] | None = None,
        motors: int = 1,
        sampling: Sampling | None = None,
    ) -> "Motor":
        """New instance, initialised at t = 0 and in step mode.

        Args:
            name: instance name, as it shall appear in messages.
            parameters: values that replace the FMU's own defaults, by variable name.
            motors: how many it shall have; more than one where they are arrays.
            sampling: which samples a step shall have; None for none.

        Raises:
            FmuError: the FMU lacks a parameter, refuses it, to load or to be initialised.
        """
        return Motor(self, name, parameters or {}, motors, sampling)


@functools.cache
def _units() -> dict[str, Unit]:
    """Unit of each variable of a motor."""
    table = load_table()
    units = {unit.name: unit for unit in table.units}
    return {v.name: units[v.unit] for v in table.variables if v.unit}


class Motor:
    """One running instance of a motor FMU: one motor, or all of them as arrays.

    Values of arrays stand one signal after the other.

    Attributes:
        name: instance name.
        slave: fmpy's FMU3Slave, for drivers that step through Python.
        addresses: of the binary's functions, for drivers that step compiled.
        log: what the FMU has reported last, oldest first.
    """

    def __init__(
        self,
        fmu: MotorFmu,
        name: str,
        parameters: Mapping[str, float],
        motors: int,
        sampling: Sampling | None,
    ) -> None:
        self.fmu = fmu
        self.name = name
        self._motors = motors
        self.log: deque[str] = deque(maxlen=_MESSAGES)
        values = {fmu.parameter(parameter): value for parameter, value in parameters.items()}
        self.slave: Any = None
        try:
            self.slave = fmu.load(name, self.log)
            self._configure(sampling)
            if fmu.closed_loop is not None:
                self.slave.setBoolean([fmu.closed_loop], [False])
            for reference, value in values.items():
                self.slave.setFloat64([reference], [value] * motors)
            self.slave.enterInitializationMode()
            self.slave.exitInitializationMode()
        except Exception as error:  # fmpy raises plain Exceptions
            tool = " without its tool" if fmu.interface.needsExecutionTool else ""
            what = f"cannot be initialised{tool} ({error})"
            status = error.status if isinstance(error, FMICallException) else FMI_ERROR
            raise self.error(0.0, what, status) from error
        self._finalizer = weakref.finalize(self, end, self.slave)
        dll = self.slave.dll
        functions = dll.fmi3SetFloat64, dll.fmi3DoStep, dll.fmi3GetFloat64
        addresses = (ctypes.cast(function, ctypes.c_void_p).value or 0 for function in functions)
        self.addresses = Addresses(*addresses)
        self.instance = int(self.slave.component)

    def _configure(self, sampling: Sampling | None) -> None:
        """Set the number of motors of an instance of arrays, and the samples of its steps."""
        fmu, slave = self.fmu, self.slave
        if fmu.size is None:
            return
        sizes = {fmu.size: self._motors}
        if sampling is not None:
            sizes[fmu.variables[SAMPLES].valueReference] = sampling.number
        slave.enterConfigurationMode()
        slave.setUInt64([*sizes], [*sizes.values()])
        slave.exitConfigurationMode()
        if sampling is not None and sampling.interval_s < (fmu.internal_step_s() or 0.0):
            reference = fmu.variables[STEP_SIZE].valueReference
            slave.setFloat64([reference], [sampling.interval_s])

    def set_inputs(self, values: np.ndarray, tick: int, dt_s: float) -> None:
        """Set INPUTS; raises FmuError naming the time of `tick`."""
        with self._named_errors(tick * dt_s, "refuses its inputs"):
            self.slave.setFloat64(self.fmu.inputs, values)

    def restart(self, runs: np.ndarray) -> None:
        """Restart motors of arrays where the number of a run, (motors,) int64, has changed."""
        with self._named_errors(0.0, "refuses to restart motors"):
            reference = self.fmu.variables[RESTART].valueReference
            self.slave.setInt64([reference], runs.tolist())

    def parameter(self, name: str) -> np.ndarray:
        """Values (motors,) of a tunable parameter; raises FmuError if it is fixed."""
        reference = self.fmu.parameter(name, tunable=True)
        with self._named_errors(0.0, f"does not tell {name}"):
            return np.array(self._get(np.array([reference])))

    def tune(self, name: str, values: np.ndarray) -> None:
        """Set a parameter's values (motors,); raises FmuError if that is refused."""
        with self._named_errors(0.0, f"refuses values of {name}"):
            self.slave.setFloat64([self.fmu.parameter(name, tunable=True)], values)

    def step(self, tick: int, count: int, dt_s: float) -> None:
        """Step from `tick` over `count` ticks; raises FmuError naming the time."""
        with self._named_errors(tick * dt_s, "failed"):
            _, terminate, early_return, _ = self.slave.doStep(tick * dt_s, count * dt_s)
        if terminate or early_return:
            raise self.error(tick * dt_s, "asked to stop")

    def outputs(self, tick: int, dt_s: float) -> list[float]:
        """Values of OUTPUTS; raises FmuError naming the time of `tick`."""
        with self._named_errors(tick * dt_s, "has no outputs"):
            return self._get(self.fmu.outputs)

    def electrical(self, tick: int, dt_s: float) -> list[float]:
        """Values of ELECTRICAL; raises FmuError naming the time of `tick`."""
        with self._named_errors(tick * dt_s, "has no outputs"):
            return self._get(self.fmu.electrical)

    def _get(self, references: np.ndarray) -> list[float]:
        return self.slave.getFloat64(references, self._motors * len(references))

    def get_state(self) -> bytes:
        """Return the state of the instance, serialised through FMI.

        Raises:
            FmuError: the FMU cannot save its state.
        """
        can = self.fmu.interface
        if not (can.canGetAndSetFMUstate and can.canSerializeFMUstate):
            raise FmuError(
                f"motor FMU {self.fmu.path} cannot save its state, which copies and saved states "
                "of a co-simulation need; export it with canGetAndSetFMUState and "
                "canSerializeFMUState"
            )
        with self._named_errors(0.0, "does not save its state"):
            state = self.slave.getFMUState()
            try:
                return self.slave.serializeFMUState(state)
            finally:
                self.slave.freeFMUState(state)

    def set_state(self, saved: bytes) -> None:
        """Restore a state from `get_state`, of this or of another instance of the FMU."""
        state, slave = ctypes.c_void_p(), self.slave
        content = (ctypes.c_uint8 * len(saved)).from_buffer_copy(saved)
        with self._named_errors(0.0, "does not restore its state"):
            slave.fmi3DeserializeFMUState(slave.component, content, len(saved), ctypes.byref(state))
            try:
                slave.setFMUState(state)
            finally:
                slave.freeFMUState(state)

    @contextlib.contextmanager
    def _named_errors(self, time_s: float, what: str) -> Iterator[None]:
        try:
            yield
        except FMICallException as error:
            what = f"{what} (fmi3Status {error.status})"
            raise self.error(time_s, what, error.status) from error

    def error(self, time_s: float, what: str, status: int = FMI_ERROR) -> FmuError:
        """The error with the failed instance, the time, and the last message of the FMU."""
        if self.slave is not None:
            self.slave.failed = True
            self.slave.loaded.fatal |= status >= FMI_FATAL
        said = f": {self.log[-1]}" if self.log else ""
        return FmuError(
            f"FMU {self.fmu.path.name}, instance {self.name}, at {time_s:.5f} s {what}{said}"
        )

    def close(self) -> None:
        """Free the instance; further calls are errors."""
        self._finalizer()

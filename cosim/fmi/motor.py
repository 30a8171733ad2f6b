"""Motor FMUs: checked, instantiated, set, stepped and read with fmpy.

Any FMI 3.0 Co-Simulation FMU with the variables below can drive a robot; they are found by name in
its modelDescription. Units are those of the project's own motor. A unit is what its definition in
SI base units says, whatever its name; a variable without a unit is taken to be in the right one.

An FMU of many motors has all of them as arrays; their only dimension is one structural parameter,
and an Int64 input of that size, `restart`: a motor restarts in the step after its number has
changed. The project's own is `VibrationMotors`.
"""

import contextlib
import copy
import ctypes
import functools
import math
import os
import threading
import weakref
from collections import deque
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
from fmpy.fmi1 import FMICallException
from fmpy.fmi3 import FMU3Slave
from fmpy.model_description import BaseUnit, ModelVariable

from cosim.base.arguments import ConfigError
from cosim.base.provenance import digest_of
from cosim.fmi.calls import FMI_ERROR, FMI_FATAL, Addresses
from cosim.fmi.fmu import Fmu, FmuError
from cosim.model.config import GIVEN, UNKNOWN, CoSimConfig, proportional
from cosim.model.params import TABLE_II, MotorParams, lift_off_speed
from fmus.build import built_in_model
from fmus.description import read_description, variables_of

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
_LOOP_KINDS = (("Float64", "local"), ("Float64", "output"))
_DIMENSIONLESS = ("", "1", "-")  # names that many exporters do not define
_OF_BODY = ("m", "r", "J", "g")  # parameters that are in Eq. (3) too
# What is kept of the messages of an FMU, which may come in floods.
_MESSAGES, _MESSAGE_BYTES = 100, 2000
# fmpy changes the working directory of the process while it loads a binary, and does not change it
# back where that fails.
_LOADING = threading.Lock()


class MotorFmu(Fmu):
    """A motor FMU from which instances are made; see `Fmu` for more of its attributes.

    Order of calls: `MotorFmu(path)` checks the variables; then `Motor(fmu, name, …)` any number of
    times, each of which calls `load`, the first time with the binary. `read` makes an instance of
    its own and frees it. The binary stays loaded until the FMU and all instances are gone.

    Attributes:
        inputs, outputs, electrical: value references (uint32) of INPUTS (OPEN_INPUTS in open loop),
            OUTPUTS, ELECTRICAL (and LOOP, if there is one).
        closed_loop: value reference of the parameter that instances in open loop get, else None.
        size: value reference of the number of motors of an instance of arrays; None of one motor.
        samples: whether an instance samples within a step, see `SAMPLED`.
        internal_step_s: internal step unless it is set, None if the FMU has none.
    """

    def __init__(self, path: Path, *, open_loop: bool = False) -> None:
        super().__init__(path)
        self.size = self._array_size()
        self.arrays = self.size is not None
        self.samples = self.arrays and {SAMPLES, *SAMPLED} <= set(self.variables)
        step = self.variables.get(STEP_SIZE)
        if step is not None:
            self._require_unit(step)
        self.internal_step_s = None if step is None else float(step.start or 0.0)
        self.closed_loop: int | None = None
        if open_loop:
            for name in (OPEN_INPUTS[0], CLOSED_LOOP):
                if name not in self.variables:
                    raise self.refusal(
                        f"has no '{name}', which --open-loop motors needs; export it with one"
                    )
            self.closed_loop = self.variables[CLOSED_LOOP].valueReference
        self.inputs = self._references(OPEN_INPUTS if open_loop else INPUTS, "input")
        self.outputs = self._references(OUTPUTS, "output")
        self.electrical = self._references(ELECTRICAL, "output")
        loop = [self.variables.get(name) for name in LOOP]
        # what else has such a name is not the loop's
        if all(v and (v.type, v.causality) in _LOOP_KINDS for v in loop):
            loop = self._references(LOOP, "local", "output")
            self.electrical = np.append(self.electrical, loop)
        self._loaded: Any = None  # the binary in fmpy's hands; slaves are copies of it

    def _references(self, names: Iterable[str], *causalities: str) -> np.ndarray:
        return np.array([self._reference(name, *causalities) for name in names], dtype=np.uint32)

    def _array_size(self) -> int | None:
        """Value reference of the parameter for the number of motors of an instance; None if one."""
        first = self.variables.get(INPUTS[0])
        if first is None or not first.dimensions:
            return None
        size, restart = first.dimensions[0].variable, self.variables.get(RESTART)
        if len(first.dimensions) > 1 or size is None or size.causality != "structuralParameter":
            raise self.refusal(
                f"has '{first.name}' as an array of fixed or of several dimensions; export it as "
                "a scalar, or with one structural parameter as its size"
            )
        found = restart and (restart.type, restart.causality)
        sizes = [d.valueReference for d in restart.dimensions] if restart else []
        if found != ("Int64", "input") or sizes != [size.valueReference]:
            raise self.refusal(
                f"has arrays but no Int64 input '{RESTART}' of their size; export it with one, or "
                "with scalars"
            )
        return size.valueReference

    def _reference(self, name: str, *causalities: str, samples: int | None = None) -> int:
        """Value reference of a Float64 variable in the usual unit that the master can exchange.

        Args:
            causalities: those it may have, the usual one first.
            samples: value reference of the number of values that it must have of each motor, None
                for one.
        """
        if name not in self.variables:
            raise self.refusal(
                f"has no Float64 {causalities[0]} '{name}'; a motor needs inputs "
                f"{', '.join(INPUTS)} and outputs {', '.join(OUTPUTS + ELECTRICAL)}"
            )
        variable, has = self.variables[name], f"has '{name}'"
        if variable.type != "Float64" or variable.causality not in causalities:
            found = f"{variable.type} {variable.causality}"
            raise self.refusal(f"{has} as {found}; export it as Float64 {causalities[0]}")
        sizes = [dimension.valueReference for dimension in variable.dimensions]
        if sizes != [number for number in (samples, self.size) if number is not None]:
            needed = f"an array of the size of '{INPUTS[0]}'" if self.arrays else "a scalar"
            found = "an array" if sizes else "a scalar"
            raise self.refusal(f"{has} as {found}; export it as {needed}")
        if variable.clocks:
            raise self.refusal(f"{has} tied to a clock; export it without")
        self._require_unit(variable)
        return variable.valueReference

    def _require_unit(self, variable: ModelVariable) -> None:
        """Refuse a variable whose values are not in the usual unit, or not in SI base units."""
        name = variable.name
        declared = variable.unit or (variable.declaredType and variable.declaredType.unit)
        if not declared:
            return
        unit, base = _units().get(name, ("SI units", None))
        defined = (u.baseUnit for u in self.description.unitDefinitions if u.name == declared)
        found = next(defined, BaseUnit() if declared in _DIMENSIONLESS else None)
        if found is None:  # a unit may go without a definition in SI base units
            same = declared == unit or base is None
        else:
            same = math.isclose(found.factor, 1.0) and found.offset == 0.0
            powers = {each: int(getattr(found, each)) for each in _BASE_UNITS}
            same &= base is None or all(n == base.get(each, 0) for each, n in powers.items())
        if not same:
            raise self.refusal(f"has '{name}' in {declared}; export it in {unit}")

    @functools.cached_property
    def sampled(self) -> np.ndarray:
        """Value references (uint32) of the samples of OUTPUTS."""
        samples = self.variables[SAMPLES].valueReference
        found = [self._reference(name, "output", samples=samples) for name in SAMPLED]
        return np.array(found, dtype=np.uint32)

    def parameter(self, name: str, *, tunable: bool = False) -> int:
        """Value reference of a variable that is set before initialisation, or in a run too."""
        if name not in self.variables:
            raise self.refusal(f"has no parameter '{name}'; export it with one")
        if tunable and self.variables[name].variability == "fixed":
            raise self.refusal(
                f"has '{name}' as fixed; export it as tunable, or let all motors be equal"
            )
        return self._reference(name, "parameter", "input")

    def read(self, names: Iterable[str], given: Mapping[str, float]) -> dict[str, float]:
        """Return the values that an instance has of those of some variables that it exposes.

        Values of `given` are set before, by name. One in another unit is refused: the name is that
        of a parameter of Eq. (13) or (14), which may be in the body too.
        """
        variables = [self.variables[name] for name in names if name in self.variables]
        exposed = {v.name: self._reference(v.name, v.causality) for v in variables}
        motor = Motor(self, "parameters", given)
        try:
            return {name: float(motor.get([k])[0]) for name, k in exposed.items()}
        finally:
            motor.close()

    def load(self, name: str, log: deque[str]) -> Any:
        """A new instance, as fmpy's slave, whose messages `log` gets; raises what fmpy does."""
        with _LOADING:
            if self._loaded is None:
                here = Path.cwd()
                try:
                    self._loaded = FMU3Slave(
                        guid=self.description.guid,
                        modelIdentifier=self.interface.modelIdentifier,
                        unzipDirectory=str(self.folder),
                    )
                finally:
                    os.chdir(here)
                self._loaded.fatal = False
                weakref.finalize(self._loaded, fmpy.freeLibrary, self._loaded.dll._handle)
            slave = copy.copy(self._loaded)
            slave.instanceName, slave.loaded = name, self._loaded  # which outlives it so
            slave.failed = False

            def take(_environment: Any, _status: Any, _category: Any, message: bytes) -> None:
                # A reference to the slave here would keep both alive.
                log.append((message or b"")[:_MESSAGE_BYTES].decode("utf-8", "replace"))

            slave.instantiate(loggingOn=True, logMessage=take)
        return slave


@functools.cache
def _units() -> dict[str, tuple[str, dict[str, int]]]:
    """Name and SI base units of the unit of each variable of the project's own motor."""
    root = read_description("VibrationMotor")
    bases = {
        unit.attrib["name"]: {name: int(power) for name, power in unit[0].items()}
        for unit in root.iterfind("UnitDefinitions/Unit")
    }
    found = {v.attrib["name"]: v.get("unit") for v in variables_of(root)}
    return {name: (unit, bases[unit]) for name, unit in found.items() if unit}


def _end(slave: Any) -> None:
    """End an initialised instance, as far as the standard allows after an error.

    An instance that failed is not terminated. After a fatal error nothing of the FMU is called.
    The binary stays until all instances and the FMU are gone.
    """
    if not (slave.failed or slave.loaded.fatal):
        try:
            slave.terminate()
        except FMICallException as error:
            slave.loaded.fatal = error.status >= FMI_FATAL
    if not slave.loaded.fatal:
        slave.fmi3FreeInstance(slave.component)


class Motor:
    """A running instance of a motor FMU, in step mode: one motor, or all of them as arrays.

    Order of calls, with those of FMI 3.0 that each makes:

    1. `Motor(fmu, …)`: instantiate, enterConfigurationMode, setUInt64 of the sizes and
       exitConfigurationMode where motors are arrays, setFloat64 of the parameters,
       enterInitializationMode, exitInitializationMode. The time is 0 s.
    2. For each communication step: `restart(runs)` where motors of arrays begin again (setInt64),
       `set` of the inputs (setFloat64), `step(time_s, step_s)` from the time that the step before
       ended at (doStep), `get` of the outputs (getFloat64).
    3. Between steps at any time: `get_state` and `set_state`.
    4. `close`: terminate, freeInstance; also when the object is collected. No call after it, nor
       after an FmuError but `close`, which calls what the standard allows then.

    Values of arrays stand one signal after the other. Every method raises an FmuError that names
    the instance and the simulated time, in s, where the FMU refuses a call.

    Attributes:
        slave: fmpy's FMU3Slave, for drivers that step through Python.
        address, functions: of the instance and the binary, for drivers that step compiled.
        log: what the FMU has reported last, oldest first.
    """

    def __init__(
        self,
        fmu: MotorFmu,
        name: str,
        parameters: Mapping[str, float] | None = None,
        motors: int = 1,
        sampling: tuple[int, float] | None = None,
    ) -> None:
        """Load and initialise an instance.

        Args:
            motors: how many it shall have; more than one where they are arrays.
            sampling: samples that a step shall return: their number, and the s between two.
        """
        self.fmu, self.name, self._motors = fmu, name, motors
        self.log: deque[str] = deque(maxlen=_MESSAGES)
        values = {fmu.parameter(each): value for each, value in (parameters or {}).items()}
        self.slave: Any = None
        try:
            self.slave = slave = fmu.load(name, self.log)
            if fmu.size is not None:
                sizes = {fmu.size: motors}
                if sampling:
                    sizes[fmu.variables[SAMPLES].valueReference] = sampling[0]
                slave.enterConfigurationMode()
                slave.setUInt64([*sizes], [*sizes.values()])
                slave.exitConfigurationMode()
            if sampling and sampling[1] < (fmu.internal_step_s or 0.0):
                slave.setFloat64([fmu.variables[STEP_SIZE].valueReference], [sampling[1]])
            if fmu.closed_loop is not None:
                slave.setBoolean([fmu.closed_loop], [False])
            for reference, value in values.items():
                slave.setFloat64([reference], [value] * motors)
            slave.enterInitializationMode()
            slave.exitInitializationMode()
        except Exception as error:  # fmpy raises plain Exceptions
            tool = " without its tool" if fmu.interface.needsExecutionTool else ""
            what = f"cannot be initialised{tool} ({error})"
            raise self.error(0.0, what, getattr(error, "status", FMI_ERROR)) from error
        self._finalizer = weakref.finalize(self, _end, slave)
        dll = slave.dll
        functions = dll.fmi3SetFloat64, dll.fmi3DoStep, dll.fmi3GetFloat64
        addresses = (ctypes.cast(function, ctypes.c_void_p).value or 0 for function in functions)
        self.functions, self.address = Addresses(*addresses), int(slave.component)

    def set(self, references: Any, values: Any, time_s: float = 0.0) -> None:
        """Set Float64 variables by their value references."""
        with self._errors_at(time_s, "refuses values"):
            self.slave.setFloat64(references, values)

    def get(self, references: Any, time_s: float = 0.0) -> list[float]:
        """Return the values of Float64 variables by their value references."""
        with self._errors_at(time_s, "does not return values"):
            return self.slave.getFloat64(references, self._motors * len(references))

    def restart(self, runs: np.ndarray) -> None:
        """Restart motors of arrays where the number of a run, (motors,) int64, has changed."""
        with self._errors_at(0.0, "refuses to restart motors"):
            reference = self.fmu.variables[RESTART].valueReference
            self.slave.setInt64([reference], runs.tolist())

    def step(self, time_s: float, step_s: float) -> None:
        """Step from a time over some time."""
        with self._errors_at(time_s, "failed"):
            _, terminate, early_return, _ = self.slave.doStep(time_s, step_s)
        if terminate or early_return:
            raise self.error(time_s, "asked to stop")

    def get_state(self) -> bytes:
        """Return the state of the instance, serialised through FMI."""
        can = self.fmu.interface
        if not (can.canGetAndSetFMUstate and can.canSerializeFMUstate):
            raise self.fmu.refusal(
                "cannot save its state, which copies and saved states of a co-simulation need; "
                "export it with canGetAndSetFMUState and canSerializeFMUState"
            )
        with self._errors_at(0.0, "does not save its state"):
            state = self.slave.getFMUState()
            try:
                return self.slave.serializeFMUState(state)
            finally:
                self.slave.freeFMUState(state)

    def set_state(self, saved: bytes) -> None:
        """Restore a state from `get_state`, of this or of another instance of the FMU."""
        with self._errors_at(0.0, "does not restore its state"):
            state = self.slave.deserializeFMUState(saved)
            try:
                self.slave.setFMUState(state)
            finally:
                self.slave.freeFMUState(state)

    @contextlib.contextmanager
    def _errors_at(self, time_s: float, what: str) -> Iterator[None]:
        try:
            yield
        except FMICallException as error:
            what = f"{what} (fmi3Status {error.status})"
            raise self.error(time_s, what, error.status) from error

    def error(self, time_s: float, what: str, status: int = FMI_ERROR) -> FmuError:
        """The error with the instance, which failed, the time, and the FMU's last message."""
        if self.slave is not None:
            self.slave.failed = True
            self.slave.loaded.fatal |= status >= FMI_FATAL
        last = f": {self.log[-1]}" if self.log else ""
        return FmuError(
            f"FMU {self.fmu.path.name}, instance {self.name}, at {time_s:.5f} s {what}{last}"
        )

    def close(self) -> None:
        """Free the instance; further calls are errors."""
        self._finalizer()


def with_motor(config: CoSimConfig, motor_fmu: Path) -> CoSimConfig:
    """Return a configuration with the parameters that a motor FMU reports.

    What the configuration says of motors other than Table II, and its `motor_parameters`, are set
    first. A parameter that the FMU does not expose is unknown; the body has the configuration's
    value of those in Eq. (3). The built-in FMU has the configuration's values.
    """
    if built_in_model(motor_fmu) or config.motor_fmu:
        return config
    motor, name = config.motor._asdict(), f"motor FMU {motor_fmu.name}"
    given = {name: value for name, value in motor.items() if value != getattr(TABLE_II, name)}
    given |= dict(config.motor_parameters)
    found = MotorFmu(motor_fmu).read(MotorParams._fields, given)
    sources = dict(config.sources)
    tree = {n: (v, sources.get(n, GIVEN) if n in given else name) for n, v in found.items()}
    # A parameter that is not exposed keeps its value, in the body.
    body: dict[str, str] = dict.fromkeys(_OF_BODY, f"{UNKNOWN}: that of the body is assumed")
    tree |= {n: (v, body.get(n, UNKNOWN)) for n, v in motor.items() if n not in found}
    robot, read = config.robot, config.motor._replace(**found)
    share = lift_off_speed(robot, read) / lift_off_speed(robot, config.motor)
    tree |= proportional(config.steering, share)
    of_fmu = {"motor_parameters": tuple(given.items()), "motor_fmu": digest_of(motor_fmu)}
    try:
        config = replace(config.merged(tree), **of_fmu)
    except ConfigError as error:
        raise FmuError(f"{name}: {error}") from None
    unknown = [n for n, text in config.sources if text.startswith(UNKNOWN)]
    lacking = [n for n in unknown if n in ("K_T", "R", "b", "c")]
    if lacking and "motors" in config.open_loop:
        raise ConfigError(
            f"the motor FMU does not expose {', '.join(lacking)}, which --open-loop motors needs; "
            "export it with them"
        )
    return config

"""One running FMU of a system, reached through fmpy outside of steps: start, modes, states, end."""

import ctypes
import math
import weakref
from collections.abc import Callable, Iterable, Sequence
from operator import index
from typing import Any, NamedTuple

import numpy as np
from fmpy.model_description import ModelVariable

from cosim.base.errors import UserError
from cosim.fmi.abi import FMI_ERROR
from cosim.fmi.fmu import (
    Fmu,
    FmuError,
    Log,
    LogLevel,
    end,
    fault_of,
    free,
    function_address,
    status_of,
)
from cosim.system.graph import DTYPES, Component, GraphError, find, ticking_clocks
from cosim.system.integration import UPDATE, Integration, c_function, settled
from cosim.system.texts import TextTable

_ABLE = ("parameter", "input", "structuralParameter")
_TRUTHS = {"true": True, "1": True, "false": False, "0": False}


class Exchange(NamedTuple):
    """Functions that exchange values of an FMI type.

    Attributes:
        function: what the names of getter and setter end in.
        dtype: of a value in memory, as numpy names it.
    """

    function: str
    dtype: str


_KINDS = {
    2: {
        "Real": Exchange("Real", "f8"),
        "Integer": Exchange("Integer", "i4"),
        "Boolean": Exchange("Boolean", "i4"),
        "Enumeration": Exchange("Integer", "i4"),
        "String": Exchange("String", "i8"),  # by their numbers
    },
    3: {
        **{name: Exchange(name, dtype) for name, dtype in DTYPES.items()},
        "Boolean": Exchange("Boolean", "u1"),
        "Enumeration": Exchange("Int64", "i8"),
        "String": Exchange("String", "i8"),
    },
}


class Instance:
    """An instance of a component's FMU, freed with this object or by `close`.

    Attributes:
        name: of the component.
        fmu: of which it is.
        log: what the FMU has reported last, oldest first.
        handle: its address.
        integration: its solver, if it is for Model Exchange.
        functions: of Python, that compiled code calls.
        events: whether it leaves events to the master.
        ends: whether it has asked to end at the start or at a tick of a clock.

    Raises:
        GraphError: a start value is of no variable that can have one, or does not fit it.
        FmuError: the FMU does not load, or refuses a start value.
    """

    def __init__(
        self,
        component: Component,
        fmu: Fmu,
        *,
        events: bool = False,
        fmu_log: LogLevel = "warnings",
        solver_tolerance: float = 1e-8,
    ) -> None:
        self.name, self.fmu = component.name, fmu
        self.log = Log(fmu_log, self.name)
        leaves = fmu.standard == 3 and bool(fmu.interface.hasEventMode)
        self.events = fmu.exchange or (leaves and (events or bool(ticking_clocks(fmu))))
        self._on_event: Callable[[float], None] = lambda time_s: None
        self._start = {name: self._checked(name) for name in component.start}
        self._values = component.start
        self.ends = False
        self._slave: Any = None
        try:
            self._slave = fmu.load(self.name, self.log, events=self.events)
        except Exception as error:  # fmpy raises plain Exceptions
            tool = " without its tool" if fmu.interface.needsExecutionTool else ""
            raise self._failed(f"does not load{tool}", error) from error
        self._finalizer = weakref.finalize(self, free, self._slave)
        self.handle = int(self._slave.component)
        self.integration = None
        if fmu.exchange:
            self.integration = Integration(fmu, self._slave, self.log, solver_tolerance)
        self.functions = self.integration.functions if self.integration else {}
        sizes = [v for v in self._start.values() if v.causality == "structuralParameter"]
        if sizes:
            self.call("enterConfigurationMode")
            self._set(sizes)
            self.call("exitConfigurationMode")
        self._set(v for v in self._start.values() if v.causality != "structuralParameter")

    def kind(self, variable: ModelVariable) -> Exchange | None:
        """Return how a variable's values are exchanged; None if they are not (binary, clocks)."""
        return _KINDS[self.fmu.standard].get(str(variable.type))

    def shape(self, variable: ModelVariable) -> tuple[int, ...]:
        """Dimensions of a variable, () of a scalar."""
        return tuple(
            int(d.start if d.variable is None else self._size(d.variable))
            for d in variable.dimensions
        )

    def _size(self, parameter: ModelVariable) -> int:
        return int(self._values.get(str(parameter.name), parameter.start))

    def read(self, variable: ModelVariable) -> np.ndarray:
        """Return the values that a variable has now, in the order of memory."""
        kind = self.kind(variable)
        assert kind is not None
        get = getattr(self._slave, f"get{kind.function}")
        number = () if self.fmu.standard == 2 else (int(np.prod(self.shape(variable))),)
        return np.array(get([variable.valueReference], *number))

    def begin(self, start_s: float, stop_s: float | None, tolerance: float | None) -> None:
        """Enter Initialization Mode; raises FmuError."""
        self._start_s = start_s
        given = tolerance, start_s, stop_s
        if self.fmu.standard == 2:
            self.call("setupExperiment", *given)
            self.call("enterInitializationMode")
        else:
            self.call("enterInitializationMode", *given)

    def end_initialization(self) -> None:
        """Be ready for steps; raises FmuError."""
        self.call("exitInitializationMode")
        self._finalizer.detach()
        self._finalizer = weakref.finalize(self, end, self._slave)
        if self.integration:
            self.ends = self.call(self.integration.start, self._start_s)
        elif self.events:
            self.ends = self.settle(self._start_s)
            self.call("enterStepMode")

    def listen(self, on_event: Callable[[float], None]) -> None:
        """Have a function called with the time in s in every Event Mode, before it is left."""
        self._on_event = on_event
        if self.integration:
            self.integration.on_event = on_event
        else:
            self.functions["UpdateDiscreteStates"] = c_function(self.log, self._update, *UPDATE)

    def _update(self, again: Any, ends: Any, *_: Any) -> None:
        again[0], ends[0] = self._slave.updateDiscreteStates()[:2]
        if not again[0]:
            clock = [v.valueReference for v in self.fmu.variables.values()
                     if v.causality == "independent"]  # fmt: skip
            self._on_event(self._slave.getFloat64(clock)[0])

    def settle(self, time_s: float) -> bool:
        """Update discrete states in Event Mode until they stay; returns whether it asks to end.

        Raises:
            FmuError, GraphError: the FMU fails, or what listens refuses what it says.
        """
        if self.integration:
            return self.call(self.integration.settle, time_s=time_s)
        ends, _ = self.call(settled, self._slave, time_s=time_s)
        self._on_event(time_s)
        return ends

    def call(
        self, function: str | Callable[..., Any], *arguments: Any, time_s: float | None = None
    ) -> Any:
        """Call a function of fmpy's, by its name, or another one that calls such.

        Args:
            function: to call.
            arguments: of it.
            time_s: simulated time in s; None during initialisation.

        Raises:
            FmuError: it fails; the message names the component and the time.
        """
        called = getattr(self._slave, function) if isinstance(function, str) else function
        try:
            return called(*arguments)
        except UserError:
            raise
        except Exception as error:
            what = "cannot be initialised" if time_s is None else "fails in Event Mode"
            said = f"{what} ({error})"
            raise self.failure(time_s or 0.0, said, status_of(error)) from error

    def _failed(self, what: str, error: Exception) -> FmuError:
        return self.failure(0.0, f"{what} ({error})", status_of(error))

    def _checked(self, name: str) -> ModelVariable:
        """A variable that may get a start value."""
        variable = self.fmu.variables[find({self.name: self.fmu}, f"{self.name}.{name}")[1]]
        free_to_start = variable.causality in _ABLE or variable.initial in ("exact", "approx")
        if not free_to_start or variable.variability == "constant":
            raise GraphError(
                f"component {self.name}: '{name}' of causality {variable.causality} takes no start "
                "value; set parameters and inputs"
            )
        return variable

    def _set(self, variables: Iterable[ModelVariable]) -> None:
        """Give variables their start values."""
        for variable in variables:
            name = str(variable.name)
            values = self._converted(variable, self._values[name])
            kind = self.kind(variable)
            setter = getattr(self._slave, f"set{kind.function if kind else variable.type}")
            try:
                setter([variable.valueReference], values)
            except Exception as error:
                raise self._failed(f"refuses the start value of {name}", error) from error

    def _converted(self, variable: ModelVariable, value: Any) -> list[Any]:
        """Values in the order of memory."""
        kind, shape = str(variable.type), self.shape(variable)
        if isinstance(value, str):
            values = value.split() if shape and kind != "String" else [value]
        else:
            values = np.ravel(value).tolist()
        said = f"component {self.name}: start value {value!r} of '{variable.name}'"
        if len(values) != (size := int(np.prod(shape))):
            raise GraphError(f"{said} has {len(values)} values; give it {size}")
        if kind in ("Binary", "Clock"):
            raise GraphError(f"{said}: values of type {kind} cannot be set; leave it out")
        try:
            if kind == "String":
                return [str(each) for each in values]
            if kind == "Boolean":
                return [_TRUTHS[str(each).lower()] for each in values]
            if kind.startswith(("Float", "Real")):
                found = [float(each) for each in values]
            else:
                items = variable.declaredType.items if variable.declaredType else []
                named = {item.name: int(str(item.value)) for item in items}
                found = [
                    named[v] if v in named else int(v) if isinstance(v, str) else index(v)
                    for v in values
                ]
        except (ValueError, KeyError, TypeError) as error:
            raise GraphError(f"{said} is not of type {kind}; correct it") from error
        least, most = self._limits(variable)
        if not all(least <= each <= most for each in found):  # neither holds of what is no number
            raise GraphError(f"{said} is out of range; use {least:.17g} to {most:.17g}")
        return found

    def _limits(self, variable: ModelVariable) -> tuple[float, float]:
        """Least and largest value of a numeric variable: of its type, and declared."""
        kind = self.kind(variable)
        assert kind is not None
        dtype = np.dtype(kind.dtype)
        least, most = -math.inf, math.inf
        if dtype.kind != "f":
            least, most = (int(k) for k in (np.iinfo(dtype).min, np.iinfo(dtype).max))
        elif dtype.itemsize == 4:
            most = float(np.finfo(dtype).max)
            least = -most
        read = float if dtype.kind == "f" else int
        if variable.declaredType and variable.declaredType.items:
            items = [int(str(item.value)) for item in variable.declaredType.items]
            return min(items), max(items)
        for declared in (variable, variable.declaredType):
            if declared is not None:
                least = max(least, least if declared.min is None else read(declared.min))
                most = min(most, most if declared.max is None else read(declared.max))
        return least, most

    def address(self, function: str) -> int:
        """Address of a C function, given without the prefix of its standard; 0 if there is none."""
        found = getattr(self._slave.dll, f"fmi{self.fmu.standard}{function}", None)
        found = self.functions.get(function, found)
        return 0 if found is None else function_address(found)

    def text_address(
        self, verb: str, names: Sequence[str], block: np.ndarray, texts: TextTable
    ) -> int:
        """Return the address of a C function that gets or sets texts, by their numbers in `block`.

        Args:
            verb: "Get" or "Set".
            names: of the variables.
            block: (n,) int64, numbers of their texts.
            texts: by number.
        """
        references = [self.fmu.variables[name].valueReference for name in names]
        number = () if self.fmu.standard == 2 else (len(block),)

        def get(*_: Any) -> None:
            block[:] = [texts.number(t) for t in self._slave.getString(references, *number)]

        def put(*_: Any) -> None:
            self._slave.setString(references, [texts.known[k] for k in block])

        form = (ctypes.c_void_p, ctypes.c_size_t, ctypes.c_void_p, *[ctypes.c_size_t] * len(number))
        function = c_function(self.log, get if verb == "Get" else put, *form)
        self.functions[f"{verb}String {names}"] = function
        return function_address(function)

    def free_state(self, state: int) -> None:
        """Free a saved state, unless the FMU has failed."""
        if fault_of(self._slave) < FMI_ERROR:
            self._slave.freeFMUState(ctypes.c_void_p(state))

    def failure(self, time_s: float, what: str, status: int = FMI_ERROR) -> FmuError:
        """The error with the failed component, the time, and its last message."""
        return self.fmu.failure(self._slave, self.name, self.log, time_s, what, status)

    def close(self) -> None:
        """End and free it; further calls are errors."""
        self._finalizer()

"""FMUs for Model Exchange, integrated by CVODE so that they step as FMUs for Co-Simulation do.

CVODE comes with fmpy. The compiled master gets addresses of functions here in place of those that
FMUs for Model Exchange do not have.
"""

import math
from collections.abc import Callable
from ctypes import CFUNCTYPE, POINTER, byref, c_bool, c_double, c_int, c_void_p
from functools import partial
from types import SimpleNamespace
from typing import Any

import numpy as np
from fmpy.fmi1 import FMICallException
from fmpy.sundials import CV_ROOT_RETURN, CVode, CVodeSolver, SUNContext_PushErrHandler
from fmpy.sundials.libraries import sundials_core, sundials_cvode

from cosim.fmi.abi import FMI_DISCARD, FMI_OK, FMI_WARNING
from cosim.fmi.fmu import Fmu, Log, status_of

_MOST_UPDATES = 10_000  # of discrete states at one point of time, and events in one step
_NEAR = 1e-9  # share of a step of the master by which an event may come after its end
_ONE_STEP = 2  # CV_ONE_STEP
_FLAG = POINTER(c_bool)
UPDATE = (*[_FLAG] * 5, POINTER(c_double))  # of UpdateDiscreteStates
sundials_cvode.CVodeSetStopTime.argtypes = (c_void_p, c_double)
sundials_cvode.CVodeSetMaxHnilWarns.argtypes = (c_void_p, c_int)


def settled(slave: Any) -> tuple[bool, float]:
    """Update discrete states until they stay; returns if it ends, and the next event's time."""
    update = getattr(slave, "updateDiscreteStates", None) or slave.newDiscreteStates
    for _ in range(_MOST_UPDATES):
        again, ends, _, _, defined, time_s = update()
        if ends or not again:
            return ends, time_s if defined else math.inf
    raise RuntimeError(f"it requests more than {_MOST_UPDATES} updates of its states")


def c_function(log: Log, function: Callable[..., Any], *form: Any) -> Any:
    """Return a C function of an instance; its failures become a status and a message.

    Args:
        log: of the instance; gets the message.
        function: that is called without the instance.
        form: types of its arguments.
    """

    def call(_instance: int, *arguments: Any) -> int:
        warning = log.warning
        try:
            function(*arguments)
        except Exception as error:
            log.append(": ".join([str(error).rstrip("."), *list(log)[-1:]]))
            return status_of(error)
        return FMI_OK if log.warning is warning else FMI_WARNING

    return CFUNCTYPE(c_int, c_void_p, *form)(call)


class Integration:
    """Solver of an instance for Model Exchange.

    Attributes:
        functions: C functions by their names in FMI 3.0 for Co-Simulation.
        inputs: bytes of the values that are set; a change of them restarts the solver.
        on_event: gets the time in s at the end of every Event Mode.
    """

    def __init__(self, fmu: Fmu, slave: Any, log: Log, tolerance: float) -> None:
        self._fmu, self._slave, self._tolerance = fmu, slave, tolerance
        self.inputs, self._given = np.empty(0, dtype=np.uint8), b""
        step = (c_double, c_double, c_bool, _FLAG, _FLAG, _FLAG, POINTER(c_double))
        self.functions = {
            "DoStep": c_function(log, self._do_step, *step),
            "UpdateDiscreteStates": c_function(log, self._update, *UPDATE),
            "GetFMUState": c_function(log, self._save, POINTER(c_void_p)),
            "SetFMUState": c_function(log, self._restore, c_void_p),
        }
        described = fmu.description.modelExchange
        self._completes = bool(described and described.needsCompletedIntegratorStep)
        self._time_s, self._next_event_s = 0.0, math.inf
        self._saved: dict[int, tuple[float, float]] = {}  # both, by saved states
        self._fresh = True  # whether the solver knows the present states
        self.on_event: Callable[[float], None] = lambda time_s: None

    def start(self, start_s: float) -> bool:
        """Begin after Initialization Mode; returns whether the FMU asks to end."""
        self._time_s, slave, described = start_s, self._slave, self._fmu.description
        if self.settle():
            return True
        slave.enterContinuousTimeMode()
        sizes = described.numberOfContinuousStates, described.numberOfEventIndicators
        derivatives = slave.getDerivatives if self._fmu.standard == 2 else None
        if derivatives is None:
            sizes = slave.getNumberOfContinuousStates(), slave.getNumberOfEventIndicators()
            derivatives = slave.getContinuousStateDerivatives
        self._solver = _Solver(
            *sizes, slave.getContinuousStates, slave.setContinuousStates, derivatives,
            slave.getEventIndicators, slave.getNominalsOfContinuousStates, slave.setTime,
            SimpleNamespace(apply=lambda _: None), start_s, relativeTolerance=self._tolerance,
        )  # fmt: skip
        return False

    def _do_step(
        self, begin_s: float, step_s: float, final: bool, _event: Any, ends: Any, *_rest: Any
    ) -> None:
        """Integrate over a step of the master, with all events in it and at its end."""
        end_s, slack_s = begin_s + step_s, _NEAR * step_s
        if (given := self.inputs.tobytes()) != self._given:
            self._given, self._fresh = given, False
        for _ in range(_MOST_UPDATES):
            until_s = min(end_s, self._next_event_s)
            event, ends[0] = self._integrate(until_s, slack_s, final)
            if self._next_event_s <= self._time_s + slack_s:
                event, self._time_s = True, self._next_event_s
                self._slave.setTime(self._time_s)
            if ends[0] or not event:
                return
            self._slave.enterEventMode()
            ends[0] = self.settle()
            if ends[0]:
                return
            self._slave.enterContinuousTimeMode()
        raise RuntimeError(f"it has more than {_MOST_UPDATES} events in a step")

    def _integrate(self, until_s: float, slack_s: float, final: bool) -> tuple[bool, bool]:
        """Integrate to a time, or an event before it; returns if there is one, and if it ends."""
        slave, solver = self._slave, self._solver
        if not self._fresh:
            slave.setTime(self._time_s)
            solver.reset(self._time_s)
            self._fresh = True
        sundials_cvode.CVodeSetStopTime(solver.cvode_mem, until_s)
        ends = False
        while until_s - self._time_s > slack_s:
            event, time_s = solver.advance(until_s)
            if not time_s > self._time_s:
                raise RuntimeError(f"the solver makes no progress at {time_s:.9g} s")
            self._time_s = time_s
            slave.setTime(time_s)
            if self._completes:
                wanted, ends = slave.completedIntegratorStep(final)
                event |= wanted
            if event or ends:
                return event, ends
        return False, False

    def settle(self) -> bool:
        """Update discrete states in Event Mode; returns whether the FMU asks to end."""
        self._fresh = False
        ends, self._next_event_s = settled(self._slave)
        self.on_event(self._time_s)
        return ends

    def _update(self, _again: Any, ends: Any, *_: Any) -> None:
        ends[0] = self.settle()

    def _save(self, place: Any) -> None:
        self._call_state("Get", place)
        self._saved[place[0]] = self._time_s, self._next_event_s

    def _restore(self, state: int) -> None:
        self._call_state("Set", c_void_p(state))
        self._time_s, self._next_event_s = self._saved[state]
        self._fresh = False

    def _call_state(self, verb: str, argument: Any) -> None:
        name = f"fmi{self._fmu.standard}{verb}FMU{'State' if self._fmu.standard == 3 else 'state'}"
        getattr(self._slave, name)(self._slave.component, argument)


class _Solver(CVodeSolver):
    """CVODE that makes one step at a time, and raises what the FMU's functions raise in it."""

    error: Exception | None = None

    def __init__(self, *arguments: Any, **options: Any) -> None:
        for name in ("f", "g"):  # derivatives and event indicators, which CVODE calls
            setattr(self, name, partial(self._guarded, getattr(self, name)))
        super().__init__(*arguments, **options)
        sundials_core.SUNContext_ClearErrHandlers(self.sunctx)  # which print
        sundials_cvode.CVodeSetMaxHnilWarns(self.cvode_mem, -1)  # never: it prints
        SUNContext_PushErrHandler(self.sunctx, self.ehfun_, None)

    def _guarded(self, function: Callable[..., int], *arguments: Any) -> int:
        try:
            return function(*arguments)
        except Exception as error:
            self.error = error
            discards = isinstance(error, FMICallException) and error.status == FMI_DISCARD
            return 1 if discards else -1  # 1: a shorter step may do

    def advance(self, until_s: float) -> tuple[bool, float]:
        """Make a step; returns whether a state event ends it, and the time in s."""
        reached, self.error = c_double(), None
        flag = CVode(self.cvode_mem, until_s, self.x, byref(reached), _ONE_STEP)
        if flag < 0:
            function, message = (self.error_info or ("", "CVode", "", f"flag {flag}"))[1::2]
            raise self.error or RuntimeError(f"{function} cannot integrate it: {message}")
        if not self.discrete:
            self.set_x(self.px, self.nx)
        return flag == CV_ROOT_RETURN, reached.value

"""FMUs for Model Exchange, integrated by CVODE so that they step as FMUs for Co-Simulation do.

CVODE comes with fmpy. The compiled master gets the addresses of the functions here in place of
those that FMUs for Model Exchange do not have.
"""

import ctypes
import math
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
from fmpy.fmi1 import FMICallException
from fmpy.sundials import CV_ROOT_RETURN, CVode, CVodeSolver, SUNContext_PushErrHandler
from fmpy.sundials.libraries import sundials_core, sundials_cvode

from cosim.fmi.abi import FMI_DISCARD, FMI_ERROR, FMI_OK, FMI_WARNING
from cosim.fmi.fmu import Fmu, Log, status_of

_MOST_UPDATES = 10_000  # of discrete states at one point of time, and events in one step
_NEAR = 1e-9  # share of a step of the master by which an event may come after its end
_ONE_STEP = 2  # CV_ONE_STEP
_ADDRESS, _FLAG, _PLACE = ctypes.c_void_p, ctypes.POINTER(ctypes.c_bool), ctypes.c_void_p
_TIME = ctypes.POINTER(ctypes.c_double)
_STEP_FORM = (ctypes.c_double, ctypes.c_double, ctypes.c_bool, _FLAG, _FLAG, _FLAG, _TIME)
_CALLS = {
    "DoStep": _STEP_FORM,
    "UpdateDiscreteStates": (*(_FLAG,) * 5, _TIME),
    "GetFMUState": (ctypes.POINTER(_PLACE),),
    "SetFMUState": (_PLACE,),
}  # behind the instance; those of FMI 3.0 stand for those of FMI 2.0, too
_set_stop_time = sundials_cvode.CVodeSetStopTime
_set_stop_time.argtypes = (_ADDRESS, ctypes.c_double)
_warn_of_small_steps = sundials_cvode.CVodeSetMaxHnilWarns
_warn_of_small_steps.argtypes = (_ADDRESS, ctypes.c_int)


def settled(slave: Any) -> tuple[bool, float]:
    """Update discrete states in Event Mode until they stay.

    Returns:
        Whether the FMU asks to end, and the time of its next event in s.

    Raises:
        Exception: it fails, or wants updates for ever.
    """
    update = getattr(slave, "updateDiscreteStates", None) or slave.newDiscreteStates
    for _ in range(_MOST_UPDATES):
        again, ends, _, _, defined, time_s = update()
        if ends or not again:
            return ends, time_s if defined else math.inf
    raise RuntimeError(f"it wants more than {_MOST_UPDATES} updates of its states")


class Integration:
    """Solver of an instance for Model Exchange, and the functions that stand for it.

    Attributes:
        functions: C functions by their names in FMI 3.0 for Co-Simulation.
        inputs: bytes of the values that are set; a change of them restarts the solver.
        failures: what else than failed calls was raised, such as by Ctrl-C.
    """

    def __init__(self, fmu: Fmu, slave: Any, log: Log, tolerance: float) -> None:
        self._fmu, self._slave, self._log, self._tolerance = fmu, slave, log, tolerance
        self.inputs, self._set = np.empty(0, dtype=np.uint8), b""
        self.failures: list[BaseException] = []
        own = (self._do_step, self._update, self._save, self._restore)
        self.functions = {
            name: ctypes.CFUNCTYPE(ctypes.c_int, _ADDRESS, *form)(self._guarded(function))
            for (name, form), function in zip(_CALLS.items(), own, strict=True)
        }
        self._time_s, self._next_event_s = 0.0, math.inf
        self._saved: dict[int, tuple[float, float]] = {}  # both, by saved states
        self._fresh = True  # whether the solver knows the present states

    def start(self, start_s: float) -> bool:
        """Begin after Initialization Mode; returns whether the FMU asks to end."""
        self._time_s = start_s
        ends = self._settle()
        if ends:
            return True
        slave, described = self._slave, self._fmu.description
        slave.enterContinuousTimeMode()
        third = self._fmu.standard == 3
        self._solver = _Solver(
            nx=slave.getNumberOfContinuousStates() if third else described.numberOfContinuousStates,
            nz=slave.getNumberOfEventIndicators() if third else described.numberOfEventIndicators,
            get_x=slave.getContinuousStates,
            set_x=slave.setContinuousStates,
            get_dx=slave.getContinuousStateDerivatives if third else slave.getDerivatives,
            get_z=slave.getEventIndicators,
            get_nominals=slave.getNominalsOfContinuousStates,
            set_time=slave.setTime,
            input=SimpleNamespace(apply=lambda _: None),  # inputs hold
            startTime=start_s,
            relativeTolerance=self._tolerance,
        )
        return False

    def _guarded(self, function: Callable[..., Any]) -> Callable[..., int]:
        """Return a function whose failures become a status and a message."""

        def call(_instance: int, *arguments: Any) -> int:
            warning = self._log.warning
            try:
                function(*arguments)
            except Exception as error:
                said = f": {self._log[-1]}" if self._log else ""
                self._log.append(str(error).rstrip(".") + said)
                return status_of(error)
            except BaseException as error:  # which would be lost on its way out of compiled code
                self.failures.append(error)
                return FMI_ERROR
            return FMI_OK if self._log.warning is warning else FMI_WARNING

        return call

    def _do_step(
        self, begin_s: float, step_s: float, final: bool, _event: Any, ends: Any, *_: Any
    ) -> None:
        """Integrate over a step of the master, with all events in it and at its end."""
        end_s, slack_s = begin_s + step_s, _NEAR * step_s
        if (given := self.inputs.tobytes()) != self._set:
            self._set, self._fresh = given, False
        for _ in range(_MOST_UPDATES):
            until_s = min(end_s, self._next_event_s)
            event, ends[0] = self._integrate(until_s, slack_s, final)
            if self._next_event_s <= self._time_s + slack_s:
                event, self._time_s = True, self._next_event_s
                self._slave.setTime(self._time_s)
            if ends[0] or not event:
                return
            self._slave.enterEventMode()
            ends[0] = self._settle()
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
        interface = self._fmu.description.modelExchange
        _set_stop_time(solver.cvode_mem, until_s)
        while until_s - self._time_s > slack_s:
            event, time_s = solver.advance(until_s)
            if not time_s > self._time_s:
                raise RuntimeError(f"the solver makes no progress at {time_s:.9g} s")
            self._time_s = time_s
            slave.setTime(self._time_s)
            if interface.needsCompletedIntegratorStep:
                wanted, ends = slave.completedIntegratorStep(final)
                if wanted or ends:
                    return wanted, ends
            if event:
                return True, False
        return False, False

    def _settle(self) -> bool:
        """Update discrete states; returns whether the FMU asks to end."""
        self._fresh = False
        ends, self._next_event_s = settled(self._slave)
        return ends

    def _update(self, _again: Any, ends: Any, *_: Any) -> None:
        ends[0] = self._settle()

    def _save(self, place: Any) -> None:
        state = ctypes.c_void_p(place[0])
        self._state_call("Get", ctypes.byref(state))
        place[0] = state.value
        self._saved[state.value or 0] = self._time_s, self._next_event_s

    def _restore(self, state: int) -> None:
        self._state_call("Set", ctypes.c_void_p(state))
        self._time_s, self._next_event_s = self._saved[state]
        self._fresh = False

    def _state_call(self, verb: str, argument: Any) -> None:
        standard = self._fmu.standard
        name = f"fmi{standard}{verb}FMU{'State' if standard == 3 else 'state'}"
        getattr(self._slave, name)(self._slave.component, argument)


class _Solver(CVodeSolver):
    """CVODE that makes one step at a time, and raises what the FMU's functions raise in it."""

    error: BaseException | None = None

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        sundials_core.SUNContext_ClearErrHandlers(self.sunctx)  # which print
        _warn_of_small_steps(self.cvode_mem, -1)  # never: it prints
        SUNContext_PushErrHandler(self.sunctx, self.ehfun_, None)

    def f(self, *arguments: Any) -> int:
        """Derivatives; see fmpy."""
        return self._guarded(super().f, *arguments)

    def g(self, *arguments: Any) -> int:
        """Event indicators; see fmpy."""
        return self._guarded(super().g, *arguments)

    def _guarded(self, function: Callable[..., int], *arguments: Any) -> int:
        try:
            return function(*arguments)
        except BaseException as error:
            self.error = error
            discards = isinstance(error, FMICallException) and error.status == FMI_DISCARD
            return 1 if discards else -1  # 1: a shorter step may do

    def advance(self, until_s: float) -> tuple[bool, float]:
        """Make a step; returns whether a state event ends it, and the time in s."""
        reached = ctypes.c_double()
        self.error = None
        flag = CVode(self.cvode_mem, until_s, self.x, ctypes.byref(reached), _ONE_STEP)
        if flag < 0:
            if self.error is not None:
                raise self.error
            _, function, _, message = self.error_info or (0, "CVode", "", f"flag {flag}")
            raise RuntimeError(f"{function} cannot integrate it: {message}")
        if not self.discrete:
            self.set_x(self.px, self.nx)
        return flag == CV_ROOT_RETURN, reached.value

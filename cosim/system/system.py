"""A system of FMUs that runs: made, initialised, stepped, and freed."""

import ctypes
import math
import time
import weakref
from collections.abc import Mapping, Sequence
from typing import Literal

import numpy as np

from cosim.base.progress import Progress, automatic, showing, silent
from cosim.fmi.abi import FMI_ERROR, FMI_FATAL, FMI_OK
from cosim.fmi.fmu import check_steps, function_address
from cosim.fmi.isolation import calling
from cosim.model.config import whole_ratio
from cosim.system.graph import (
    Component,
    Connection,
    GraphError,
    check_connections,
    exchanges_to_settle,
    find,
    load_fmus,
    outputs,
)
from cosim.system.instance import Instance
from cosim.system.kernels import (
    ENDED,
    GETTING,
    RESTORING,
    SAVING,
    SETTING,
    STEPPING,
    STUCK,
    Scheme,
)
from cosim.system.layout import Layout
from cosim.system.loops import DONE, REJECTED, ROW, TICK, run_adaptive, run_fixed, settle
from cosim.system.run import Share, SystemRun

Algorithm = Literal["jacobi", "gauss-seidel"]
ROWS_AT_ONCE = 4096
_LONGEST = 1 << 40  # ticks of a step, by default: any
_WHAT = {
    SETTING: "refuses its inputs",
    STEPPING: "failed",
    GETTING: "has no outputs",
    SAVING: "cannot save its state",
    RESTORING: "cannot restore its state",
}


class System:
    """A system of FMUs, initialised at its start time; free it by `close` or as a context.

    Attributes:
        time_s: that it has reached.
        steps, rejected: communication steps accepted, and taken back in vain.
    """

    def __init__(
        self,
        components: Sequence[Component],
        connections: Sequence[Connection] = (),
        *,
        algorithm: Algorithm = "jacobi",
        step_s: float = 1e-3,
        tolerance: float | None = None,
        longest_step_s: float | None = None,
        start_s: float = 0.0,
        record: Sequence[str] | None = None,
        event_mode: bool = False,
        profile: bool = False,
    ) -> None:
        """Make the components and initialise them.

        Args:
            components: in the order in which Gauss–Seidel steps them.
            connections: from outputs to inputs.
            algorithm: whether all components step with the outputs of the step before, or each with
                those that stand before it in the list.
            step_s: communication step in s; the shortest one if there is a tolerance.
            tolerance: of the error of one step in Float64 outputs, relative to the larger
                of a value and its nominal one; None for steps that are all equal.
            longest_step_s: with a tolerance, a multiple of `step_s`; by default any.
            start_s: simulated time at which it begins, in s.
            record: "component.variable" of what runs record; by default all outputs but texts.
            event_mode: whether FMUs that can (FMI 3.0, hasEventMode) leave their events to the
                master, and return early to do so.
            profile: whether to measure the time that each component takes.

        Raises:
            GraphError: the system cannot be; the message names component, variable, connection.
            ConfigError: a step is no multiple of another one that it must be a multiple of.
            FmuError: an FMU cannot be used, or fails at the start.
            OSError: an FMU cannot be read.
        """
        _require_positive("step", step_s)
        if tolerance is not None:
            _require_positive("tolerance", tolerance)
        fmus = load_fmus(components)
        links = check_connections(fmus, connections)
        exchanges = exchanges_to_settle(fmus, links)
        needs = "which a tolerance needs; leave the tolerance out" if tolerance else None
        for name, fmu in fmus.items():
            said = f"FMU {fmu.path.name} of component {name}"
            check_steps(fmu.interface, said, ("step", step_s), needs)
        self._recorded = (
            outputs(fmus, "String", "Binary", "Clock", but=True)
            if record is None
            else list(dict.fromkeys(find(fmus, name) for name in record))
        )
        checked = outputs(fmus, "Real", "Float64") if tolerance else []
        longest = _LONGEST
        if longest_step_s is not None:
            _require_positive("longest step", longest_step_s)
            longest = whole_ratio("longest step", longest_step_s, "step", step_s)
        self._scheme = Scheme(
            algorithm == "jacobi",
            start_s,
            step_s,
            tolerance or 0.0,
            longest,
            1,
            _clock() if profile else 0,
            time.CLOCK_MONOTONIC,
        )
        self._now = np.array([0, 1, 0, 0, 0], dtype=np.int64)
        self._over = False
        self._instances: dict[str, Instance] = {}
        try:
            with calling("its initialisation"):
                for component in components:
                    instance = Instance(component, fmus[component.name], events=event_mode)
                    self._instances[component.name] = instance
                self._layout = Layout(self._instances, links, self._recorded, checked)
                self._initialise(exchanges)
        except BaseException:
            self.close()
            raise
        self._finalizer = weakref.finalize(self, _free, self._instances, self._layout.tables.states)

    def _initialise(self, exchanges: int) -> None:
        """Bring the instances to the start."""
        for instance in self._instances.values():
            instance.begin(self._scheme.start_s, self._scheme.tolerance or None)
        layout = self._layout
        for component, name in layout.parts:  # what is not connected of arrays stays as it is
            place, instance = layout.places[component, name], self._instances[component]
            values = instance.read(instance.fmu.variables[name]).astype(place.dtype)
            end = place.offset + place.size
            layout.memory.u1[place.offset : end] = values.view(np.uint8)
        self._check(*settle(layout.tables, layout.memory, exchanges))
        for instance in self._instances.values():
            instance.end_initialization()
        self._check(*settle(layout.tables, layout.memory, 0))
        self._require_numbers(self._now[[TICK]], layout.memory.i8[None])
        self._over = any(instance.ends for instance in self._instances.values())

    @property
    def time_s(self) -> float:
        """Simulated time reached, in s."""
        return self._scheme.start_s + int(self._now[TICK]) * self._scheme.tick_s

    @property
    def steps(self) -> int:
        """Communication steps accepted."""
        return int(self._now[DONE])

    @property
    def rejected(self) -> int:
        """Communication steps that were taken back."""
        return int(self._now[REJECTED])

    @showing
    def run(
        self, until_s: float, *, every: int = 1, progress: Progress | None = automatic
    ) -> SystemRun:
        """Continue to a time; the first row is the present state.

        Args:
            until_s: time to reach, in s: a whole number of steps from the start.
            every: steps from one recorded row to the next; the last step has one, too.
            progress: receives how far the run is; by default it is shown on stderr if the run takes
                more than two seconds. None shows nothing.

        Raises:
            ConfigError: the time is no whole number of steps away.
            FmuError: an FMU failed; the message names it and the time.
        """
        if every < 1:
            raise GraphError(f"every {every} steps: choose 1 or more")
        scheme, layout = self._scheme._replace(every=every), self._layout
        duration_s = until_s - scheme.start_s
        _require_positive("time to run", duration_s)
        until = whole_ratio("time to run to", duration_s, "step", scheme.tick_s)
        if until <= self._now[TICK]:
            raise GraphError(f"the system is at {self.time_s:g} s; run it to a later time")
        asked = [name for name, instance in self._instances.items() if instance.ends]
        if self._finalizer.alive and asked and not self.steps:
            row = layout.memory.i8[None, : layout.words].copy()
            return self._result(self._now[[TICK]], row, f"{asked[0]} asked to end at the start")
        if not self._finalizer.alive or self._over:
            raise GraphError("the system has ended, failed or been closed; make it again")
        left = -(-(until - int(self._now[TICK])) // every) + 1
        ticks = [self._now[[TICK]]]
        rows = [layout.memory.i8[None, : layout.words].copy()]
        run = run_adaptive if scheme.tolerance else run_fixed
        status, component = FMI_OK, 0
        while self._now[TICK] < until and status == FMI_OK:
            self._now[ROW] = 0
            size = min(left, ROWS_AT_ONCE)
            room = np.empty(size, dtype=np.int64), np.empty((size, layout.words), dtype=np.int64)
            with calling(f"what begins at {self.time_s:g} s of simulated time"):
                found = run(layout.tables, layout.memory, scheme, self._now, until, *room)
            status, component, _ = found
            self._over = status != FMI_OK
            self._check(*found)
            self._require_numbers(*(part[: self._now[ROW]] for part in room))
            self._require_numbers(self._now[[TICK]], layout.memory.i8[None])  # recorded or not
            ticks.append(room[0][: self._now[ROW]])
            rows.append(room[1][: self._now[ROW]])
            (progress or silent)("simulating", self.time_s - scheme.start_s, duration_s)
        ended = None
        if status == ENDED:
            ended = f"{list(self._instances)[component]} asked to end at {self.time_s:g} s"
        return self._result(np.concatenate(ticks), np.concatenate(rows), ended)

    def _result(self, ticks: np.ndarray, rows: np.ndarray, ended: str | None) -> SystemRun:
        block = rows.view(np.uint8)
        signals = {".".join(n): self._layout.places[n].read(block) for n in self._recorded}
        counts = self._layout.tables.counts
        profile = {
            name: Share(int(steps), int(rollbacks), 1e-9 * int(ns))
            for name, (steps, rollbacks, ns) in zip(self._instances, counts, strict=True)
        }
        time_s = self._scheme.start_s + ticks * self._scheme.tick_s
        return SystemRun(time_s, signals, ended, profile)

    def _require_numbers(self, ticks: np.ndarray, rows: np.ndarray) -> None:
        """Raise the FmuError of the first row (words of the block) with an output that is NaN."""
        found: list[tuple[int, str, str]] = []
        for (component, name), place in self._layout.places.items():
            within = place.offset + place.size <= 8 * rows.shape[1]
            if "f" in place.dtype and within and place.offset < 8 * self._layout.words:
                wrong = np.isnan(place.read(rows.view(np.uint8))).reshape(len(rows), -1).any(axis=1)
                if wrong.any():
                    found.append((int(np.argmax(wrong)), component, name))
        if found:
            row, component, name = min(found, key=lambda each: each[0])
            self._over = True
            time_s = self._scheme.start_s + int(ticks[row]) * self._scheme.tick_s
            raise self._instances[component].failure(time_s, f"puts out nan ({name})")

    def _check(self, status: int, component: int, phase: int) -> None:
        """Raise the FmuError of a failed call."""
        if status in (FMI_OK, ENDED):
            return
        instance = list(self._instances.values())[component]
        said = f"{_WHAT[phase]} (fmi{instance.fmu.standard}Status {status})"
        what = "returned early for ever" if status == STUCK else said
        raise instance.failure(self.time_s, what, status if status <= FMI_FATAL else FMI_ERROR)

    @calling("its end")
    def close(self) -> None:
        """Free all instances; further calls are errors."""
        if hasattr(self, "_finalizer"):
            self._finalizer()
        else:
            _free(self._instances, None)

    def __enter__(self) -> "System":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _free(instances: Mapping[str, Instance], states: np.ndarray | None) -> None:
    for k, instance in enumerate(instances.values()):
        if states is not None and states[k]:
            instance.free_state(int(states[k]))
        instance.close()


def _require_positive(name: str, value: float) -> None:
    if not 0.0 < value < math.inf:
        raise GraphError(f"{name} {value:g}: choose one above 0")


def _clock() -> int:
    """Address of the function that tells the time."""
    return function_address(ctypes.CDLL(None).clock_gettime)

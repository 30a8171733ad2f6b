"""Clocks of FMI 3.0 that tick in time: when they do, and the Event Mode in which they do.

Points of time are fractions, in ticks of the system from its start, so that clocks neither drift
nor miss each other: a decimal number is exactly what its shortest text says.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from ctypes import byref, c_double, c_int, c_uint32, c_uint64
from fractions import Fraction
from functools import partial
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np

from cosim.base.jit import kernel
from cosim.fmi.abi import FMI_OK, FMI_WARNING
from cosim.fmi.fmu import Fmu, FmuError
from cosim.system.coupling import ENDING, START, Coupling, Z, begin, settle
from cosim.system.exchange import copy, exchange_values, feed
from cosim.system.graph import GraphError, ticking_clocks
from cosim.system.instance import Instance
from cosim.system.layout import Layout, Memory, Tables
from cosim.system.step import ALGORITHM, PHASE, STATUS, Scheme
from cosim.system.stepping import DONE, ROW, TICK

_NEAR = Fraction(1, 10**9)  # ticks of the system within which points of time are one
_MOST_TICKS = 1000  # of clocks at one point of time
_UNCHANGED, _CHANGED = 1, 2  # of fmi3IntervalQualifier
Found = tuple[int, int, int]  # what `advance` returns


class _Clock:
    """A clock of an instance.

    Attributes:
        instance: that it belongs to.
        name, kind, reference: of its variable; kind is its intervalVariability.
        asked: whether the FMU is asked for its interval in Event Mode.
        interval: in ticks, from one activation to the next one.
        next: when it ticks, infinite if that is not known.
    """

    def __init__(self, instance: Instance, element: Element, tick_s: Fraction) -> None:
        self.instance, self._tick_s = instance, tick_s
        self.name, self.kind = element.get("name", ""), element.get("intervalVariability", "")
        self.reference = int(element.get("valueReference", ""))
        self._periodic = self.kind in ("constant", "fixed", "tunable")
        self._form = "Fraction" if element.get("supportsFraction") in ("true", "1") else "Decimal"
        try:
            self._declared = {what: _declared(element, what) for what in ("interval", "shift")}
        except (ValueError, ZeroDivisionError) as error:
            raise GraphError(
                f"component {instance.name}: clock '{self.name}' ({self.kind}) declares an "
                f"interval or a shift that is not a number ({error}); export it with finite ones"
            ) from error
        self.asked = self._declared["interval"] is None and self.kind not in ("constant", "fixed")
        self.interval: Fraction = Fraction(0)
        self.next: Fraction | float = math.inf

    def _tell(self, what: str, time_s: float | None = None) -> tuple[Fraction, int]:
        """Return the interval or the shift in ticks, declared or read, and its qualifier."""
        value, qualifier = self._declared[what], c_int(_CHANGED)
        if value is None:
            decimal, counter, resolution = c_double(), c_uint64(), c_uint64(1)
            places: list[Any] = [decimal] if self._form == "Decimal" else [counter, resolution]
            places += [qualifier] if what == "interval" else []
            references = (c_uint32 * 1)(self.reference)
            function = f"get{what.title()}{self._form}"
            self.instance.call(function, references, *map(byref, places), time_s=time_s)
            if qualifier.value not in (_UNCHANGED, _CHANGED):  # is not known yet
                return Fraction(0), qualifier.value
            value = Fraction(-1)
            if math.isfinite(decimal.value) and resolution.value:
                value = Fraction(counter.value, resolution.value) + Fraction(str(decimal.value))
        if value < 0 or (value == 0 and self._periodic and what == "interval"):
            raise GraphError(
                f"component {self.instance.name}: clock '{self.name}' ({self.kind}) has a {what} "
                f"of {float(value):g} s or none; export it with a positive one"
            )
        return value / self._tick_s, qualifier.value

    def begin(self) -> None:
        """Learn in Initialization Mode when it ticks first."""
        self.interval, qualifier = self._tell("interval")
        if self._periodic:
            self.next, _ = self._tell("shift")
        elif qualifier in (_UNCHANGED, _CHANGED):
            self.next = self.interval

    def plan(self) -> None:
        """Plan the next tick, as far as it is known before the FMU returns it."""
        self.next += math.inf if self.kind == "countdown" else self.interval

    def update(self, now: Fraction, time_s: float) -> None:
        """Read in Event Mode whether it ticks after another interval from now."""
        interval, qualifier = self._tell("interval", time_s)
        if qualifier == _CHANGED:
            self.interval, self.next = interval, now + interval


def _declared(element: Element, what: str) -> Fraction | None:
    """Return the interval or the shift in s that a modelDescription declares, if any."""
    if counter := element.get(f"{what}Counter"):
        return Fraction(int(counter), int(element.get("resolution", "1")))
    decimal = element.get(f"{what}Decimal", "0" if _is_told(element) else None)
    return None if decimal is None else Fraction(decimal.strip())


def _is_told(element: Element) -> bool:
    """Return whether a modelDescription declares the interval of a clock."""
    return bool(element.get("intervalDecimal") or element.get("intervalCounter"))


def _rounded(time: Fraction) -> Fraction:
    """Return a point of time, or the tick that it is at within rounding."""
    return Fraction(round(time)) if abs(time - round(time)) <= _NEAR else time


def check_clocks(fmus: Mapping[str, Fmu], *, fixed: bool, kept: bool) -> bool:
    """Return whether FMUs have clocks that tick in time.

    Args:
        fmus: by component.
        fixed: whether components have one step, and there are no power bonds.
        kept: whether no step is rolled back.

    Raises:
        GraphError: they have, and it is not so.
    """
    found = [(name, clock) for name, fmu in fmus.items() for clock in ticking_clocks(fmu)]
    for name, clock in found:
        kind = clock.get("intervalVariability")
        said = f"component {name}: clock '{clock.get('name')}' ({kind}) ticks in time"
        if not fixed:
            raise GraphError(f"{said}; leave out steps of components and power bonds")
        if not kept and (kind == "countdown" or (kind == "tunable" and not _is_told(clock))):
            raise GraphError(
                f"{said} and may start in any step, none of which can be rolled back then; "
                "leave the tolerance out, and choose another algorithm than implicit"
            )
    return bool(found)


class Clocks:
    """The clocks of a system that tick in time.

    Attributes:
        now: point of time that is reached; its clocks have ticked.
    """

    def __init__(self, instances: Mapping[str, Instance], start_s: float, tick_s: float) -> None:
        self._instances = instances
        self._start_s, self._tick_s = Fraction(str(start_s)), Fraction(str(tick_s))
        self.now = Fraction(0)
        self._clocks: list[_Clock] = []
        self._at_once = 1 << 40  # steps in which no interval changes
        for instance in instances.values():
            own = [_Clock(instance, each, self._tick_s) for each in ticking_clocks(instance.fmu)]
            self._clocks += own
            asked = [clock for clock in own if clock.asked]
            if asked:
                instance.listen(partial(self._update, asked))
            if any(clock.kind != "changing" for clock in asked):
                self._at_once = 1

    def begin(self) -> None:
        """Learn in Initialization Mode when clocks tick first.

        Raises:
            FmuError, GraphError: an FMU does not tell, or tells no interval that can be.
        """
        for clock in self._clocks:
            clock.begin()

    @property
    def states(self) -> list[Any]:
        """Return the state of the future ticks, which can be restored."""
        return [self.now, *((clock.interval, clock.next) for clock in self._clocks)]

    @states.setter
    def states(self, known: list[Any]) -> None:
        self.now = known[0]
        for clock, state in zip(self._clocks, known[1:], strict=True):
            clock.interval, clock.next = state

    @property
    def time_s(self) -> float:
        """Simulated time reached, in s."""
        return float(self._start_s + self.now * self._tick_s)

    @property
    def _next(self) -> Fraction | float:
        return min(clock.next for clock in self._clocks)

    def _update(self, asked: Sequence[_Clock], time_s: float) -> None:
        """Read intervals in an Event Mode."""
        now = (Fraction(str(time_s)) - self._start_s) / self._tick_s
        for clock in asked:
            clock.update(self.now if abs(now - self.now) <= _NEAR else _rounded(now), time_s)

    def run(
        self, steps: Callable[..., Found], layout: Layout, s: Coupling, scheme: Scheme,
        now: np.ndarray, until: int, ticks: np.ndarray, rows: np.ndarray,
    ) -> Found:  # fmt: skip
        """Make steps as `run_steps` does, where clocks tick in parts, and let those tick.

        Args:
            steps: `run_steps` or `run_plain`.
            layout: of the system.
            s, scheme, now, until, ticks, rows: of `run_steps`.

        Raises:
            FmuError: an FMU fails in Event Mode, or cannot make a part of a step.
            GraphError: a clock was to tick within a step that has been made already, or values in
                Event Mode do not settle.
        """
        block, stop = (layout.tables, layout.memory, s), now[DONE] + scheme.at_once
        whole = scheme._replace(at_once=min(scheme.at_once, self._at_once))
        found: Found = FMI_OK, 0, 0
        while (
            found[0] == FMI_OK and now[TICK] < until and now[ROW] < len(ticks) and now[DONE] < stop
        ):
            tick, end = int(now[TICK]), _rounded(Fraction(min(self._next, until)))
            if self.now == tick and end >= tick + 1:
                end = Fraction(math.floor(end))
                found = steps(*block, whole, now, int(end), ticks, rows)
                self.now = Fraction(int(now[TICK]))
            else:
                end, before = min(end, Fraction(tick + 1)), now.copy()
                found = steps(*block, self._part(scheme, tick, end), now, tick + 1, ticks, rows)
                self.now = end
                if end < tick + 1:
                    now[:] = before
            if found[0] != FMI_OK:
                break
            if now[TICK] == end < until and now[DONE] % scheme.every:
                now[ROW] -= 1  # recorded as if it were the last one
            if self._next < self.now - _NEAR:
                raise GraphError(
                    f"a clock was to tick within the step that ends at {self.time_s:g} s, by an "
                    "interval that began in it; choose a shorter step"
                )
            found = self.tick(layout, s, scheme)
            if now[ROW] and ticks[now[ROW] - 1] == self.now:
                rows[now[ROW] - 1] = layout.memory.i8[: layout.words]
        return found

    def _part(self, scheme: Scheme, tick: int, end: Fraction) -> Scheme:
        """Return the scheme of a step from now to `end` that takes the place of that at `tick`."""
        for name, instance in self._instances.items():
            if not instance.fmu.interface.canHandleVariableCommunicationStepSize:
                raise FmuError(
                    f"a clock ticks within the step at {self.time_s:g} s, but component {name} "
                    "cannot vary its step (canHandleVariableCommunicationStepSize); choose a step "
                    "that divides the intervals of clocks"
                )
        part_s = float((end - self.now) * self._tick_s)
        return scheme._replace(start_s=self.time_s - tick * part_s, tick_s=part_s, tolerance=0.0)

    def tick(self, layout: Layout, s: Coupling, scheme: Scheme) -> Found:
        """Let the clocks tick that do so now, in one Event Mode of their instances; as `advance`.

        Values are passed on until they stay: those of clocked variables with a ticking clock, and
        of all variables without a clock. Then discrete states are updated. Clocks that tick again
        after an interval of 0 follow in the same Event Mode.
        """
        t, m, time_s = layout.tables, layout.memory, self.time_s
        entered: list[Instance] = []
        for _ in range(_MOST_TICKS):
            due = [clock for clock in self._clocks if clock.next <= self.now + _NEAR]
            if not due:
                break
            calls: list[tuple[int, int, int]] = []
            for name, instance in self._instances.items():
                own = {c.name: c.reference for c in due if c.instance is instance}
                if own and instance not in entered:
                    instance.call("enterEventMode", time_s=time_s)
                    entered.append(instance)
                if own:
                    instance.call("setClock", own.values(), [True] * len(own), time_s=time_s)
                    calls += layout.calls_at(name, own.keys())
            rows = np.array(calls, dtype=np.int64)
            status, c, phase = _pass_on(t, m, rows, time_s, scheme.tick_s, scheme.exchanges)
            if status == STATUS.unsettled:
                ticking = ", ".join(f"{clock.instance.name}.{clock.name}" for clock in due)
                raise GraphError(
                    f"at {time_s:g} s values that clocks ({ticking}) pass on do not settle after "
                    f"{scheme.exchanges} exchanges; take a connection out of their loop"
                )
            if status > FMI_WARNING:
                return status, c, phase
            for clock in due:
                clock.plan()
            for instance in entered:
                instance.ends |= instance.settle(time_s)
        else:
            raise GraphError(f"at {time_s:g} s clocks tick more than {_MOST_TICKS} times")
        if not entered:
            return FMI_OK, 0, 0
        for instance in entered:
            usual = "ContinuousTime" if instance.integration else "Step"
            instance.call(f"enter{usual}Mode", time_s=time_s)
        status, c, phase = begin(t, m, s)
        s.flags[ENDING] = -1
        if status <= FMI_WARNING and (scheme.algorithm >= ALGORITHM.extrapolated or len(s.torn)):
            s.unknowns[Z] = m.f8[s.torn]
            status, c, phase = settle(t, m, s, scheme._replace(start_s=time_s))
            s.inputs[START] = m.f8[s.held]  # what values were before tells no slope
        if status > FMI_WARNING:
            return status, c, phase
        instances = list(self._instances.values())
        if s.flags[ENDING] >= 0:
            instances[s.flags[ENDING]].ends = True
        ended = [k for k, instance in enumerate(instances) if instance.ends]
        return (STATUS.ended, ended[0], PHASE.stepping) if ended else (FMI_OK, 0, PHASE.stepping)


@kernel
def _pass_on(
    t: Tables, m: Memory, calls: np.ndarray, time_s: float, tick_s: float, exchanges: int
) -> Found:
    """Pass on values at a point of time until none changes; returns as `advance`.

    `calls` (n, 3) are a component, and first and last + 1 of its setters or getters.
    """
    for _ in range(exchanges):
        before = m.i8.copy()
        copy(t, m, 0, t.copies.shape[0])
        feed(t, m, time_s, 0, 0.0, tick_s)
        for k in range(calls.shape[0]):
            c = calls[k, 0]
            status = exchange_values(t, c, calls[k, 1], calls[k, 2])
            if status > FMI_WARNING:
                return status, c, PHASE.ticking
        if (m.i8 == before).all():
            return FMI_OK, 0, PHASE.ticking
    return STATUS.unsettled, 0, PHASE.ticking

"""One step of a system, compiled: copy, set, step, get.

With Gauss–Seidel every component gets, in their order, what those before it have just put out;
with Jacobi all get the outputs before the step. Methods of second order have inputs in place
already. Time is an integer number of ticks.
"""

import math
from typing import NamedTuple

from cosim.base.jit import inlined
from cosim.fmi.abi import (
    FMI_DISCARD,
    FMI_OK,
    FMI_WARNING,
    ask_status_2,
    change_mode,
    do_step_2,
    do_step_3,
    read_clock,
    update_discrete_states,
)
from cosim.system.exchange import copy, exchange_values, feed, meets
from cosim.system.layout import (
    ASK,
    DISCRETE,
    DO_STEP,
    END_COPY,
    END_GET,
    END_REAL,
    END_SET,
    END_SINGLE,
    ENDS,
    ENTER_EVENTS,
    ENTER_STEPS,
    EVENTS,
    FIRST_COPY,
    FIRST_GET,
    FIRST_REAL,
    FIRST_SET,
    FIRST_SINGLE,
    HANDLE,
    PERIOD,
    STEPS_AS,
    UPDATE,
    Memory,
    Tables,
)

# Beyond every status: asks to end, returns early without an end, puts out NaN; equations of inputs
# that are not solved, values that never stay.
ENDED, STUCK, NOT_A_NUMBER, NO_SOLUTION, UNSETTLED = range(100, 105)
JACOBI, GAUSS_SEIDEL, EXTRAPOLATED, IMPLICIT = range(4)  # algorithms
# What was going on when a call failed.
SETTING, STEPPING, GETTING, SAVING, RESTORING = range(5)
STEPS, ROLLBACKS, NANOSECONDS, WARNINGS = range(4)  # columns of `Tables.counts`
MOST_RETURNS = 100_000  # of an FMU in one step
_LEAST = 1e-12  # share of a step that is no step
_FMI_2_TERMINATED = 3  # of fmi2StatusKind


class Scheme(NamedTuple):
    """Rules by which a system is stepped.

    Attributes:
        algorithm: number of it.
        start_s: time of tick 0.
        tick_s: duration of a tick.
        tolerance: of the error of a step of several ticks, relative to the larger of a value and
            its nominal one; 0 to make every step one tick.
        by_energy: 1 if the error is the residual power of bonds, and no step is taken back.
        longest: ticks of a step.
        every: steps from one recorded row to the next.
        clock: address of clock_gettime to measure with, or 0.
        clock_kind: its argument.
        solves: 1 if algebraic loops are solved, 0 if values pass with a delay.
        exchanges: limit of those at one point of time.
        at_once: limit of steps between two looks at the keyboard.
        loop_tolerance, step_tolerance: of equations at a point of time and over a step, relative
            to the larger of a value and its nominal one.
    """

    algorithm: int
    start_s: float
    tick_s: float
    tolerance: float
    by_energy: int
    longest: int
    every: int
    clock: int
    clock_kind: int
    solves: int
    exchanges: int
    at_once: int
    loop_tolerance: float
    step_tolerance: float


@inlined
def _handle_events(t: Tables, c: int) -> int:
    """Update the discrete states of a component in Event Mode, and go back to Step Mode."""
    room, handle = t.room.ctypes.data, t.components[c, HANDLE]
    ends = 0
    for _ in range(MOST_RETURNS):
        t.room[0] = 0
        places = (room, room + 1, room + 2, room + 3, room + 4, room + 8)
        status = update_discrete_states(t.components[c, UPDATE], (handle, *places))
        if status > FMI_WARNING:
            return status
        ends |= (t.room[0] >> 8) & 0xFF
        if t.room[0] & 0xFF == 0:
            break
    status = change_mode(t.components[c, ENTER_STEPS], (handle,))
    return ENDED if ends and status <= FMI_WARNING else status


@inlined
def set_inputs(t: Tables, c: int) -> int:
    """Set the inputs of a component; discrete ones are an event where it leaves those to us."""
    first, end = t.components[c, FIRST_SET], t.components[c, END_SET]
    if not (t.components[c, EVENTS] and t.components[c, DISCRETE]):
        return exchange_values(t, c, first, end)
    status = change_mode(t.components[c, ENTER_EVENTS], (t.components[c, HANDLE],))
    if status <= FMI_WARNING:
        status = exchange_values(t, c, first, end)
    return _handle_events(t, c) if status <= FMI_WARNING else status


@inlined
def _step(t: Tables, c: int, begin_s: float, step_s: float, final: int) -> int:
    """Step a component, over its events too where it leaves them to us."""
    handle = t.components[c, HANDLE]
    function = t.components[c, DO_STEP]
    if t.components[c, STEPS_AS] == 2:
        t.counts[c, STEPS] += 1
        status = do_step_2(function, (handle, begin_s, step_s, final))
        if status == FMI_WARNING:
            t.counts[c, WARNINGS] += 1
        if status == FMI_DISCARD:
            t.room[0] = 0
            place = t.room.ctypes.data
            told = ask_status_2(t.components[c, ASK], (handle, _FMI_2_TERMINATED, place))
            if told <= FMI_WARNING and t.room[0]:
                return ENDED
        return status
    end_s = begin_s + step_s
    time_s, left_s = begin_s, step_s
    for _ in range(MOST_RETURNS):
        t.counts[c, STEPS] += 1
        status, event, ends, early, reached_s = do_step_3(function, handle, time_s, left_s, final)
        if status == FMI_WARNING:
            t.counts[c, WARNINGS] += 1
        if status > FMI_WARNING:
            return status
        if event and t.components[c, EVENTS]:
            status = change_mode(t.components[c, ENTER_EVENTS], (handle,))
            if status <= FMI_WARNING:
                status = _handle_events(t, c)
            if status > FMI_WARNING:
                return status
        if ends:
            return ENDED
        if not early or end_s - reached_s <= _LEAST * step_s:
            return status
        if not reached_s > time_s and not event:
            return STUCK
        time_s, left_s = reached_s, end_s - reached_s
    return STUCK


@inlined
def _nanoseconds(t: Tables, scheme: Scheme) -> int:
    if scheme.clock == 0:
        return 0
    read_clock(scheme.clock, (scheme.clock_kind, t.room.ctypes.data))
    return 1_000_000_000 * t.room[0] + t.room[1]


@inlined
def find_nan(t: Tables, m: Memory) -> int:
    """Number of the first component with an output that is NaN, -1 if there is none."""
    for c in range(t.components.shape[0]):
        for k in range(t.components[c, FIRST_REAL], t.components[c, END_REAL]):
            if math.isnan(m.f8[k]):
                return c
        for k in range(t.components[c, FIRST_SINGLE], t.components[c, END_SINGLE]):
            if math.isnan(m.f4[k]):
                return c
    return -1


@inlined
def advance(
    t: Tables, m: Memory, scheme: Scheme, tick: int, count: int, final: int
) -> tuple[int, int, int]:
    """Step all components over `count` ticks.

    A component whose step is several ticks makes it at its begin, and its outputs are got at its
    end.

    Returns:
        A status, its component, and what was going on. ENDED stands for a whole step.
    """
    dt = scheme.tick_s
    ended = -1
    if scheme.algorithm == JACOBI and copy(t, m, 0, t.copies.shape[0]):
        return NOT_A_NUMBER, 0, GETTING
    if t.feeds.shape[0]:
        middle = 0.5 * count if scheme.algorithm >= EXTRAPOLATED else 0.0
        feed(t, m, scheme.start_s, tick, middle, dt)
    begin = _nanoseconds(t, scheme)
    for c in range(t.components.shape[0]):
        if meets(t, c, tick):
            if scheme.algorithm == GAUSS_SEIDEL:
                copy(t, m, t.components[c, FIRST_COPY], t.components[c, END_COPY])
            status = set_inputs(t, c)
            if status > FMI_WARNING:
                return status, c, SETTING
            step_s = t.components[c, PERIOD] * count * dt
            status = _step(t, c, scheme.start_s + tick * dt, step_s, final)
            t.components[c, ENDS] = status == ENDED
            if status > FMI_WARNING and status != ENDED:
                return status, c, STEPPING
        if meets(t, c, tick + count):
            status = exchange_values(t, c, t.components[c, FIRST_GET], t.components[c, END_GET])
            if status > FMI_WARNING:
                return status, c, GETTING
            if t.components[c, ENDS]:
                ended = c
        if scheme.clock:
            end = _nanoseconds(t, scheme)
            t.counts[c, NANOSECONDS] += end - begin
            begin = end
    return (ENDED, ended, STEPPING) if ended >= 0 else (FMI_OK, 0, STEPPING)

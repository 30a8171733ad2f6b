"""One step of a system, compiled: copy, set, step, get.

With Gauss–Seidel every component gets, in their order, what those before it have just put out;
with Jacobi all get the outputs before the step. Methods of second order have inputs in place
already. Time is an integer number of ticks.
"""

import math
from collections import namedtuple
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
from cosim.system.exchange import copy, exchange_values, feed, get_outputs, meets
from cosim.system.layout import COLUMN, Memory, Tables

# Beyond every status: asks to end, returns early without an end, puts out NaN; equations of inputs
# that are not solved, values that never stay.
STATUS = namedtuple("STATUS", "ended stuck not_a_number no_solution unsettled")(*range(100, 105))
ALGORITHM = namedtuple("ALGORITHM", "jacobi gauss_seidel extrapolated implicit")(*range(4))
# What was going on when a call failed.
PHASE = namedtuple("PHASE", "setting stepping getting saving restoring ticking")(*range(6))
COUNT = namedtuple("COUNT", "steps rollbacks nanoseconds warnings")(*range(4))  # of `Tables.counts`
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
        by_energy: 1 if the error is the residual power of bonds, and no step is rolled back.
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
    room, handle = t.room.ctypes.data, t.components[c, COLUMN.handle]
    ends = 0
    for _ in range(MOST_RETURNS):
        t.room[0] = 0
        places = (room, room + 1, room + 2, room + 3, room + 4, room + 8)
        status = update_discrete_states(t.components[c, COLUMN.update], (handle, *places))
        if status > FMI_WARNING:
            return status
        ends |= (t.room[0] >> 8) & 0xFF
        if t.room[0] & 0xFF == 0:
            break
    status = change_mode(t.components[c, COLUMN.enter_steps], (handle,))
    return STATUS.ended if ends and status <= FMI_WARNING else status


@inlined
def set_inputs(t: Tables, c: int) -> int:
    """Set the inputs of a component; discrete ones are an event where it leaves those to us."""
    first, end = t.components[c, COLUMN.first_set], t.components[c, COLUMN.end_set]
    if not (t.components[c, COLUMN.events] and t.components[c, COLUMN.discrete]):
        return exchange_values(t, c, first, end)
    status = change_mode(t.components[c, COLUMN.enter_events], (t.components[c, COLUMN.handle],))
    if status <= FMI_WARNING:
        status = exchange_values(t, c, first, end)
    return _handle_events(t, c) if status <= FMI_WARNING else status


@inlined
def _step(t: Tables, c: int, begin_s: float, step_s: float, final: int) -> int:
    """Step a component, over its events too where it leaves them to us."""
    handle, function = t.components[c, COLUMN.handle], t.components[c, COLUMN.do_step]
    end_s = begin_s + step_s
    time_s, left_s = begin_s, step_s
    for _ in range(MOST_RETURNS):
        t.counts[c, COUNT.steps] += 1
        event, ends, early, reached_s = 0, 0, 0, end_s
        if t.components[c, COLUMN.steps_as] == 3:
            status, event, ends, early, reached_s = do_step_3(
                function, handle, time_s, left_s, final
            )
        else:
            status = do_step_2(function, (handle, begin_s, step_s, final))
            if status == FMI_DISCARD:
                t.room[0], place = 0, t.room.ctypes.data
                told = ask_status_2(t.components[c, COLUMN.ask], (handle, _FMI_2_TERMINATED, place))
                if told <= FMI_WARNING and t.room[0]:
                    return STATUS.ended
        if status == FMI_WARNING:
            t.counts[c, COUNT.warnings] += 1
        if status > FMI_WARNING:
            return status
        if event and t.components[c, COLUMN.events]:
            status = change_mode(t.components[c, COLUMN.enter_events], (handle,))
            if status <= FMI_WARNING:
                status = _handle_events(t, c)
            if status > FMI_WARNING:
                return status
        if ends:
            return STATUS.ended
        if not early or end_s - reached_s <= _LEAST * step_s:
            return status
        if not reached_s > time_s and not event:
            return STATUS.stuck
        time_s, left_s = reached_s, end_s - reached_s
    return STATUS.stuck


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
        for k in range(t.components[c, COLUMN.first_real], t.components[c, COLUMN.end_real]):
            if math.isnan(m.f8[k]):
                return c
        for k in range(t.components[c, COLUMN.first_single], t.components[c, COLUMN.end_single]):
            if math.isnan(m.f4[k]):
                return c
    return -1


@inlined
def advance(
    t: Tables, m: Memory, scheme: Scheme, tick: int, count: int, final: int
) -> tuple[int, int, int]:
    """Step all components over `count` ticks.

    A component with a step of several ticks makes it at its begin, and its outputs are got at its
    end.

    Returns:
        A status, its component, and what was going on. STATUS.ended stands for a whole step.
    """
    dt = scheme.tick_s
    ended = -1
    if scheme.algorithm == ALGORITHM.jacobi and copy(t, m, 0, t.copies.shape[0]):
        return STATUS.not_a_number, find_nan(t, m), PHASE.getting
    if t.feeds.shape[0]:
        middle = 0.5 * count if scheme.algorithm >= ALGORITHM.extrapolated else 0.0
        feed(t, m, scheme.start_s, tick, middle, dt)
    begin = _nanoseconds(t, scheme)
    for c in range(t.components.shape[0]):
        if meets(t, c, tick):
            if scheme.algorithm == ALGORITHM.gauss_seidel:
                copy(t, m, t.components[c, COLUMN.first_copy], t.components[c, COLUMN.end_copy])
            status = set_inputs(t, c)
            if status > FMI_WARNING:
                return status, c, PHASE.setting
            step_s = t.components[c, COLUMN.period] * count * dt
            status = _step(t, c, scheme.start_s + tick * dt, step_s, final)
            t.components[c, COLUMN.ends] = status == STATUS.ended
            if status > FMI_WARNING and status != STATUS.ended:
                return status, c, PHASE.stepping
        if meets(t, c, tick + count):
            status = get_outputs(t, c)
            if status > FMI_WARNING:
                return status, c, PHASE.getting
            if t.components[c, COLUMN.ends]:
                ended = c
        if scheme.clock:
            end = _nanoseconds(t, scheme)
            t.counts[c, COUNT.nanoseconds] += end - begin
            begin = end
    return (STATUS.ended, ended, PHASE.stepping) if ended >= 0 else (FMI_OK, 0, PHASE.stepping)

"""The loops over a system's steps, compiled: initialisation, fixed steps, steps taken back.

Each goes on where the one before it has ended, until a tick is reached, the rows are full, or it is
time to look at the keyboard.
"""

import numpy as np

from cosim.base.jit import inlined, kernel
from cosim.fmi.abi import FMI_DISCARD, FMI_OK, FMI_WARNING, exchange_state
from cosim.system.kernels import (
    ENDED,
    GETTING,
    RESTORING,
    ROLLBACKS,
    SAVING,
    SETTING,
    Scheme,
    advance,
)
from cosim.system.layout import (
    END_GET,
    END_SET,
    FIRST_GET,
    FIRST_SET,
    GET_STATE,
    HANDLE,
    SET_STATE,
    WORD,
    Memory,
    Tables,
)
from cosim.system.transfer import copy, exchange_values

# Of a run, in an array: ticks reached, ticks of the next step, steps accepted, rows recorded,
# steps rejected.
TICK, NEXT, DONE, ROW, REJECTED = range(5)
STEPS_AT_ONCE = 200_000
# The error of a step grows with the square of its length: one with this share of what is tolerated
# may be tried twice as long.
_SMALL = 0.2


@kernel
def settle(t: Tables, m: Memory, exchanges: int) -> tuple[int, int, int]:
    """Exchange all values so many times, and get what is put out then; returns as `advance`."""
    for k in range(exchanges + 1):
        for c in range(t.components.shape[0]):
            status = exchange_values(t, c, t.components[c, FIRST_GET], t.components[c, END_GET])
            if status > FMI_WARNING:
                return status, c, GETTING
        if k == exchanges:
            break
        copy(t, m, 0, t.copies.shape[0])
        for c in range(t.components.shape[0]):
            status = exchange_values(t, c, t.components[c, FIRST_SET], t.components[c, END_SET])
            if status > FMI_WARNING:
                return status, c, SETTING
    return FMI_OK, 0, GETTING


@inlined
def _record(m: Memory, now: np.ndarray, ticks: np.ndarray, rows: np.ndarray) -> None:
    row = now[ROW]
    ticks[row] = now[TICK]
    for word in range(rows.shape[1]):
        rows[row, word] = m.i8[word]
    now[ROW] = row + 1


@kernel
def run_fixed(
    t: Tables,
    m: Memory,
    scheme: Scheme,
    now: np.ndarray,
    until: int,
    ticks: np.ndarray,
    rows: np.ndarray,
) -> tuple[int, int, int]:
    """Steps of one tick.

    Args:
        t: tables.
        m: the block of values.
        scheme: how to step.
        now: (5,), where the run is; changed.
        until: tick to reach.
        ticks: (R,) room for the ticks of recorded rows.
        rows: (R, words) room for what was got by then.

    Returns:
        As `advance`.
    """
    stop = now[DONE] + STEPS_AT_ONCE
    while now[TICK] < until and now[ROW] < rows.shape[0] and now[DONE] < stop:
        status, component, phase = advance(t, m, scheme, now[TICK], 1, 1)
        if status not in (FMI_OK, ENDED):
            return status, component, phase
        now[TICK] += 1
        now[DONE] += 1
        if now[DONE] % scheme.every == 0 or now[TICK] == until or status == ENDED:
            _record(m, now, ticks, rows)
        if status == ENDED:
            return status, component, phase
    return FMI_OK, 0, 0


@kernel
def run_adaptive(
    t: Tables,
    m: Memory,
    scheme: Scheme,
    now: np.ndarray,
    until: int,
    ticks: np.ndarray,
    rows: np.ndarray,
) -> tuple[int, int, int]:
    """Steps that are tried in one, taken back, and made in two halves; see `run_fixed`.

    Where the outputs of both differ by more than the tolerance, the halves are taken back too, and
    half of the step is tried. A step of one tick is as it is.
    """
    before, tried = np.empty_like(m.i8), np.empty_like(m.i8)
    stop = now[DONE] + STEPS_AT_ONCE
    while now[TICK] < until and now[ROW] < rows.shape[0] and now[DONE] < stop:
        tick = now[TICK]
        count = min(now[NEXT], until - tick)
        if count == 1:
            status, component, phase = advance(t, m, scheme, tick, 1, 1)
            error = 0.0
        else:
            status, component, phase = _save(t, m, before)
            if status == FMI_OK:
                status, component, phase = advance(t, m, scheme, tick, count, 0)
            if status == FMI_OK:
                _keep(m.i8, tried)
                status, component, phase = _restore(t, m, before)
            if status == FMI_OK:
                half = count // 2
                status, component, phase = advance(t, m, scheme, tick, half, 0)
                if status == FMI_OK:
                    rest = count - half
                    status, component, phase = advance(t, m, scheme, tick + half, rest, 0)
            error = _error(t, m, tried, scheme.tolerance) if status == FMI_OK else np.inf
            if not error <= 1.0 and status in (FMI_OK, FMI_DISCARD, ENDED):
                status, component, phase = _restore(t, m, before)
                if status != FMI_OK:
                    return status, component, phase
                for c in range(t.components.shape[0]):
                    t.counts[c, ROLLBACKS] += 1
                now[NEXT] = count // 2
                now[REJECTED] += 1
                continue
        if status not in (FMI_OK, ENDED):
            return status, component, phase
        now[TICK] += count
        now[DONE] += 1
        now[NEXT] = min(2 * count, scheme.longest) if error <= _SMALL else count
        if now[DONE] % scheme.every == 0 or now[TICK] == until or status == ENDED:
            _record(m, now, ticks, rows)
        if status == ENDED:
            return status, component, phase
    return FMI_OK, 0, 0


@inlined
def _keep(values: np.ndarray, room: np.ndarray) -> None:
    for k in range(values.shape[0]):
        room[k] = values[k]


@inlined
def _save(t: Tables, m: Memory, room: np.ndarray) -> tuple[int, int, int]:
    """Save all components' states, and the block."""
    _keep(m.i8, room)
    for c in range(t.components.shape[0]):
        place = t.states.ctypes.data + WORD * c
        status = exchange_state(t.components[c, GET_STATE], (t.components[c, HANDLE], place))
        if status > FMI_WARNING:
            return status, c, SAVING
    return FMI_OK, 0, SAVING


@inlined
def _restore(t: Tables, m: Memory, room: np.ndarray) -> tuple[int, int, int]:
    """Go back to what was saved."""
    _keep(room, m.i8)
    for c in range(t.components.shape[0]):
        arguments = (t.components[c, HANDLE], t.states[c])
        status = exchange_state(t.components[c, SET_STATE], arguments)
        if status > FMI_WARNING:
            return status, c, RESTORING
    return FMI_OK, 0, RESTORING


@inlined
def _error(t: Tables, m: Memory, tried: np.ndarray, tolerance: float) -> float:
    """Largest difference of checked outputs to what they were, by what is tolerated."""
    worst = 0.0
    values = tried.view(np.float64)
    for k in range(t.checked.shape[0]):
        for i in range(t.checked[k, 0], t.checked[k, 0] + t.checked[k, 1]):
            size = max(abs(m.f8[i]), t.nominal[k])
            share = abs(m.f8[i] - values[i]) / (tolerance * size)
            if not share <= worst:  # keeps what is no number
                worst = share
    return worst

"""Values passed on, compiled: from outputs to inputs in the block, and between it and FMUs."""

import math

from cosim.base.jit import inlined
from cosim.fmi.abi import FMI_OK, exchange_2, exchange_3
from cosim.system.layout import (
    COUNT,
    FED,
    FIRST_ROW,
    FUNCTION,
    HANDLE,
    KIND,
    LAST_ROW,
    NUMBER,
    PERIOD,
    PLACE,
    REFERENCES,
    ROW_NOW,
    SCALED,
    SIZE,
    SOURCE,
    SOURCE_TYPE,
    STANDARD,
    TARGET,
    TARGET_TYPE,
    VALUES,
    Memory,
    Tables,
)


@inlined
def _float(m: Memory, kind: int, place: int) -> float:
    """A value as float64, of type number `kind`; those of 64-bit integers have no use for it."""
    if kind == 0:
        return m.f8[place]
    if kind == 1:
        return float(m.f4[place])
    return float(_integer(m, kind, place))


@inlined
def _integer(m: Memory, kind: int, place: int) -> int:
    if kind == 2:
        return int(m.i1[place])
    if kind == 3:
        return int(m.u1[place])
    if kind == 4:
        return int(m.i2[place])
    if kind == 5:
        return int(m.u2[place])
    if kind == 6:
        return int(m.i4[place])
    if kind == 7:
        return int(m.u4[place])
    return m.i8[place]  # 64 bits without a sign are only copied to the same


@inlined
def _put_integer(m: Memory, kind: int, place: int, value: int) -> None:
    if kind == 2:
        m.i1[place] = value
    elif kind == 3:
        m.u1[place] = value
    elif kind == 4:
        m.i2[place] = value
    elif kind == 5:
        m.u2[place] = value
    elif kind == 6:
        m.i4[place] = value
    elif kind == 7:
        m.u4[place] = value
    else:
        m.i8[place] = value


@inlined
def copy(t: Tables, m: Memory, first: int, end: int) -> bool:
    """Copy outputs to inputs of connections `first` to `end` − 1; returns whether one is NaN."""
    wrong = False
    for k in range(first, end):
        source, target = t.copies[k, SOURCE], t.copies[k, TARGET]
        kind, to = t.copies[k, SOURCE_TYPE], t.copies[k, TARGET_TYPE]
        scaled = t.copies[k, SCALED]
        for i in range(t.copies[k, NUMBER]):
            if kind == 0 and to == 0 and not scaled:
                value = m.f8[source + i]
                wrong |= math.isnan(value)
                m.f8[target + i] = value
            elif to <= 1:
                value = _float(m, kind, source + i)
                wrong |= math.isnan(value)
                if scaled:
                    value = t.scales[k, 0] * value + t.scales[k, 1]
                if to == 0:
                    m.f8[target + i] = value
                else:
                    m.f4[target + i] = value
            else:
                _put_integer(m, to, target + i, _integer(m, kind, source + i))
    return wrong


@inlined
def feed(t: Tables, m: Memory, start_s: float, tick: int, middle: float, tick_s: float) -> None:
    """Set inputs that are given over time: floats interpolated linearly, others held.

    Of rows of one time the last one counts from then on. Before the first row its values hold, and
    behind the last one those.

    Args:
        t: tables.
        m: the block of values.
        start_s: time of tick 0.
        tick: at which steps begin.
        middle: ticks from there to the point of time, of a component whose step is one tick.
        tick_s: duration of a tick.
    """
    for k in range(t.feeds.shape[0]):
        period = t.components[t.feeds[k, FED], PERIOD]
        time_s = start_s + (tick + period * middle) * tick_s
        at_s = time_s + 1e-6 * tick_s  # a row within the rounding of a tick is at the tick
        place, kind, row = t.feeds[k, PLACE], t.feeds[k, KIND], t.feeds[k, ROW_NOW]
        while row < t.feeds[k, LAST_ROW] and t.given[0, row + 1] <= at_s:
            row += 1
        while row > t.feeds[k, FIRST_ROW] and t.given[0, row] > at_s:
            row -= 1
        t.feeds[k, ROW_NOW] = row
        value, since_s = t.given[1, row], time_s - t.given[0, row]
        if kind > 1:
            _put_integer(m, kind, place, int(value))
            continue
        if since_s > 0.0 and row < t.feeds[k, LAST_ROW]:
            slope = (t.given[1, row + 1] - value) / (t.given[0, row + 1] - t.given[0, row])
            value += slope * since_s
        if kind == 0:
            m.f8[place] = value
        else:
            m.f4[place] = value


@inlined
def meets(t: Tables, c: int, tick: int) -> bool:
    """Return whether a component begins or ends a step at a tick."""
    return t.components[c, PERIOD] == 1 or tick % t.components[c, PERIOD] == 0


@inlined
def exchange_values(t: Tables, c: int, first: int, end: int) -> int:
    """Call setters or getters `first` to `end` − 1 of component `c`; returns the worst status."""
    worst, handle = FMI_OK, t.components[c, HANDLE]
    for k in range(first, end):
        function, references = t.exchanges[k, FUNCTION], t.exchanges[k, REFERENCES]
        count, values = t.exchanges[k, COUNT], t.exchanges[k, VALUES]
        if t.components[c, STANDARD] == 3:
            size = t.exchanges[k, SIZE]
            status = exchange_3(function, (handle, references, count, values, size))
        else:
            status = exchange_2(function, (handle, references, count, values))
        worst = max(worst, status)
    return worst

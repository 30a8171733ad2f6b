"""Values passed on, compiled: from outputs to inputs in the block, and between it and FMUs."""

import math

from cosim.base.jit import inlined
from cosim.fmi.abi import FMI_OK, exchange_2, exchange_3
from cosim.system.layout import CALL, COLUMN, COPY, FEED, Memory, Tables


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
    """An integer from its bytes; 64 bits without a sign are only copied to the same."""
    size, value = _size(kind), 0
    for k in range(size):
        value |= int(m.u1[place * size + k]) << (8 * k)
    negative = kind % 2 == 0 and size < 8 and value >> (8 * size - 1) == 1
    return value - (1 << (8 * size)) if negative else value


@inlined
def _put_integer(m: Memory, kind: int, place: int, value: int) -> None:
    size = _size(kind)
    for k in range(size):
        m.u1[place * size + k] = (value >> (8 * k)) & 0xFF


@inlined
def _put_float(m: Memory, kind: int, place: int, value: float) -> None:
    if kind == 0:
        m.f8[place] = value
    else:
        m.f4[place] = value


@inlined
def _size(kind: int) -> int:
    """Bytes of an integer; its types come in pairs of one size, that with a sign first."""
    return 1 << (kind // 2 - 1)


@inlined
def copy(t: Tables, m: Memory, first: int, end: int) -> bool:
    """Copy outputs to inputs of connections `first` to `end` − 1; returns whether one is NaN."""
    wrong = False
    for k in range(first, end):
        source, target = t.copies[k, COPY.source], t.copies[k, COPY.target]
        kind, to = t.copies[k, COPY.source_type], t.copies[k, COPY.target_type]
        scaled = t.copies[k, COPY.scaled]
        if kind == to == 0 and not scaled:
            for i in range(t.copies[k, COPY.number]):
                m.f8[target + i] = m.f8[source + i]
                wrong |= math.isnan(m.f8[source + i])
            continue
        for i in range(t.copies[k, COPY.number]):
            if to > 1:
                _put_integer(m, to, target + i, _integer(m, kind, source + i))
                continue
            value = _float(m, kind, source + i)
            wrong |= math.isnan(value)
            if scaled:
                value = t.scales[k, 0] * value + t.scales[k, 1]
            _put_float(m, to, target + i, value)
    return wrong


@inlined
def feed(t: Tables, m: Memory, start_s: float, tick: int, middle: float, tick_s: float) -> None:
    """Set inputs that are given over time: floats interpolated linearly, others held.

    Of rows of one time the last one counts from then on. Before the first row its values hold, and
    behind the last one those. Steps begin at `tick`; `middle` are the ticks from there to the point
    of time, of a component with a step of one tick.
    """
    for k in range(t.feeds.shape[0]):
        period = t.components[t.feeds[k, FEED.fed], COLUMN.period]
        time_s = start_s + (tick + period * middle) * tick_s
        at_s = time_s + 1e-6 * tick_s  # a row within the rounding of a tick is at the tick
        place, kind, row = t.feeds[k, FEED.place], t.feeds[k, FEED.kind], t.feeds[k, FEED.row_now]
        while row < t.feeds[k, FEED.last_row] and t.given[0, row + 1] <= at_s:
            row += 1
        while row > t.feeds[k, FEED.first_row] and t.given[0, row] > at_s:
            row -= 1
        t.feeds[k, FEED.row_now] = row
        value, since_s = t.given[1, row], time_s - t.given[0, row]
        if kind > 1:
            _put_integer(m, kind, place, int(value))
            continue
        if since_s > 0.0 and row < t.feeds[k, FEED.last_row]:
            slope = (t.given[1, row + 1] - value) / (t.given[0, row + 1] - t.given[0, row])
            value += slope * since_s
        _put_float(m, kind, place, value)


@inlined
def meets(t: Tables, c: int, tick: int) -> bool:
    """Return whether a component begins or ends a step at a tick."""
    return t.components[c, COLUMN.period] == 1 or tick % t.components[c, COLUMN.period] == 0


@inlined
def exchange_values(t: Tables, c: int, first: int, end: int) -> int:
    """Call setters or getters `first` to `end` − 1 of component `c`; returns the worst status."""
    worst, handle = FMI_OK, t.components[c, COLUMN.handle]
    for k in range(first, end):
        function, references = t.exchanges[k, CALL.function], t.exchanges[k, CALL.references]
        count, values = t.exchanges[k, CALL.count], t.exchanges[k, CALL.values]
        if t.components[c, COLUMN.standard] == 3:
            size = t.exchanges[k, CALL.size]
            status = exchange_3(function, (handle, references, count, values, size))
        else:
            status = exchange_2(function, (handle, references, count, values))
        worst = max(worst, status)
    return worst


@inlined
def get_outputs(t: Tables, c: int) -> int:
    """Get the outputs of a component; returns the worst status."""
    return exchange_values(t, c, t.components[c, COLUMN.first_get], t.components[c, COLUMN.end_get])

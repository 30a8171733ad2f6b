"""The loops over a system's steps, compiled: initialisation, steps of one tick, solved or varied.

Each resumes where the one before it has ended, until a tick is reached, the rows are full, or it is
time to look at the keyboard.
"""

import numpy as np

from cosim.base.jit import inlined, kernel
from cosim.fmi.abi import FMI_DISCARD, FMI_OK, FMI_WARNING
from cosim.system.coupling import (
    IMBALANCE,
    KEPT,
    KEPT_PREVIOUS,
    LAST_ERROR,
    OUTER,
    PREVIOUS,
    RUNNING,
    START,
    Coupling,
    Z,
    get_all,
    restore,
    save,
    solve,
    step,
)
from cosim.system.kernels import (
    ENDED,
    EXTRAPOLATED,
    GAUSS_SEIDEL,
    GETTING,
    NO_SOLUTION,
    NOT_A_NUMBER,
    ROLLBACKS,
    UNSETTLED,
    Scheme,
    advance,
    find_nan,
)
from cosim.system.layout import Memory, Tables

# Of a run, in an array: ticks reached, ticks of the next step, steps accepted, rows recorded,
# steps rejected.
TICK, NEXT, DONE, ROW, REJECTED = range(5)
# The PI controller of Gustafsson: the next step is as long as the errors of this one and of the
# one before it let be, with a margin, and within limits of growth.
_INTEGRAL, _PROPORTIONAL, _MARGIN, _LEAST, _MOST = 0.7, 0.4, 0.9, 0.2, 5.0
# Without steps that are taken back it grows and shrinks more slowly, as with ECCO (Sadjina et al.,
# Engineering with Computers 33, 2017): the residual power is small where it changes its sign, too.
_ENERGY_EXPONENT, _ENERGY_MOST = 4.0, 1.5


@kernel
def settle(t: Tables, m: Memory, s: Coupling, scheme: Scheme) -> tuple[int, int, int]:
    """Make inputs and outputs agree in Initialization Mode; returns as `advance`."""
    status, c, phase = get_all(t, m, 0)
    if status > FMI_WARNING:
        return status, c, phase
    for i in range(s.torn.shape[0]):
        s.unknowns[Z, i] = m.f8[s.torn[i]]
    return solve(t, m, s, scheme, 0, 0)


@kernel
def begin(t: Tables, m: Memory, s: Coupling) -> tuple[int, int, int]:
    """Get all outputs after Initialization Mode; returns as `advance`."""
    s.flags[RUNNING] = 1
    status, c, phase = get_all(t, m, 0)
    wrong = find_nan(t, m)
    return (NOT_A_NUMBER, wrong, GETTING) if status <= FMI_WARNING and wrong >= 0 else (
        status, c, phase
    )  # fmt: skip


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
    """Steps of one tick, in which nothing is solved.

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
    stop = now[DONE] + scheme.at_once
    while now[TICK] < until and now[ROW] < rows.shape[0] and now[DONE] < stop:
        status, component, phase = advance(t, m, scheme, now[TICK], 1, 1)
        if status not in (FMI_OK, ENDED):
            return status, component, phase
        now[TICK] += 1
        now[DONE] += 1
        recorded = now[DONE] % scheme.every == 0 or now[TICK] == until or status == ENDED
        if recorded or scheme.algorithm == GAUSS_SEIDEL:  # which has passed on new values already
            wrong = find_nan(t, m)
            if wrong >= 0:
                return NOT_A_NUMBER, wrong, GETTING
        if recorded:
            _record(m, now, ticks, rows)
        if status == ENDED:
            return status, component, phase
    return FMI_OK, 0, 0


@kernel
def run_solved(
    t: Tables,
    m: Memory,
    s: Coupling,
    scheme: Scheme,
    now: np.ndarray,
    until: int,
    ticks: np.ndarray,
    rows: np.ndarray,
) -> tuple[int, int, int]:
    """Steps in which inputs are solved for or extrapolated, or whose length varies.

    With a tolerance a step is tried in one, taken back, and made in two halves, whose difference
    tells the error of the halves by the order of the method. Where that is more than the tolerance,
    the halves are taken back too, and a shorter step is tried. The error of a step of one tick is
    not known. By energy, no step is taken back, and its residual power is its error.
    See `run_fixed`.
    """
    exponent = 3.0 if scheme.algorithm >= EXTRAPOLATED else 2.0
    if scheme.by_energy:
        exponent = _ENERGY_EXPONENT
    stop = now[DONE] + scheme.at_once
    while now[TICK] < until and now[ROW] < rows.shape[0] and now[DONE] < stop:
        tick = now[TICK]
        count = min(now[NEXT], until - tick) if scheme.tolerance else 1
        error, growth = -1.0, 2.0
        if count == 1 or scheme.by_energy:
            final = 0 if scheme.tolerance and not scheme.by_energy else 1
            status, component, phase = step(t, m, s, scheme, tick, count, final)
            if scheme.by_energy:
                error = s.numbers[IMBALANCE] / scheme.tolerance
        else:
            count -= count % 2
            status, component, phase = _step_twice(t, m, s, scheme, tick, count)
            error = np.inf
            if status == FMI_OK:
                error = _error(t, m, s, scheme.tolerance) / (2.0 ** (exponent - 1.0) - 1.0)
            tried = status in (FMI_OK, FMI_DISCARD, ENDED, NOT_A_NUMBER, NO_SOLUTION, UNSETTLED)
            if not error <= 1.0 and tried:
                status, component, phase = _return(t, m, s)
                if status > FMI_WARNING:
                    return status, component, phase
                for c in range(t.components.shape[0]):
                    t.counts[c, ROLLBACKS] += 1
                shrink = 0.5
                if error < np.inf:
                    shrink = min(0.5, max(_LEAST, _MARGIN * error ** (-1.0 / exponent)))
                now[NEXT] = max(1, int(shrink * count))
                now[REJECTED] += 1
                continue
        if error >= 0.0:
            least = max(error, 1e-6)
            growth = _MARGIN * least ** (-_INTEGRAL / exponent)
            growth *= s.numbers[LAST_ERROR] ** (_PROPORTIONAL / exponent)
            s.numbers[LAST_ERROR] = least
        if status not in (FMI_OK, ENDED):
            return status, component, phase
        now[TICK] += count
        wrong = find_nan(t, m)
        if wrong >= 0:
            return NOT_A_NUMBER, wrong, GETTING
        now[DONE] += 1
        if scheme.by_energy and growth > 1.0:
            growth = min(growth, _ENERGY_MOST) + 1.0 / count
        longer = int(min(_MOST, max(_LEAST, growth)) * count)
        now[NEXT] = min(max(longer, 1), scheme.longest)
        if now[DONE] % scheme.every == 0 or now[TICK] == until or status == ENDED:
            _record(m, now, ticks, rows)
        if status == ENDED:
            return status, component, phase
    return FMI_OK, 0, 0


@kernel
def _step_twice(
    t: Tables, m: Memory, s: Coupling, scheme: Scheme, tick: int, count: int
) -> tuple[int, int, int]:
    """Step in one, keep the block, go back, and step in two halves."""
    s.inputs[KEPT], s.flags[KEPT_PREVIOUS] = s.inputs[START], s.flags[PREVIOUS]
    status, c, phase = save(t, m, s, OUTER)
    if status == FMI_OK:
        status, c, phase = step(t, m, s, scheme, tick, count, 0)
    if status == FMI_OK:
        s.tried[:] = m.i8
        status, c, phase = _return(t, m, s)
    half = count // 2
    for k in range(2):
        if status == FMI_OK:
            status, c, phase = step(t, m, s, scheme, tick + k * half, half, 0)
            wrong = find_nan(t, m)
            if status == FMI_OK and wrong >= 0:
                return NOT_A_NUMBER, wrong, GETTING
    return status, c, phase


@kernel
def _return(t: Tables, m: Memory, s: Coupling) -> tuple[int, int, int]:
    """Go back to the outer saved point."""
    s.inputs[START], s.flags[PREVIOUS] = s.inputs[KEPT], s.flags[KEPT_PREVIOUS]
    return restore(t, m, s, OUTER)


@kernel
def _error(t: Tables, m: Memory, s: Coupling, tolerance: float) -> float:
    """Largest difference of checked outputs to what they were, by what is tolerated."""
    worst = 0.0
    values = s.tried.view(np.float64)
    for k in range(t.checked.shape[0]):
        for i in range(t.checked[k, 0], t.checked[k, 0] + t.checked[k, 1]):
            size = max(abs(m.f8[i]), t.nominal[k])
            share = abs(m.f8[i] - values[i]) / (tolerance * size)
            if not share <= worst:  # keeps what is no number
                worst = share
    return worst

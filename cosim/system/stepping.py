"""The loop over a system's steps, compiled.

It resumes where the call before it has ended, until a tick is reached, the rows are full, or it is
time to look at the keyboard.
"""

import numpy as np

from cosim.base.jit import inlined, kernel
from cosim.fmi.abi import FMI_DISCARD, FMI_OK, FMI_WARNING
from cosim.system.coupling import IMBALANCE, LAST_ERROR, Coupling, error_of, step, step_twice, undo
from cosim.system.layout import Memory, Tables
from cosim.system.step import ALGORITHM, COUNT, PHASE, STATUS, Scheme, advance, find_nan

# Of a run, in an array: ticks reached, ticks of the next step, steps accepted, rows recorded,
# steps rejected.
TICK, NEXT, DONE, ROW, REJECTED = range(5)
# The PI controller of Gustafsson: the next step is as long as the errors of this one and of the
# one before it let be, with a margin, and within limits of growth.
_INTEGRAL, _PROPORTIONAL, _MARGIN, _LEAST, _MOST = 0.7, 0.4, 0.9, 0.2, 5.0
# Without steps that are rolled back it grows and shrinks more slowly, as with ECCO (Sadjina et al.,
# Engineering with Computers 33, 2017): the residual power is small where it changes its sign, too.
_ENERGY_EXPONENT, _ENERGY_MOST = 4.0, 1.5


@inlined
def _book(
    t: Tables, m: Memory, scheme: Scheme, now: np.ndarray, until: int, ticks: np.ndarray,
    rows: np.ndarray, count: int, ended: bool, looks: bool,
) -> int:  # fmt: skip
    """Count a step of `count` ticks and record what is due; looks for NaN then, or if it `looks`.

    Returns:
        The component that puts out NaN, -1 if there is none.
    """
    now[TICK] += count
    now[DONE] += 1
    recorded = now[DONE] % scheme.every == 0 or now[TICK] == until or ended
    if recorded or looks:
        wrong = find_nan(t, m)
        if wrong >= 0:
            return wrong
    if recorded:
        row = now[ROW]
        ticks[row] = now[TICK]
        for word in range(rows.shape[1]):
            rows[row, word] = m.i8[word]
        now[ROW] = row + 1
    return -1


@kernel
def run_plain(
    t: Tables, m: Memory, _: Coupling, scheme: Scheme, now: np.ndarray, until: int,
    ticks: np.ndarray, rows: np.ndarray,
) -> tuple[int, int, int]:  # fmt: skip
    """Make steps as `run_steps` does, of a system without loops, tolerance, bonds, or second order.

    Most systems are such, and this takes a fraction of the time to compile.
    """
    stop = now[DONE] + scheme.at_once
    looks = scheme.algorithm == ALGORITHM.gauss_seidel  # else `copy` looks
    while now[TICK] < until and now[ROW] < rows.shape[0] and now[DONE] < stop:
        status, component, phase = advance(t, m, scheme, now[TICK], 1, 1)
        if status not in (FMI_OK, STATUS.ended):
            return status, component, phase
        ended = status == STATUS.ended
        wrong = _book(t, m, scheme, now, until, ticks, rows, 1, ended, looks)
        if wrong >= 0:
            return STATUS.not_a_number, wrong, PHASE.getting
        if ended:
            return status, component, phase
    return FMI_OK, 0, 0


@kernel
def run_steps(
    t: Tables, m: Memory, s: Coupling, scheme: Scheme, now: np.ndarray, until: int,
    ticks: np.ndarray, rows: np.ndarray,
) -> tuple[int, int, int]:  # fmt: skip
    """Make steps to a tick, or until all rows are full; returns as `advance`.

    With a tolerance a step is tried in one, rolled back, and made in two halves; their difference
    tells the error of the halves by the order of the method. Where that is more than the tolerance,
    the halves are rolled back too, and a shorter step is tried. The error of a step of one tick is
    not known. By energy, no step is rolled back, and its residual power is its error.

    `now` (5,) is where the run is, and changes; `ticks` (R,) and `rows` (R, words) are room for the
    ticks of recorded rows and for what was got by then.
    """
    exponent = 3.0 if scheme.algorithm >= ALGORITHM.extrapolated else 2.0
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
            status, component, phase = step_twice(t, m, s, scheme, tick, count)
            error = np.inf
            if status == FMI_OK:
                error = error_of(t, m, s, scheme.tolerance) / (2.0 ** (exponent - 1.0) - 1.0)
            failed = status not in (FMI_OK, FMI_DISCARD) and status < STATUS.ended
            if not (error <= 1.0 or failed or status == STATUS.stuck):
                status, component, phase = undo(t, m, s)
                if status > FMI_WARNING:
                    return status, component, phase
                for c in range(t.components.shape[0]):
                    t.counts[c, COUNT.rollbacks] += 1
                shrink = 0.5
                if error < np.inf:
                    shrink = min(0.5, max(_LEAST, _MARGIN * error ** (-1.0 / exponent)))
                now[NEXT] = max(1, int(shrink * count))
                now[REJECTED] += 1
                continue
        if status not in (FMI_OK, STATUS.ended):
            return status, component, phase
        if scheme.tolerance:
            if error >= 0.0:
                least = max(error, 1e-6)
                growth = _MARGIN * least ** (-_INTEGRAL / exponent)
                growth *= s.numbers[LAST_ERROR] ** (_PROPORTIONAL / exponent)
                s.numbers[LAST_ERROR] = least
            if scheme.by_energy and growth > 1.0:
                growth = min(growth, _ENERGY_MOST) + 1.0 / count
            longer = int(min(_MOST, max(_LEAST, growth)) * count)
            now[NEXT] = min(max(longer, 1), scheme.longest)
        ended = status == STATUS.ended
        wrong = _book(t, m, scheme, now, until, ticks, rows, count, ended, True)
        if wrong >= 0:
            return STATUS.not_a_number, wrong, PHASE.getting
        if ended:
            return status, component, phase
    return FMI_OK, 0, 0

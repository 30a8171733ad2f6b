"""Inputs that are solved for: algebraic loops, and implicit steps, by a quasi-Newton method.

Unknowns z are values of connected inputs. The residual is what their outputs then give minus z:
at one point of time for algebraic loops, and over a step, which is rolled back and repeated, for
implicit coupling. The inverse of the residual's Jacobian is made by finite differences, kept from
step to step, updated by Broyden's formula, and rebuilt where convergence is slow.
"""

from collections.abc import Collection
from typing import NamedTuple

import numpy as np

from cosim.base.jit import inlined, part
from cosim.fmi.abi import FMI_DISCARD, FMI_OK, FMI_WARNING, exchange_state
from cosim.system.exchange import copy, exchange_values, feed, get_outputs, meets
from cosim.system.graph import Link
from cosim.system.layout import BOND, COLUMN, WORD, Layout, Memory, Tables
from cosim.system.step import ALGORITHM, PHASE, STATUS, Scheme, advance, find_nan, set_inputs

# Rows of `Coupling.unknowns`: present values, residual, both before an update, the update, and the
# size to which residuals are compared.
Z, RESIDUAL, OLD_Z, OLD_RESIDUAL, UPDATE, SIZE = range(6)
# Rows of `Coupling.inputs`: the last value that its source put out at the begin of a step, the one
# before it, a copy of the former.
START, BEFORE, KEPT = range(3)
# Of `Coupling.flags`: whether there is an inverse, ticks of the step before and a copy, component
# that asked to end or -1, unknown (or word of the inputs) that is worst, whether steps are made.
HAS_INVERSE, PREVIOUS, KEPT_PREVIOUS, ENDING, WORST, RUNNING = range(6)
# Of `Coupling.numbers`: largest residual relative to its scale, error of the step before, residual
# power of bonds relative to that which passes.
LARGEST, LAST_ERROR, IMBALANCE = range(3)
# Saved points: of a varied step, of an implicit one, and one that the caller goes back to.
OUTER, INNER, HOME = range(3)
_MOST_ITERATIONS = 50
_MOST_HALVINGS = 8
_ROUGH = 1e-6  # residual of a step that is accepted where no iteration lowers it: FMUs round
_SLOW = 0.1  # share of a residual that an iteration leaves, above which the Jacobian is renewed
_DIFFERENCE = 1e-6  # of finite differences, relative to the scale of an unknown


class Coupling(NamedTuple):
    """Unknowns and their present values.

    Attributes:
        held: (H,) places of inputs that methods of second order vary within a step.
        periods: (2, H) int64, ticks between their rows in `inputs`, and of a step of their
            components.
        torn: (N,) places of inputs that are solved for.
        scale: (N,) their nominal sizes.
        inputs: (3, H) values of held ones, by the rows above.
        unknowns: (6, N) values of torn ones, by the rows above.
        inverse: (N, 2 N), inverse of the Jacobian in the first N columns; room.
        sent: (words,) int64, inputs as they were set last.
        saved: (3, words) int64, the block at saved points.
        tried: (words,) int64, the block after a step in one.
        bonded: (3, B, 2) float64, of both ends of each bond: output before a step, input in it, and
            the largest power that has passed.
        flags: (6,) int64 and
        numbers: (3,) float64, see above.
    """

    held: np.ndarray
    periods: np.ndarray
    torn: np.ndarray
    scale: np.ndarray
    inputs: np.ndarray
    unknowns: np.ndarray
    inverse: np.ndarray
    sent: np.ndarray
    saved: np.ndarray
    tried: np.ndarray
    bonded: np.ndarray
    flags: np.ndarray
    numbers: np.ndarray

    def worst(self) -> tuple[int, float, float]:
        """Return the number of the worst unknown (or word of inputs), its residual, its value."""
        k = int(self.flags[WORST])
        size, value = (self.unknowns[row, k] for row in (SIZE, Z)) if k < len(self.torn) else (0, 0)
        return k, self.numbers[LARGEST] * size, value


def make_coupling(layout: Layout, held: Collection[Link], torn: Collection[Link]) -> Coupling:
    """Return room for the inputs of some links, which are float64."""
    (held_places, periods), (places, _) = layout.places_of(held), layout.places_of(torn)
    size, count = len(layout.memory.i8), len(places)
    flags = np.array([0, 0, 0, -1, 0, 0], dtype=np.int64)
    scale = np.array([layout.nominal(layout.node_at(WORD * int(place))) for place in places])
    words = np.zeros(size - layout.words, dtype=np.int64)
    return Coupling(
        held_places, periods, places, scale, np.zeros((3, len(held_places))), np.zeros((6, count)),
        np.zeros((count, 2 * count)), words, np.zeros((3, size), dtype=np.int64),
        np.zeros(size, dtype=np.int64), np.zeros((3, len(layout.tables.bonds), 2)), flags,
        np.array([0.0, 1.0, 0.0]),
    )  # fmt: skip


@part
def save(t: Tables, m: Memory, s: Coupling, point: int) -> tuple[int, int, int]:
    """Save all components' states and the block; returns as `advance`."""
    s.saved[point] = m.i8
    for c in range(t.components.shape[0]):
        place = t.states.ctypes.data + WORD * (point * t.components.shape[0] + c)
        status = exchange_state(
            t.components[c, COLUMN.get_state], (t.components[c, COLUMN.handle], place)
        )
        if status > FMI_WARNING:
            return status, c, PHASE.saving
    return FMI_OK, 0, PHASE.saving


@part
def restore(t: Tables, m: Memory, s: Coupling, point: int) -> tuple[int, int, int]:
    """Go back to a saved point."""
    m.i8[:] = s.saved[point]
    for c in range(t.components.shape[0]):
        arguments = (t.components[c, COLUMN.handle], t.states[point, c])
        status = exchange_state(t.components[c, COLUMN.set_state], arguments)
        if status > FMI_WARNING:
            return status, c, PHASE.restoring
    return FMI_OK, 0, PHASE.restoring


@part
def get_all(t: Tables, m: Memory, tick: int) -> tuple[int, int, int]:
    """Get the outputs of all components that are at the end of a step."""
    for c in range(t.components.shape[0]):
        if not meets(t, c, tick):
            continue
        status = get_outputs(t, c)
        if status > FMI_WARNING:
            return status, c, PHASE.getting
    return FMI_OK, 0, PHASE.getting


@inlined
def _continued(s: Coupling, i: int, tick: int, ticks: float) -> float:
    """Return held input `i` some ticks after `tick`, extrapolated by its last two values."""
    period = s.periods[0, i]
    if tick < period:
        return s.inputs[START, i]
    change = s.inputs[START, i] - s.inputs[BEFORE, i]
    return s.inputs[START, i] + (tick % period + ticks) / (period * s.flags[PREVIOUS]) * change


@part
def evaluate(t: Tables, m: Memory, s: Coupling, scheme: Scheme, tick: int) -> tuple[int, int, int]:
    """Pass on values, with the unknowns as inputs, until no input changes; find the residual."""
    first = m.i8.shape[0] - s.sent.shape[0]
    for k in range(scheme.exchanges):
        copy(t, m, 0, t.copies.shape[0])
        feed(t, m, scheme.start_s, tick, 0.0, scheme.tick_s)
        for i in range(s.held.shape[0]):
            if tick % s.periods[0, i]:
                m.f8[s.held[i]] = _continued(s, i, tick, 0.0)
        for i in range(s.torn.shape[0]):
            s.unknowns[RESIDUAL, i] = m.f8[s.torn[i]] - s.unknowns[Z, i]
            m.f8[s.torn[i]] = s.unknowns[Z, i]
        same = k > 0 or s.flags[RUNNING] == 1
        for word in range(s.sent.shape[0]):
            if s.sent[word] != m.i8[first + word]:
                same = False
                s.sent[word] = m.i8[first + word]
                s.flags[WORST] = word
        if same:
            return FMI_OK, 0, PHASE.getting
        for c in range(t.components.shape[0]):
            if not meets(t, c, tick):
                continue
            if s.flags[RUNNING]:
                status = set_inputs(t, c)
            else:
                first_set = t.components[c, COLUMN.first_start]
                status = exchange_values(t, c, first_set, t.components[c, COLUMN.end_set])
            if status == STATUS.ended:
                s.flags[ENDING] = c
            elif status > FMI_WARNING:
                return status, c, PHASE.setting
        status, c, phase = get_all(t, m, tick)
        if status > FMI_WARNING:
            return status, c, phase
    return STATUS.unsettled if scheme.solves else FMI_OK, 0, PHASE.getting


@part
def _try(
    t: Tables, m: Memory, s: Coupling, scheme: Scheme, tick: int, count: int
) -> tuple[int, int, int]:
    """Find the residual of the unknowns: at a tick, or after a step from the inner saved point."""
    if count:
        status, c, phase = restore(t, m, s, INNER)
        if status > FMI_WARNING:
            return status, c, phase
        copy(t, m, 0, t.copies.shape[0])
        for i in range(s.held.shape[0]):
            m.f8[s.held[i]] = 0.5 * (s.inputs[START, i] + s.unknowns[Z, i])
        status, c, phase = _step_all(t, m, s, scheme, tick, count, 0)
        if status > FMI_WARNING:
            return status, c, phase
    status, c, phase = evaluate(t, m, s, scheme, tick + count)
    s.numbers[LARGEST] = 0.0
    for i in range(s.torn.shape[0]):
        share = abs(s.unknowns[RESIDUAL, i]) / s.unknowns[SIZE, i]
        if not share <= s.numbers[LARGEST]:
            s.numbers[LARGEST], s.flags[WORST] = share, i
    return status, c, phase


@part
def _step_all(
    t: Tables, m: Memory, s: Coupling, scheme: Scheme, tick: int, count: int, final: int
) -> tuple[int, int, int]:
    """Step all components, and note one that asks to end."""
    s.flags[ENDING] = -1
    for k in range(t.bonds.shape[0]):
        for end in range(2):
            s.bonded[0, k, end] = m.f8[t.bonds[k, BOND.output + end]]
    status, c, phase = advance(t, m, scheme, tick, count, final)
    for k in range(t.bonds.shape[0]):
        for end in range(2):
            s.bonded[1, k, end] = m.f8[t.bonds[k, BOND.input + end]]
    first = m.i8.shape[0] - s.sent.shape[0]
    s.sent[:] = m.i8[first:]
    if status == STATUS.ended:
        s.flags[ENDING] = c
        return FMI_OK, c, phase
    return status, c, phase


@part
def solve(
    t: Tables, m: Memory, s: Coupling, scheme: Scheme, tick: int, count: int
) -> tuple[int, int, int]:
    """Solve for the unknowns, which begin at what they are.

    At a tick if `count` is 0, else over a step of `count` ticks from there, from the inner saved
    point. Returns as `advance`; STATUS.no_solution if it does not converge.
    """
    n = s.torn.shape[0]
    for i in range(n):
        s.unknowns[SIZE, i] = max(s.scale[i], abs(s.unknowns[Z, i]))
    status, c, phase = _try(t, m, s, scheme, tick, count)
    if n == 0 or status > FMI_WARNING:
        return status, c, phase
    if not s.numbers[LARGEST] < np.inf:
        return STATUS.not_a_number, c, PHASE.getting
    tolerance = scheme.step_tolerance if count else scheme.loop_tolerance
    slow, fresh = False, False
    for _ in range(_MOST_ITERATIONS):
        size = s.numbers[LARGEST]
        if s.flags[HAS_INVERSE]:
            if _update(s) <= tolerance:
                return FMI_OK, 0, PHASE.getting
        elif size == 0.0:
            return FMI_OK, 0, PHASE.getting
        s.unknowns[OLD_Z], s.unknowns[OLD_RESIDUAL] = s.unknowns[Z], s.unknowns[RESIDUAL]
        worst = s.flags[WORST]
        if not s.flags[HAS_INVERSE] or (slow and not fresh):
            status, c, phase = _differentiate(t, m, s, scheme, tick, count)
            if status > FMI_WARNING:
                s.numbers[LARGEST], s.flags[WORST] = size, worst
                return status, c, phase
            fresh = True
        _update(s)
        share, refused = 1.0, False
        for k in range(_MOST_HALVINGS):
            s.unknowns[Z] = s.unknowns[OLD_Z] + share * s.unknowns[UPDATE]
            status, c, phase = _try(t, m, s, scheme, tick, count)
            refused = status in (FMI_DISCARD, STATUS.unsettled, STATUS.not_a_number)
            if status > FMI_WARNING and not refused:
                return status, c, phase
            if (not refused and s.numbers[LARGEST] < size) or k == _MOST_HALVINGS - 1:
                break
            share *= 0.25
        if not refused and s.numbers[LARGEST] < size:
            slow = s.numbers[LARGEST] > _SLOW * size
            fresh = fresh and not slow
            _broyden(s)
            continue
        s.unknowns[Z] = s.unknowns[OLD_Z]
        status, c, phase = _try(t, m, s, scheme, tick, count)
        if status > FMI_WARNING:
            return status, c, phase
        if fresh:
            enough = _ROUGH if count else tolerance
            found = size <= max(enough, tolerance)
            return FMI_OK if found else STATUS.no_solution, 0, PHASE.getting
        slow = True
    return STATUS.no_solution, 0, PHASE.getting


def settle(t: Tables, m: Memory, s: Coupling, scheme: Scheme) -> tuple[int, int, int]:
    """Pass on values at the start, and solve for the unknowns if there are any; as `advance`."""
    if s.torn.shape[0]:
        return solve(t, m, s, scheme, 0, 0)
    return evaluate(t, m, s, scheme, 0)  # takes a fraction of the time to compile


@part
def _update(s: Coupling) -> float:
    """Make the update -inverse · residual; returns the largest relative size of both."""
    n, largest = s.torn.shape[0], 0.0
    for i in range(n):
        total = 0.0
        for j in range(n):
            total -= s.inverse[i, j] * s.unknowns[RESIDUAL, j]
        s.unknowns[UPDATE, i] = total
        share = max(abs(total), abs(s.unknowns[RESIDUAL, i]))
        share /= max(s.scale[i], abs(s.unknowns[Z, i]))
        if not share <= largest:
            largest = share
    return largest


@part
def _broyden(s: Coupling) -> None:
    """Update the inverse J⁻¹ by Broyden's formula: J⁻¹ += (δ - J⁻¹ ρ) δᵀ J⁻¹ / (δᵀ J⁻¹ ρ)."""
    n = s.torn.shape[0]
    inverse = s.inverse[:, :n]
    delta = s.unknowns[Z] - s.unknowns[OLD_Z]
    change = s.unknowns[RESIDUAL] - s.unknowns[OLD_RESIDUAL]
    image = (inverse * change).sum(axis=1)
    below = (delta * image).sum()
    if below != 0.0:
        row = (delta.reshape(n, 1) * inverse).sum(axis=0) / below
        inverse += (delta - image).reshape(n, 1) * row


@part
def _differentiate(
    t: Tables, m: Memory, s: Coupling, scheme: Scheme, tick: int, count: int
) -> tuple[int, int, int]:
    """Make the inverse of the Jacobian at the old values by finite differences."""
    n = s.torn.shape[0]
    for j in range(n):
        step = _DIFFERENCE * max(s.scale[j], abs(s.unknowns[OLD_Z, j]))
        for sign in (1.0, -1.0):  # the other side where the first one is refused
            s.unknowns[Z] = s.unknowns[OLD_Z]
            s.unknowns[Z, j] += sign * step
            status, c, phase = _try(t, m, s, scheme, tick, count)
            if status <= FMI_WARNING and s.numbers[LARGEST] < np.inf:
                break
        if status > FMI_WARNING:
            return status, c, phase
        change = s.unknowns[RESIDUAL] - s.unknowns[OLD_RESIDUAL]
        s.inverse[:, j] = change / (s.unknowns[Z, j] - s.unknowns[OLD_Z, j])
    s.unknowns[Z], s.unknowns[RESIDUAL] = s.unknowns[OLD_Z], s.unknowns[OLD_RESIDUAL]
    s.flags[HAS_INVERSE] = _inverted(s.inverse)
    return FMI_OK if s.flags[HAS_INVERSE] else STATUS.no_solution, 0, PHASE.getting


@part
def _inverted(a: np.ndarray) -> int:
    """Invert the first N columns of (N, 2 N) in place; returns 0 if they are singular."""
    n = a.shape[0]
    a[:, n:] = np.eye(n)
    for k in range(n):
        pivot = k + np.argmax(np.abs(a[k:, k]))
        if not abs(a[pivot, k]) > 0.0:
            return 0
        row = a[pivot].copy()
        a[pivot] = a[k]
        a[k] = row / row[k]
        for i in range(n):
            if i != k:
                a[i] -= a[i, k] * a[k]
    a[:, :n] = a[:, n:]
    return 1


@part
def step(
    t: Tables, m: Memory, s: Coupling, scheme: Scheme, tick: int, count: int, final: int
) -> tuple[int, int, int]:
    """Step over `count` ticks and bring inputs and outputs to agreement; returns as `advance`.

    Methods of second order hold an input at the mean of its values at both ends of the step. The
    later one is extrapolated from the step before it, or solved for.
    """
    for i in range(s.torn.shape[0]):
        s.unknowns[Z, i] = m.f8[s.torn[i]]
    if scheme.algorithm <= ALGORITHM.gauss_seidel:
        status, c, phase = _step_all(t, m, s, scheme, tick, count, final)
        if status <= FMI_WARNING and (s.torn.shape[0] or scheme.tolerance):
            status, c, phase = solve(t, m, s, scheme, tick + count, 0)
    else:
        for i in range(s.held.shape[0]):
            if tick % s.periods[0, i] == 0:
                s.inputs[BEFORE, i], s.inputs[START, i] = s.inputs[START, i], m.f8[s.held[i]]
        if scheme.algorithm == ALGORITHM.extrapolated:
            copy(t, m, 0, t.copies.shape[0])
            for i in range(s.held.shape[0]):
                m.f8[s.held[i]] = _continued(s, i, tick, 0.5 * s.periods[1, i] * count)
            status, c, phase = _step_all(t, m, s, scheme, tick, count, final)
            if status <= FMI_WARNING:
                status, c, phase = solve(t, m, s, scheme, tick + count, 0)
        else:
            for i in range(s.held.shape[0]):  # they are the unknowns, in the same order
                s.unknowns[Z, i] = _continued(s, i, tick, count)
            status, c, phase = save(t, m, s, INNER)
            if status <= FMI_WARNING:
                status, c, phase = solve(t, m, s, scheme, tick, count)
    if status <= FMI_WARNING and t.bonds.shape[0]:
        _balance(t, m, s, count, scheme.tick_s)
    s.flags[PREVIOUS] = count
    if status <= FMI_WARNING and s.flags[ENDING] >= 0:
        return STATUS.ended, s.flags[ENDING], PHASE.stepping
    return status, c, phase


@part
def _balance(t: Tables, m: Memory, s: Coupling, count: int, tick_s: float) -> None:
    """Add to the residual energy of bonds what the coupling has put into both ends over a step.

    Of each end that is the input, which held, times the integral of the output: by the parabola
    through its values at both ends of the step and at the begin of the step before.
    """
    previous, squares = s.flags[PREVIOUS], 0.0
    for k in range(t.bonds.shape[0]):
        place, residual = t.bonds[k, BOND.energy], 0.0
        for end in range(2):
            first, last = s.bonded[0, k, end], m.f8[t.bonds[k, BOND.output + end]]
            mean = 0.5 * (first + last)
            if previous:
                bend = (last - first) / count - (first - m.f8[place + 1 + end]) / previous
                mean -= count * count / (6.0 * (count + previous)) * bend
            m.f8[place + 1 + end] = first
            power = s.bonded[1, k, end] * mean * (-t.weights[k, 0] if end else 1.0)
            residual += power
            s.bonded[2, k, end] = max(s.bonded[2, k, end], abs(power))
        m.f8[place] += residual * count * tick_s
        squares += (residual / max(t.weights[k, 1], s.bonded[2, k].max())) ** 2
    s.numbers[IMBALANCE] = np.sqrt(squares / t.bonds.shape[0])


@part
def step_twice(
    t: Tables, m: Memory, s: Coupling, scheme: Scheme, tick: int, count: int
) -> tuple[int, int, int]:
    """Step in one, keep the block, go back, and step in two halves."""
    s.inputs[KEPT], s.flags[KEPT_PREVIOUS] = s.inputs[START], s.flags[PREVIOUS]
    status, c, phase = save(t, m, s, OUTER)
    if status == FMI_OK:
        status, c, phase = step(t, m, s, scheme, tick, count, 0)
    if status == FMI_OK:
        s.tried[:] = m.i8
        status, c, phase = undo(t, m, s)
    half = count // 2
    for k in range(2):
        if status == FMI_OK:
            status, c, phase = step(t, m, s, scheme, tick + k * half, half, 0)
            wrong = find_nan(t, m)
            if status == FMI_OK and wrong >= 0:
                return STATUS.not_a_number, wrong, PHASE.getting
    return status, c, phase


@part
def undo(t: Tables, m: Memory, s: Coupling) -> tuple[int, int, int]:
    """Go back to the outer saved point."""
    s.inputs[START], s.flags[PREVIOUS] = s.inputs[KEPT], s.flags[KEPT_PREVIOUS]
    return restore(t, m, s, OUTER)


@part
def error_of(t: Tables, m: Memory, s: Coupling, tolerance: float) -> float:
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


@part
def begin(t: Tables, m: Memory, s: Coupling) -> tuple[int, int, int]:
    """Get all outputs after Initialization Mode; returns as `advance`."""
    s.flags[RUNNING] = 1
    status, c, phase = get_all(t, m, 0)
    wrong = find_nan(t, m)
    if status <= FMI_WARNING and wrong >= 0:
        return STATUS.not_a_number, wrong, PHASE.getting
    return status, c, phase

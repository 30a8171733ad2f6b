"""Rules of tabular learning, and how the compiled loops call them.

A rule corrects the tables of one robot after a move, see `agent.training.methods.learner`. The
class of a record says which of the rules here a loop is compiled with, so that the machine code is
kept on disk; a rule of a user's is compiled at every call.
"""

import re
from collections.abc import Callable
from typing import Any, NamedTuple

import numba
import numpy as np
from numba import types
from numba.extending import overload

from cosim.base.errors import UserError, failure
from cosim.base.jit import inlined


@inlined
def largest(values: np.ndarray) -> tuple[int, np.float32]:
    """Index of the largest of eight values, the lowest of equals (Eq. 6), and that value."""
    # Eq. (6) as a tournament of three rounds, not a chain of seven comparisons: it limits speed
    a, va = (1, values[1]) if values[1] > values[0] else (0, values[0])
    b, vb = (3, values[3]) if values[3] > values[2] else (2, values[2])
    c, vc = (5, values[5]) if values[5] > values[4] else (4, values[4])
    d, vd = (7, values[7]) if values[7] > values[6] else (6, values[6])
    a, va = (b, vb) if vb > va else (a, va)
    c, vc = (d, vd) if vd > vc else (c, vc)
    return (c, vc) if vc > va else (a, va)


# begin rule
def q_learning(q, s, a, reward, discount, s_next, a_next, eta, coin):
    """Q-learning: the best action is expected in the next state."""
    # Eq. (4): a reward, and what is expected from the next state on
    target = reward + discount * q[0, s_next, a_next]
    # Eq. (7), down the gradient of Eq. (5) with a constant target
    q[0, s, a] += eta * (target - q[0, s, a])


# end rule


def double_q(q, s, a, reward, discount, s_next, a_next, eta, coin):
    """Double Q-learning (van Hasselt 2010): one table picks an action, the other one values it."""
    k = np.int64(coin & np.uint64(1))
    target = reward + discount * q[1 - k, s_next, largest(q[k, s_next])[0]]
    q[k, s, a] += eta * (target - q[k, s, a])


class _QLearning(NamedTuple):
    pass


class _DoubleQ(NamedTuple):
    pass


RECORDS: dict[Callable[..., None], Any] = {q_learning: _QLearning(), double_q: _DoubleQ()}
_BY_CLASS: dict[type, Any] = {type(record): inlined(rule) for rule, record in RECORDS.items()}


def correct(rule: Any, q: np.ndarray, i: int, *step: Any) -> None:
    """Have robot i learn from a step by a rule, one of `RECORDS` or a user's compiled one."""
    _BY_CLASS.get(type(rule), rule)(q[:, i], *step)


def _chosen(rule: Any) -> Callable[..., None]:
    """Return `correct` for a numba type."""
    if isinstance(rule, types.Dispatcher):
        return lambda rule, q, i, *step: rule(q[:, i], *step)
    of_class = _BY_CLASS[rule.instance_class]
    return lambda rule, q, i, *step: of_class(q[:, i], *step)


# References to the view are not counted, which would cost more than the rule.
_OPTIONS: Any = {"forceinline": True, "_nrt": False, "error_model": "numpy"}
overload(correct, jit_options=_OPTIONS)(lambda rule, q, i, *step: _chosen(rule))


# Types of a rule's arguments.
_RULE = (
    *(types.Array(types.float32, 3, "A"), types.uint64, types.int64, types.float32, types.float32),
    *(types.uint64, types.int64, types.float32, types.uint64),
)


def compiled(name: str, rule: Callable[..., None]) -> Any:
    """Return a rule as the loops take it: of `RECORDS`, or compiled with checks of all indices.

    A user's is compiled at every call, as numba keeps the values that its global names had then.
    """
    if rule in RECORDS:
        return RECORDS[rule]
    try:
        found: Any = numba.njit(nogil=True, error_model="numpy", boundscheck=True)(rule)
        found.compile(_RULE)
    except Exception as error:  # whatever numba says of a user's code
        raise failure(f"compiling the rule {name}", error, _first_of(str(error))) from error
    if (returned := found.overloads[_RULE].signature.return_type) != types.none:
        raise UserError(f"the rule {name} returns {returned}; have it update q, and return nothing")
    return found


def _first_of(message: str) -> str:
    """Return the first statement of a message of numba, and the line that it is about."""
    plain = re.sub(r"\x1b\[[\d;]*m|Failed in nopython mode pipeline \(.*\)\n", "", message)
    statement = re.split(r"\n\s*(?:File |During: |There are )", plain)[0]
    line = re.search(r'File "[^"]*", (line \d+)', plain)
    return f"{statement}, {line[1]}" if line else statement

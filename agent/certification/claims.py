"""Claims about rates of outcomes, such as `collision < 1e-3`."""

import re
from decimal import Decimal
from typing import NamedTuple

from cosim.base.errors import UserError
from cosim.model.outcome import ENDS, Outcome

RATES: dict[str, frozenset[Outcome]] = {
    **{str(outcome): frozenset({outcome}) for outcome in ENDS},
    "failure": frozenset(ENDS) - {Outcome.SUCCESS},
}
_FORM = re.compile(r"\s*(\w+)\s*([<>])\s*((?:\d+\.?\d*|\.\d+)(?:e[+-]?\d{1,3})?)\s*", re.ASCII)
LEAST_CONFIDENCE, USUAL_CONFIDENCE = 0.5, 0.999999
_LEAST = 1e-6  # of a limit: some ten million episodes


class Claim(NamedTuple):
    """A statement about a policy.

    Attributes:
        text: as text.
        against: outcomes of episodes that speak against it.
        limit: the claim holds where their rate is below it.
    """

    text: str
    against: frozenset[Outcome]
    limit: float


def parse_claim(text: str) -> Claim:
    """The claim of a text `RATE < p` or `RATE > p`.

    Raises:
        UserError: it is none, or p is too close to 0 or 1.
    """
    match = _FORM.fullmatch(text)
    if match is None or match[1] not in RATES:
        raise UserError(
            f"claim {text!r} is invalid; write RATE < p or RATE > p with a rate of "
            f"{', '.join(RATES)}, such as 'collision < 1e-3'"
        )
    name, relation, number = match.groups()
    limit = float(number) if relation == "<" else complement(number)
    if not _LEAST <= limit <= 1.0 - _LEAST:
        raise UserError(
            f"claim {text!r} cannot be certified; give a rate from {_LEAST:g} to 1 - {_LEAST:g}"
        )
    against = RATES[name] if relation == "<" else frozenset(ENDS) - RATES[name]
    return Claim(f"{name} {relation} {number}", against, limit)


def complement(share: float | str) -> float:
    """1 - share, in the decimals that it is written with."""
    return float(1 - Decimal(str(share)))

"""Networks that all robots share: what they see, how they act, and how they are trained."""

from importlib.util import find_spec
from typing import Literal

from cosim.base.errors import UserError, installing

NetworkAlgorithm = Literal["ddqn", "ippo", "mappo"]


def require_learners() -> None:
    """Refuse to continue without the extra.

    Raises:
        UserError: it is missing.
    """
    if find_spec("skrl") is None or find_spec("jax") is None:
        raise UserError(f"networks need the extra deep; install it with `{installing('deep')}`")

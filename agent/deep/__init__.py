"""Networks that all robots share: what they see, how they act, and how they are trained."""

from typing import Literal

Algorithm = Literal["ddqn", "ippo", "mappo"]

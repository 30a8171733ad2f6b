"""Readings of the paper's decision process: every point that it leaves open, checked by name.

What readings mean for a scenario is `agent.mdp.readings`; nothing here is slow to import.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, get_args

from cosim.base.errors import UserError

Feature = Literal["x", "y", "d", "g", "b", "h", "p"]
# Not learnt: see `agent.mdp.optimum`, and for the fastest `agent.moves.bound`.
Computed = Literal["shortest", "fastest", "planned"]
PartnerUpdate = Literal["ordinary", "penalty", "none"]
RewardPer = Literal["step", "time", "distance"]
FEATURES: tuple[Feature, ...] = get_args(Feature)
PARTNER_UPDATES: tuple[PartnerUpdate, ...] = get_args(PartnerUpdate)
MAX_STEPS = 10**9
REWARDS_PER: tuple[RewardPer, ...] = get_args(RewardPer)


@dataclass(frozen=True)
class ProcessConfig:
    """Readings of the paper's decision process; the defaults are those of this project."""

    goal_reward: float = 100.0
    """L of Eq. (8): reward of the goal, and minus the reward of a failure (Section III)."""
    step_cost: float = 1.0
    """Cost of every move, Eq. (8) and (11)."""
    diagonal_cost: float = 1.0
    """Factor on the step cost of a diagonal move (assumed 1; sqrt 2 rewards centimetres)."""
    reward_per: RewardPer = "step"
    """What Eq. (11) is paid for, on moves: every RL step (assumed), every 2 s, or every cell of the
    path. The discount counts RL steps, or for the other two every 2 s."""
    approach_coefficient: float = 1.5
    """c of Eq. (12), at least 1: how much closing in on the other robot costs (Section V)."""
    distance_limit_m: float = 0.1
    """D of Eq. (11): beyond it the other robot costs nothing (Section III)."""
    features: tuple[Feature, ...] = ("x", "y", "d", "g")
    """What a robot's table is indexed by: x, y, d (Eq. 9), g (Eq. 10), b (bearing of the other),
    h (the axis that the robot itself faces, forwards or backwards), p (cell of the other)."""
    target_obstacle: Literal["cell", "disk"] = "cell"
    """Extent of another robot's target as a static obstacle (assumed: its cell)."""
    collision: Literal["cells", "swept"] = "cells"
    """Contact after the simultaneous moves (assumed), or at any moment of the straight moves; with
    robots and with obstacles."""
    partner_of_failed: PartnerUpdate = "ordinary"
    """Update of the robots that did not fail when another did: ordinary (assumed), -L as well, or
    none."""
    slip_probability: float = 0.0
    """Probability of moving 45 degrees left or right of the action while learning (assumed 0)."""
    clearance_m: float = 0.002
    """Gap between two robots that training on moves counts as contact already (assumed)."""
    step_limit: int = 1000
    """Moves after which an episode is cut, counted as a failure (assumed; none in the paper); RL
    steps in training on moves.
    A low limit keeps robots that circle from unlearning it: 60 costs 12 points of success in
    scenario 4, 200 none (docs/reproduction.md)."""

    def __post_init__(self) -> None:
        valid = {
            "goal_reward": self.goal_reward > 0,
            "step_cost": self.step_cost >= 0,
            "diagonal_cost": self.diagonal_cost >= 0,
            "approach_coefficient": self.approach_coefficient >= 1,
            "distance_limit_m": self.distance_limit_m > 0,
            "features": len(set(self.features)) == len(self.features) > 0,
            "slip_probability": 0 <= self.slip_probability <= 1,
            "clearance_m": self.clearance_m >= 0,
            "step_limit": 1 <= self.step_limit <= MAX_STEPS,
        }
        require("process", self, valid, UserError)


def require(table: str, config: object, valid: Mapping[str, bool], error: type[UserError]) -> None:
    """Refuse the first field of a table of settings that is not valid, or infinite.

    Args:
        table: of a settings file, and prefix of its options.
        config: has the fields.
        valid: whether each field is, by name.
        error: raised.

    Raises:
        UserError: `error`, which names the field.
    """
    for name, fine in valid.items():
        value = getattr(config, name)
        if not fine or (isinstance(value, float) and math.isinf(value)):
            raise error(
                f"{table}: {name} = {value} is not allowed; see its description "
                "in `minirobots train --help`"
            )


Where = Literal[
    "training on moves", "training on the grid", "environments on the grid", "the co-simulation"
]
_NOTHING_LEARNT = {"partner_of_failed": "nothing is learnt there"}
_NOT_ON_THE_GRID = {
    "clearance_m": "contact is a distance of cells",
    "reward_per": "a move is a step; diagonal_cost = 1.414 makes it pay for its path",
}
_NOT_BETWEEN_CELLS = {
    "diagonal_cost": "every RL step of a move costs the same",
    "collision": "contact is looked for during the move",
    "slip_probability": "moves end where they end",
}
# Readings without effect, and what is so instead.
_WITHOUT_EFFECT: dict[Where, dict[str, str]] = {
    "training on moves": {
        **_NOT_BETWEEN_CELLS,
        "partner_of_failed": "a robot learns from its own ended moves, whichever robot fails",
    },
    "training on the grid": _NOT_ON_THE_GRID,
    "environments on the grid": _NOT_ON_THE_GRID | _NOTHING_LEARNT,
    "the co-simulation": {
        **_NOT_BETWEEN_CELLS,
        **_NOTHING_LEARNT,
        "target_obstacle": "it is an interpretation of the grid alone",
        "clearance_m": "contact is that of the bodies",
        "step_limit": "episodes are cut after a simulated time",
    },
}


def refuse_without_effect(config: ProcessConfig, where: Where) -> None:
    """Refuse readings that change nothing.

    Args:
        config: readings.
        where: the process is used.

    Raises:
        UserError: names the reading.
    """
    for name, reason in _WITHOUT_EFFECT[where].items():
        value, default = getattr(config, name), getattr(ProcessConfig, name)
        if value != default:
            raise UserError(
                f"process: {name} = {value} has no effect in {where}: {reason}; "
                f"leave it at {default}"
            )

"""Interpretations of the paper's decision process: every point that it leaves open, by name.

What they mean for a scenario is `agent.mdp.interpretations`; nothing here is slow to import.
"""

from dataclasses import dataclass
from typing import Annotated, Literal, get_args

from msgspec import Meta

from cosim.base.arguments import validate_fields
from cosim.base.errors import UserError

Feature = Literal["x", "y", "d", "g", "b", "h", "p"]
PartnerUpdate = Literal["ordinary", "penalty", "none"]
RewardPer = Literal["step", "time", "distance"]
FEATURES: tuple[Feature, ...] = get_args(Feature)
PARTNER_UPDATES: tuple[PartnerUpdate, ...] = get_args(PartnerUpdate)
REWARDS_PER: tuple[RewardPer, ...] = get_args(RewardPer)

Positive = Annotated[float, Meta(gt=0, le=1e12)]
NotNegative = Annotated[float, Meta(ge=0, le=1e12)]
Share = Annotated[float, Meta(ge=0, le=1)]
Count = Annotated[int, Meta(ge=1, le=10**9)]


@dataclass(frozen=True)
class ProcessConfig:
    """Interpretations of the paper's decision process; the defaults are those of this project."""

    goal_reward: Positive = 100.0
    """L of Eq. (8): reward of the goal, and minus the reward of a failure (Section III)."""
    step_cost: NotNegative = 1.0
    """Cost of every move, Eq. (8) and (11)."""
    diagonal_cost: NotNegative = 1.0
    """Factor on the step cost of a diagonal move (assumed 1; sqrt 2 rewards centimetres)."""
    reward_per: RewardPer = "step"
    """What Eq. (11) is paid for, on moves: every RL step (assumed), every 2 s, or every cell of the
    path. The discount counts RL steps, or for the other two every 2 s."""
    approach_coefficient: Annotated[float, Meta(ge=1, le=1e12)] = 1.5
    """c of Eq. (12), at least 1: how much closing in on the other robot costs (Section V)."""
    distance_limit_m: Positive = 0.1
    """D of Eq. (11): beyond it the other robot costs nothing (Section III)."""
    features: tuple[Feature, ...] = ("x", "y", "d", "g")
    """What a robot's table is indexed by: x, y, d (Eq. 9), g (Eq. 10), b (bearing of the other),
    h (the axis that the robot itself faces, forwards or backwards; on moves of machines that only
    drive forwards one of eight headings), p (cell of the other)."""
    target_obstacle: Literal["cell", "disk"] = "cell"
    """Extent of another robot's target as a static obstacle (assumed: its cell)."""
    collision: Literal["cells", "swept"] = "cells"
    """Contact after the simultaneous moves (assumed), or at any moment of the straight moves; with
    robots and with obstacles."""
    partner_of_failed: PartnerUpdate = "ordinary"
    """Update of the robots that did not fail when another did: ordinary (assumed), -L as well, or
    none."""
    slip_probability: Share = 0.0
    """Probability of moving 45 degrees left or right of the action while learning (assumed 0)."""
    clearance_m: NotNegative = 0.002
    """Gap between two robots that training on moves counts as contact already (assumed)."""
    step_limit: Count = 1000
    """Moves after which an episode is cut, counted as a failure (assumed; none in the paper); RL
    steps in training on moves.
    A low limit keeps robots that circle from unlearning it (docs/paper.md, assumptions, has the
    effect of limits of 60 and 200)."""

    def __post_init__(self) -> None:
        validate_fields(self, "process: ")
        if not 0 < len(self.features) == len(set(self.features)):
            raise UserError(
                f"process: features = {', '.join(self.features)} are not some different ones of "
                f"{', '.join(FEATURES)}"
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
# Interpretations without effect, and what is so instead.
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
    """Refuse interpretations that change nothing where the process is used."""
    for name, reason in _WITHOUT_EFFECT[where].items():
        value, default = getattr(config, name), getattr(ProcessConfig, name)
        if value != default:
            raise UserError(
                f"process: {name} = {value} has no effect in {where}: {reason}; "
                f"leave it at {default}"
            )

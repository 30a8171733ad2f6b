"""Base of all trained policies: they act greedily, on the process of their training.

And kernels from what robots see in the dynamics to rows of their tables and greedy directions. The
features are those of `agent.mdp.grid`, so that policies act in the dynamics as on the grid.
"""

import logging
from abc import ABC, abstractmethod
from dataclasses import fields
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

import msgspec
import numpy as np

from agent.mdp.exact import Evaluation
from agent.mdp.grid import (
    AXIS,
    BEARING,
    CLASS,
    COLUMN_COUNT,
    PARTNER,
    SIGN,
    X,
    Y,
    least_rotation_argmax,
    nearest_other,
    state_index,
)
from agent.mdp.interpretations import Process
from agent.mdp.joint import IMPOSSIBLE
from agent.mdp.rewards import reward_parts
from cosim.base.errors import UserError
from cosim.base.jit import kernel
from cosim.base.storage import json_text, require_suffix, write_arrays, write_json
from cosim.coupling.rl_step import Decision, Step
from cosim.model.config import CoSimConfig
from cosim.model.scenario import Scenario
from cosim.onboard.features import Observation, facing_of
from cosim.recording.series import PolicyMap

_LOGGER = logging.getLogger(__name__)


@kernel
def on_grid(process: Process, observation: Observation) -> tuple[np.ndarray, np.ndarray]:
    """Return what robots see, as a world of the grid and as rows of their tables.

    Of an observation int64, C-contiguous, of robots on the board: the world (N, 11) without last
    moves and status, and state indices (N,) int64.
    """
    cells = observation.cells
    world = np.zeros((len(cells), COLUMN_COUNT), dtype=np.int64)
    states = np.empty(len(cells), dtype=np.int64)
    for i in range(len(cells)):
        world[i, X] = cells[i, 0]
        world[i, Y] = cells[i, 1]
        world[i, CLASS] = observation.distance_class[i]
        world[i, SIGN] = observation.gradient_sign[i]
        world[i, AXIS] = facing_of(observation.direction[i], process.facings)
    for i in range(len(cells)):
        _, world[i, BEARING], world[i, PARTNER] = nearest_other(process, world, i)
        states[i] = state_index(process, world, i)
    return world, states


@kernel
def greedy(values: np.ndarray, facing: np.ndarray) -> np.ndarray:
    """(N,) int64, greedy direction of each robot by its values (N, 8); ties by least rotation."""
    actions = np.empty_like(facing)
    for i in range(len(facing)):
        actions[i] = least_rotation_argmax(values[i], facing[i])
    return actions


# Of the action values of computed policies; those of learnt ones are sums of rewards.
_UNITS = {"shortest": "cells", "fastest": "s", "planned": "s"}


class GreedyPolicy(ABC):
    """Robots choose the largest of their action values.

    Attributes:
        kind: of its file.
        config: what it was trained with; has `scenario`, `process`, `seed` and `method`.
        episodes: episodes trained.
    """

    kind: ClassVar[str]
    config: Any
    episodes: int

    def __post_init__(self) -> None:
        if not self.fits():
            raise UserError(
                f"arrays and configuration of the policy for scenario {self.config.scenario.name} "
                "do not fit"
            )

    @cached_property
    def process(self) -> Process:
        """The decision process that it was trained on."""
        return self.config.build()

    @abstractmethod
    def q_values(self, observation: Observation) -> np.ndarray:
        """(N, 8) float32, action values of each robot."""

    @abstractmethod
    def evaluate_on_grid(self, starts: np.ndarray | None = None) -> Evaluation:
        """Greedy episodes on the grid from (K, N, 2) starts, see `agent.mdp.exact`."""

    @abstractmethod
    def digest(self) -> str:
        """Return the hash (16 hex digits) of the interpretations and what decides actions."""

    @abstractmethod
    def maps(self) -> list[PolicyMap]:
        """Return what each robot thinks of the cells of the board, for pictures."""

    def fits(self) -> bool:
        """Return whether its arrays are those of a policy with its configuration."""
        return True

    @classmethod
    def array_names(cls) -> list[str]:
        """Names of what its file holds in addition to the configuration."""
        names = [field.name for field in fields(cls)]  # pyright: ignore[reportArgumentType]
        return [name for name in names if name not in {"config", "episodes"}]

    def __repr__(self) -> str:
        made = f"{self.episodes} episodes" if self.episodes else self.config.method
        on = "on moves" if self.config.moves else "on the grid"
        return f"{type(self).__name__}(scenario {self.config.scenario.name}, {made} {on})"

    def save(self, path: Path | str) -> None:
        """Write `path` (.npz) and its configuration next to it (.json), whole or not at all."""
        path = require_suffix(path, ".npz")
        digest = self.config.scenario.digest()
        facts = {"kind": self.kind, "scenario_digest": digest, "episodes": self.episodes}
        description = msgspec.to_builtins(self.config) | facts
        write_json(path.with_suffix(".json"), description)
        arrays = {name: getattr(self, name) for name in self.array_names()}
        config = np.frombuffer(json_text(description), dtype=np.uint8)
        write_arrays(path, arrays | {"config": config})

    def act(self, observation: Observation) -> Decision:
        """Return the greedy directions, int64, with their values; ties go to the least rotation.

        A direction that fails has no value (NaN), so that plots of the others can be read.
        """
        facing = np.ascontiguousarray(observation.direction, np.int64)
        values = self.q_values(observation)
        shown = np.where(values > 0.5 * IMPOSSIBLE, values, np.nan)
        unit = _UNITS.get(getattr(self.config, "method", ""), "1")
        return Decision(greedy(values, facing), shown, unit)

    def reward_parts(self, step: Step, arrived: np.ndarray) -> np.ndarray:
        """(N, 3) float64, reward of a co-simulated step by parts, see `agent.mdp.rewards`."""
        return reward_parts(self.process, step, arrived)

    def checked(self, observation: Observation) -> Observation:
        """Return an observation as kernels take it: on the board, int64, C-contiguous."""
        scenario = self.config.scenario
        found = Observation(*(np.ascontiguousarray(values, np.int64) for values in observation))
        if found.cells.shape != (scenario.robots, 2):
            raise ValueError(
                f"observation of shape {found.cells.shape} for {scenario.robots} robots"
            )
        if ((found.cells < 0) | (found.cells >= (scenario.columns, scenario.rows))).any():
            raise ValueError(f"cells {found.cells.tolist()} are off the board")
        return found

    def warn_of_machine(self, config: CoSimConfig) -> None:
        """Warn where it drives another machine than that of the moves it was made with."""
        moves = self.config.moves
        if moves is not None and moves.foreign_to(config):
            _LOGGER.warning(
                "the policy was made with moves of machine %s, and drives machine %s; make one for "
                "it, or expect other times",
                moves.machine,
                config.preset,
            )

    def require_scenario(self, scenario: Scenario, name: str = "the policy") -> None:
        """Refuse any geometry but that of training."""
        trained = self.config.scenario
        if scenario.diameter_m != trained.diameter_m:
            raise UserError(
                f"{name} was trained for robots of {100 * trained.diameter_m:g} cm, not of "
                f"{100 * scenario.diameter_m:g} cm; train one on a scenario file with "
                f"robot_diameter_m = {scenario.diameter_m:g}"
            )
        if scenario.digest() != trained.digest():
            raise UserError(
                f"{name} was trained on scenario {trained.name} (digest {trained.digest()}), not "
                f"on scenario {scenario.name} (digest {scenario.digest()}); choose that scenario "
                "or train a new policy"
            )

"""Boards whose robots choose directions in the full co-simulation.

    gymnasium.make_vec("MiniRobots/CoSim-v0", num_envs=16)
    gymnasium.make_vec("MiniRobots/CoSimPair-v0", num_envs=8)

Boards with one robot have the same bits as a `SyncVectorEnv` of environments with
`decision="period"` and the same seeds.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from gymnasium import spaces

from agent.envs.boards import DirectionBoards, direction_spaces
from agent.envs.dynamics import DynamicsBoards
from agent.envs.grid_episode import free_directions, observed_columns, placed_world, whole_cells
from agent.mdp.acting import on_grid
from agent.mdp.config import ProcessConfig, refuse_without_effect
from agent.mdp.grid import X, Y
from agent.mdp.readings import Process, build_process
from agent.mdp.rewards import failed, step_reward
from cosim.base.arguments import require_one_of
from cosim.model.outcome import BY_RANK, RUNNING
from cosim.model.scenario import Scenario
from cosim.onboard.observing import draw_starts


class CoSimBoards(DynamicsBoards, DirectionBoards):
    """K boards whose robots adopt directions when they wait for one.

    Args:
        count, limit: as of `DynamicsBoards`.
        scenario: name, scenario file or record.
        config: readings of the decision process.
        physics: as of `DynamicsBoards`; and `decision`, when a step ends: after every
            "period" of 2 s, or, of one board, on "arrival", when a robot waits for an action; its
            rewards cover the time that passed.

    Raises:
        UserError: the scenario or an argument cannot be used.
    """

    _mutable = (*DynamicsBoards._mutable, "_processes")

    def __init__(
        self,
        count: int,
        scenario: str | Scenario,
        config: ProcessConfig,
        physics: Mapping[str, Any],
        limit: int | None = None,
    ) -> None:
        options = {"decision": "arrival", **physics}
        require_one_of("decision", decision := options.pop("decision"), ("arrival", "period"))
        refuse_without_effect(config, "the co-simulation")
        self._until_arrival, self._process = decision == "arrival", config
        super().__init__(count, scenario, options, limit)
        self._features = np.array(observed_columns(self.scenario, config))
        self._usual = build_process(self.scenario, config)
        self._processes = [self._usual] * count

    def _spaces(self) -> tuple[spaces.Space, spaces.Space]:
        return direction_spaces(self.scenario, self._process)

    def _checked_places(
        self, starts: Any = None, targets: Any = None
    ) -> tuple[Scenario, Process, np.ndarray | None]:
        """Scenario, process and (N, 2) int64 start cells (None to draw them) of an episode."""
        scenario, process = self.scenario, self._usual
        if targets is not None:
            aims = whole_cells("targets", targets, (scenario.robots, 2))
            scenario = replace(scenario, targets=tuple((int(x), int(y)) for x, y in aims))
            process = build_process(scenario, self._process)
        cells = None if starts is None else placed_world(process, starts)[:, [X, Y]]
        return scenario, process, cells

    def _begin_board(
        self,
        m: int,
        mu: float | None = None,
        scenario: Scenario | None = None,
        process: Process | None = None,
        cells: np.ndarray | None = None,
    ) -> None:
        rng, seed = self._draws(m)
        scenario, process = scenario or self.scenario, process or self._usual
        if cells is None:
            cells = np.array(draw_starts(scenario, rng))
            placed_world(process, cells)  # refuses some
        self._begin_episode(m, scenario, cells, mu, rng, seed)
        self._processes[m] = process

    def step(self, actions: np.ndarray) -> None:
        """Simulate an RL step, or until a robot waits for an action; see `EnvBoards.step`.

        Raises:
            FmuError: an FMU failed.
        """
        outcomes = self.arrays.outcomes
        begins = np.flatnonzero(outcomes != RUNNING).tolist()
        moved, lost = ~self._arrived, np.zeros(self.shape, dtype=bool)
        rewards = np.zeros(self.shape)
        while (running := outcomes == RUNNING).any():
            after, episodes = outcomes.copy(), self._episodes()
            steps = self._batch.advance({m: actions[m] for m in np.flatnonzero(running).tolist()})
            for m, step in steps.items():
                after[m] = BY_RANK.index(step.outcome)
                self._arrived[m] = arrived = episodes[m].arrived
                lost[m] = failed(step, arrived)
                rewards[m] += np.nan_to_num(step_reward(self._processes[m], step, arrived))
            self._end(running, after)
            if not self._until_arrival or self._episodes()[0].awaiting.any():
                break
        for m in begins:
            self._begin_board(m)
        moved[begins] = False
        moving = ~(self._arrived | lost)
        ended = (outcomes != RUNNING)[:, None]
        self._show(rewards, moved & ~moving, moved & moving & ended)

    def _looked(self) -> tuple[np.ndarray, np.ndarray]:
        episodes = self._episodes()
        rows = []
        for process, seen in zip(self._processes, (e.observation for e in episodes), strict=True):
            cells = np.clip(seen.cells, 0, (self.scenario.columns - 1, self.scenario.rows - 1))
            world, _ = on_grid(process, seen._replace(cells=cells))
            rows.append(world[:, self._features[:, 0]] + self._features[:, 1])
        return np.array(rows), np.array([episode.awaiting for episode in episodes])

    def action_masks(self) -> np.ndarray:
        """See `agent.envs.boards.DirectionBoards.action_masks`."""
        last, robots = (self.scenario.columns, self.scenario.rows), np.arange(self.shape[1])
        found = []
        for process, episode in zip(self._processes, self._episodes(), strict=True):
            x, y = (episode.observation.cells.clip(-1, last) + 1).T
            found.append(free_directions(process)[robots, x, y])
        return np.array(found)

    def scenes(self) -> list[tuple[Scenario, np.ndarray]]:
        """See `agent.envs.boards.EnvBoards.scenes`."""
        return [(episode.scenario, episode.positions_m) for episode in self._episodes()]

    def path_length_cm(self) -> np.ndarray:
        """See `agent.envs.boards.EnvBoards.path_length_cm`."""
        return 100.0 * np.array([episode.measures.path_length_m for episode in self._episodes()])

"""Robots that choose directions in the full co-simulation; rows are robots.

    gymnasium.make_vec("MiniRobots/CoSim-v0", num_envs=16)
    gymnasium.make_vec("MiniRobots/CoSimPair-v0", num_envs=8)

Boards advance together, 2 s of simulated time a step, in which robots under way ignore their
actions: `infos["active"]` says whose next action counts. Boards with one robot have the same bits
as a `SyncVectorEnv` of environments with `decision="period"` and the same seeds.
"""

from dataclasses import replace
from typing import Any

import numpy as np

from agent.envs.boards import DirectionBoards, direction_spaces
from agent.envs.dynamics import DynamicsBoards, EnvSetup, set_up
from agent.envs.grid_episode import free_directions, observed_columns, place_checked, whole_cells
from agent.envs.vector import Ends, RobotRowsVectorEnv, interpreted
from agent.mdp.acting import on_grid
from agent.mdp.config import ProcessConfig, refuse_without_effect
from agent.mdp.grid import ARRIVED, COLUMN_COUNT, HIT, LEFT, MOVING, X, Y
from agent.mdp.readings import Process, build_process
from agent.mdp.rewards import failed, step_reward
from cosim.base.arguments import ConfigError, require_one_of
from cosim.coupling.rl_step import Step
from cosim.model.outcome import OUT_OF_BOARD, RUNNING
from cosim.model.scenario import Scenario
from cosim.onboard.observing import draw_starts


class CoSimBoards(DynamicsBoards, DirectionBoards):
    """K boards whose robots adopt directions when they wait for one.

    Args:
        count, setup, limit: as of `DynamicsBoards`.
        config: readings of the decision process.
        decision: when a step ends: after every "period" of 2 s, or, of one board, on "arrival",
            when a robot waits for an action; its rewards cover the time that passed.

    Raises:
        UserError: the scenario or an argument cannot be used.
    """

    reset_options = ("starts", "mu", "targets")
    _mutable = (*DynamicsBoards._mutable, "_scenarios", "_processes", "_status", "_positions_m")

    def __init__(
        self,
        count: int,
        setup: EnvSetup,
        config: ProcessConfig,
        decision: str = "period",
        limit: int | None = None,
    ) -> None:
        require_one_of("decision", decision, ("arrival", "period"))
        refuse_without_effect(config, "the co-simulation")
        self._until_arrival, self._config = decision == "arrival", config
        self.observation_space, self.action_space = direction_spaces(setup.scenario, config)
        super().__init__(count, setup, limit)
        self._features = np.array(observed_columns(self.scenario, config))
        self._usual = build_process(self.scenario, config)
        self._scenarios, self._processes = [self.scenario] * count, [self._usual] * count
        self._status = np.full(self.shape, MOVING)
        self._positions_m = np.zeros((*self.shape, 2))

    def _checked(
        self, starts: Any = None, targets: Any = None
    ) -> tuple[Scenario, Process, np.ndarray | None]:
        """Scenario, process and (N, 2) int64 start cells (None to draw them) of an episode."""
        scenario, process, cells = self.scenario, self._usual, None
        if targets is not None:
            aims = whole_cells(targets, (scenario.robots, 2), "targets")
            scenario = replace(scenario, targets=tuple((int(x), int(y)) for x, y in aims))
            process = build_process(scenario, self._config)
        if starts is not None:
            world = np.zeros((scenario.robots, COLUMN_COUNT), dtype=np.int64)
            place_checked(process, world, starts)
            cells = world[:, [X, Y]]
        return scenario, process, cells

    def _begin(
        self,
        m: int,
        mu: float | None = None,
        scenario: Scenario | None = None,
        process: Process | None = None,
        given: np.ndarray | None = None,
    ) -> None:
        """Set the robots of board m down, motors at rest."""
        scenario, process = scenario or self.scenario, process or self._usual
        start_seed, noise_seed = self._seeds[m].spawn(2)
        rng = np.random.default_rng(start_seed)
        if given is None:
            given = np.array(draw_starts(scenario, rng))
            place_checked(process, np.zeros((len(given), COLUMN_COUNT), dtype=np.int64), given)
        cells = tuple((int(x), int(y)) for x, y in given)
        self._batch.begin(m, scenario, cells, noise_seed, self._setup.drawn(rng, mu))
        self._scenarios[m], self._processes[m] = scenario, process
        self._positions_m[m] = [scenario.centre_m(cell) for cell in cells]
        self._status[m] = MOVING
        self.arrays.outcomes[m] = RUNNING

    def step(self, actions: np.ndarray) -> None:
        """Simulate an RL step, or until a robot waits for an action; see `EnvBoards.step`.

        Raises:
            FmuError: an FMU failed.
        """
        begins = np.flatnonzero(self.arrays.outcomes != RUNNING).tolist()
        moved, rewards = self._status == MOVING, np.zeros(self.shape)
        while True:
            for m, step in self._advance(actions).items():
                rewards[m] += self._judged(m, step)
            if not self._until_arrival or self._waits():
                break
        for m in begins:
            self._begin(m)
            moved[m] = False
        moving = self._status == MOVING
        ended = (self.arrays.outcomes != RUNNING)[:, None]
        self._show(rewards, moved & ~moving, moved & moving & ended)

    def _waits(self) -> bool:
        return bool(self.arrays.outcomes[0] != RUNNING or self._episode(0).awaiting.any())

    def _judged(self, m: int, step: Step) -> np.ndarray:
        """(N,) float64, rewards of an RL step of board m, whose robots' states follow."""
        episode, status = self._episode(m), self._status[m]
        self._positions_m[m], arrived = episode.positions_m, episode.arrived
        status[arrived] = ARRIVED
        lost = failed(step, arrived)
        status[lost] = np.where(step.events[lost] == OUT_OF_BOARD, LEFT, HIT)
        return np.nan_to_num(step_reward(self._processes[m], step, arrived))

    def _looked(self) -> tuple[np.ndarray, np.ndarray]:
        episodes = [self._episode(m) for m in range(self.shape[0])]
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
        for m, process in enumerate(self._processes):
            x, y = (self._episode(m).observation.cells.clip(-1, last) + 1).T
            found.append(free_directions(process)[robots, x, y])
        return np.array(found)

    def scenes(self) -> list[tuple[Scenario, np.ndarray]]:
        """See `agent.envs.boards.EnvBoards.scenes`."""
        return list(zip(self._scenarios, self._positions_m, strict=True))


class CoSimVectorEnv(RobotRowsVectorEnv):
    """Boards in the co-simulation; a step is an RL step.

    `reset(options={"mu": (boards,)})` gives friction coefficients, `{"targets": (boards, robots,
    2)}` target cells of these episodes.
    """

    def __init__(
        self,
        num_envs: int = 1,
        scenario: str | Scenario = "1a",
        process: ProcessConfig | None = None,
        *,
        decision: str = "period",
        render_mode: str | None = None,
        ends: Ends = "together",
        outcome_names: bool = False,
        max_episode_steps: int | None = None,
        **physics: Any,
    ) -> None:
        """Make the boards.

        Args:
            num_envs: boards.
            scenario: name of a built-in scenario, a scenario file, or a scenario.
            process: readings of the decision process.
            decision: "period" alone; boards that wait for each other would have other bits.
            render_mode, ends, outcome_names: as of `agent.envs.vector.RowsVectorEnv`.
            max_episode_steps: limit of RL steps, next to the physics' own `time_limit`.
            physics: see `agent.envs.dynamics.set_up`.

        Raises:
            UserError: the scenario or an option cannot be used, or the motor FMU cannot be built.
        """
        if decision != "period":
            raise ConfigError(
                f"decision = {decision} is not possible for boards that advance together; leave "
                'it out and look at infos["active"], or make_vec with vectorization_mode="sync"'
            )
        process, setup = interpreted(process), set_up(scenario, physics)
        boards = CoSimBoards(num_envs, setup, process, limit=max_episode_steps)
        super().__init__(boards, render_mode, ends=ends, outcome_names=outcome_names)

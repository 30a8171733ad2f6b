"""Environments of robots that choose directions: for Gymnasium and for PettingZoo.

    gymnasium.make("MiniRobots/SingleA-v0")
    gymnasium.make_vec("MiniRobots/Pair-v0", num_envs=1024)
    agent.envs.parallel_env("2")

Boards with one robot have the same bits as a `SyncVectorEnv` of `NavigationEnv` with the same
seeds, boards with several those of as many `NavigationParallelEnv`.
"""

from collections.abc import Iterable, Mapping
from dataclasses import fields
from itertools import compress
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from pettingzoo import ParallelEnv

from agent.envs.boards import Boards, Count, EnvBoards
from agent.envs.views import RowsVectorEnv, SingleEnv, View
from agent.mdp.config import ProcessConfig
from cosim.base.arguments import ConfigError, require_names, validate_argument
from cosim.model.scenario import Scenario
from cosim.model.scenario_file import find_scenario
from cosim.onboard.features import DIRECTION_COUNT

# Observations, rewards, terminations, truncations and infos, by agent.
AgentResults = tuple[
    dict[str, np.ndarray],
    dict[str, float],
    dict[str, bool],
    dict[str, bool],
    dict[str, dict[str, Any]],
]


def direction_boards(
    count: int,
    scenario: str | Scenario,
    process: ProcessConfig | Mapping[str, Any] | None = None,
    *,
    cosim: bool = False,
    max_episode_steps: int | None = None,
    **physics: Any,
) -> EnvBoards:
    """Return the boards of an environment: on the grid, or in the full co-simulation.

    Args:
        cosim: simulate motors and contacts instead of moving on the grid.
        max_episode_steps: limit of steps, which cuts episodes as Gymnasium's `TimeLimit` does, next
            to the process's own `step_limit`, in the co-simulation to the physics' `time_limit`.
        physics: of the co-simulation, see `agent.envs.dynamics.CoSimBoards`.

    Raises:
        UserError: the scenario or an option cannot be used.
    """
    limit = validate_argument("max_episode_steps", max_episode_steps, Count | None)
    given = {} if process is None else process
    if isinstance(given, Mapping):
        require_names("process.", given, [field.name for field in fields(ProcessConfig)])
    config: ProcessConfig = validate_argument("process", given, ProcessConfig)
    if validate_argument("cosim", cosim, bool):
        # here, because the grid needs no FMUs
        from agent.envs.dynamics import CoSimBoards  # noqa: PLC0415

        return CoSimBoards(count, scenario, config, physics, limit)
    for name in physics:
        raise ConfigError(f"{name} has no effect on the grid; leave it out, or give cosim=True")
    return Boards(count, find_scenario(scenario, ideal=True), config, limit)


class NavigationEnv(SingleEnv):
    """One robot that learns to reach its target cell, on the grid or in the dynamics.

    - Observation: MultiDiscrete (F,) int64, the features of `process.features` (Section III), each
      counted from 0; by default column and row of the robot's cell, [30, 30] on the paper's board.
      A robot that left the board seems to be at its edge.
    - Action: Discrete(8), the next move goes to the neighbour at k · 45° counter-clockwise from +x.
      In the dynamics a step lasts until the robot waits for its next action (`decision="arrival"`),
      or an RL step of 2 s (`decision="period"`), in which a robot on its move ignores the action.
    - Reward, Eq. (8): 100 on arrival, -100 on failure, else -1 per move, in the dynamics per RL
      step that passed. `process` can give other amounts.
    - Termination: the robot arrived, left the board or touched an obstacle.
    - Truncation: after `max_episode_steps`, whatever else that step has; on the grid also after
      `process.step_limit` (1000 moves), in the dynamics after `time_limit` (600 s of simulated
      time).
    - Infos: `outcome`, int, 0 running, also where `max_episode_steps` cut it, 1 timeout, by the
      other limits, 2 success, 3 collision, 4 out of the board;
      `is_success`, bool; `path_length`, float, cm since the start; `active`, bool, whether the next
      action counts; with `outcome_names`, `outcome_name`, str.
    - Options of `reset`: `starts`, [[column, row]]; in the dynamics also `targets`, likewise,
      and `mu`, friction coefficient of the floor, for this episode.
    - Arguments: those of `direction_boards` without `count`, and of `View`.

    >>> env = NavigationEnv("1a")
    >>> env.reset(seed=0, options={"starts": [[15, 20]]})[0]
    array([15, 20])
    >>> env.step(6)[:4]
    (array([15, 19]), -1.0, False, False)
    >>> observation, reward, terminated, truncated, info = env.step(6)
    >>> reward, terminated, info["outcome"], info["path_length"]
    (100.0, True, 2, 2.0)
    """

    _boards_of = staticmethod(direction_boards)

    def action_masks(self) -> np.ndarray:
        """Return (8,) bool, which directions lead to a free cell."""
        self._require_open()
        return self._boards.action_masks()[0, 0].astype(bool)


class RobotsVectorEnv(RowsVectorEnv):
    """Robots that choose directions and share a policy; every robot of the boards is a row.

    `num_envs=K` boards of N robots have R = K · N rows, and `env.num_envs` is R, as learners that
    share parameters expect it. The robots of a board are consecutive rows.

    - Observation: MultiDiscrete (R, F) int64, each row as of `NavigationParallelEnv`.
    - Action: MultiDiscrete (R,), directions k · 45° counter-clockwise from +x, 0 to 7. A row
      ignores its action where `active` was False, and in the step that begins a board again. In
      the dynamics a step is an RL step of 2 s, in which robots on their move ignore their actions.
    - Reward: (R,) float64 as of `NavigationParallelEnv`; 0 for robots that have ended, and where a
      board begins again.
    - Termination: (R,) bool, by `ends="together"` the rows of a board at its end: all its robots
      have arrived, or one left the board or touched something; by `ends="own"` each robot that
      arrived or failed, in its own step. Each row ends once per episode.
    - Truncation: (R,) bool, robots still on their move when their board ended, by a failure of
      another robot or at a limit: on the grid `process.step_limit` (1000 moves), in the dynamics
      `time_limit` (600 s of simulated time); and at `max_episode_steps`, also robots that arrived
      or failed in that step, as Gymnasium's `TimeLimit` has it.
    - Restart: a board begins again in the step after its end, all its robots (next-step autoreset).
    - Infos: (R,) arrays as of `NavigationEnv`, `outcome` that of the board. Gymnasium's masks
      `_outcome` and so on are True in every row.
    - Options of `reset`: `starts`, (K, N, 2) columns and rows; `reset_mask`, (K,) bool, boards to
      begin again, whose seeds alone are used; in the dynamics also `targets`, (K, N, 2) columns and
      rows, and `mu`, (K,) friction coefficients, for these episodes.
    - Arguments: `num_envs` and `ends` as above, those of `direction_boards` and of `View`.

    >>> env = RobotsVectorEnv(2, "2")
    >>> starts = [[[15, 19], [5, 5]], [[3, 3], [25, 25]]]
    >>> env.reset(seed=0, options={"starts": starts})[0].tolist()
    [[15, 19, 2, 1], [5, 5, 2, 1], [3, 3, 2, 1], [25, 25, 2, 1]]
    >>> observations, rewards, terminated, truncated, infos = env.step(np.array([6, 0, 0, 0]))
    >>> rewards, infos["active"]
    (array([100.,  -1.,  -1.,  -1.]), array([False,  True,  True,  True]))
    """

    @staticmethod
    def _boards_of(*arguments: Any, **options: Any) -> EnvBoards:
        if options.get("cosim") and options.setdefault("decision", "period") != "period":
            raise ConfigError(
                f"decision = {options['decision']} is not possible for boards that advance "
                'together; leave it out and look at infos["active"], or make_vec with '
                'vectorization_mode="sync"'
            )
        return direction_boards(*arguments, **options)

    def action_masks(self) -> np.ndarray:
        """Return (rows, 8) bool, which directions lead to a free cell."""
        self._require_open()
        return self._boards.action_masks().astype(bool).reshape(self.num_envs, -1)


class NavigationParallelEnv(View, ParallelEnv[str, np.ndarray, int]):
    """Robots that learn to reach their targets without touching each other, for PettingZoo.

    Agents are `robot_1`, `robot_2`, …. Each value is a dict by agent. What is random in an
    environment that was never seeded comes from entropy.

    - Observation: MultiDiscrete (F,) int64, the features of `process.features` (Section III)
      counted from 0; by default column, row, distance class (0 near, 1 medium, 2 large) and change
      of distance (0 closer, 1 same, 2 farther) of the nearest other robot; without the last two for
      a lone robot. `state()` is (N · F,), those of all robots.
    - Action: Discrete(8), direction k · 45° counter-clockwise from +x, of every agent of `agents`.
      In the dynamics a step lasts until any robot waits for its next action (`decision="arrival"`),
      or an RL step of 2 s (`decision="period"`); robots on their move ignore their action.
    - Reward, float, Eq. (8) and (11): 100 on arrival, -100 on failure, else -1 - b (1 - d) per
      move, in the dynamics per RL step that passed, where d is the distance of the nearest other
      robot in 10 cm, at most 1, and b 1.5 if it becomes less, else 1. `process` can give others.
    - Termination: the robot arrived, and stays where it is; or it left the board or touched
      something, which ends the episode of all.
    - Truncation: robots still on their move when another one failed, so that their next state has a
      value; or at a limit: `max_cycles`, on the grid also `process.step_limit` (1000 moves), in the
      dynamics also `time_limit` (600 s of simulated time).
    - Infos: as of `NavigationEnv`; and `action_mask`, (8,) int8, 1 where a direction leads to a
      free cell.
    - Options of `reset`: `starts`, [[column, row], …]; in the dynamics also `targets`, likewise,
      and `mu`, friction coefficient of the floor, for this episode.
    - Arguments: `max_cycles`, limit of steps; those of `direction_boards` without
      `count` and `max_episode_steps`, and of `View`.

    >>> env = NavigationParallelEnv("2")
    >>> observations, infos = env.reset(seed=0, options={"starts": [[15, 19], [5, 5]]})
    >>> observations
    {'robot_1': array([15, 19,  2,  1]), 'robot_2': array([5, 5, 2, 1])}
    >>> observations, rewards, *ends, infos = env.step({"robot_1": 6, "robot_2": 0})
    >>> rewards, env.agents
    ({'robot_1': 100.0, 'robot_2': -1.0}, ['robot_2'])
    """

    metadata = View.metadata | {"name": "minirobots_v0", "is_parallelizable": True}
    _boards_of = staticmethod(direction_boards)

    def __init__(
        self,
        scenario: str | Scenario = "2",
        process: ProcessConfig | None = None,
        *,
        max_cycles: int | None = None,
        **options: Any,
    ) -> None:
        limit = validate_argument("max_cycles", max_cycles, Count | None)
        super().__init__(1, scenario, process, max_episode_steps=limit, **options)
        boards, features = self._boards, self._boards.observation_space
        boards.seed(np.random.SeedSequence().entropy)
        self.agents = []
        self.possible_agents = [f"robot_{k + 1}" for k in range(boards.shape[1])]
        self.observation_spaces: dict[str, Any] = dict.fromkeys(self.possible_agents, features)
        self.action_spaces: dict[str, Any] = {
            agent: spaces.Discrete(DIRECTION_COUNT) for agent in self.possible_agents
        }
        self.state_space = spaces.MultiDiscrete([*features.nvec] * len(self.possible_agents))

    def observation_space(self, agent: str) -> spaces.Space:
        """Return the same object on every call, as PettingZoo requires."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> spaces.Space:
        """Return the same object on every call, as PettingZoo requires."""
        return self.action_spaces[agent]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, np.ndarray], dict[str, dict[str, Any]]]:
        """Begin an episode with options of the class; raises ConfigError where one is unusable.

        Other options are ignored, as `pettingzoo.test.parallel_api_test` asks.
        """
        names = self._boards.reset_options
        given = {name: [value] for name, value in (options or {}).items() if name in names}
        observations, *_, infos = self._begin(given, seed)
        self.agents = self._remaining()
        return self._by_agent(observations), self._infos(infos)

    def step(self, actions: Mapping[str, int]) -> AgentResults:
        """Let every agent take its action; nothing happens after the end of an episode.

        Raises:
            ConfigError: an agent has no action, or one that is no direction; an unknown agent has
                one; or the environment is closed.
        """
        self._require_open()
        if not self.agents:
            gym.logger.warn("step() does nothing after the end of an episode")
            return {}, {}, {}, {}, {}
        observations, *flat, infos = self._step(self._checked(actions))
        rewards, terminated, truncated = (self._by_agent(values.tolist()) for values in flat)
        results = self._by_agent(observations), rewards, terminated, truncated, self._infos(infos)
        self.agents = self._remaining()
        return results

    def _checked(self, actions: Mapping[str, Any]) -> list[Any]:
        """Return an action for each robot, 0 where it has ended."""
        for agent in actions:
            if agent not in self.possible_agents:
                agents = ", ".join(self.possible_agents)
                raise ConfigError(f"{agent} is not an agent; choose from {agents}")
        for agent in self.agents:
            if agent not in actions:
                raise ConfigError(f"{agent} has no action; give one to every agent of env.agents")
        return [actions[agent] if agent in self.agents else 0 for agent in self.possible_agents]

    def _remaining(self) -> list[str]:
        return [*compress(self.possible_agents, self._boards.remaining()[0])]

    def _by_agent(self, rows: Iterable[Any]) -> dict[str, Any]:
        """Return what each agent that has not ended has of N rows."""
        pairs = zip(self.possible_agents, rows, strict=True)
        return {agent: row for agent, row in pairs if agent in self.agents}

    def _infos(self, rows: dict[str, np.ndarray]) -> dict[str, dict[str, Any]]:
        infos = {name: values.tolist() for name, values in rows.items()}
        infos["action_mask"] = self._boards.action_masks()[0]
        of_agents = zip(*infos.values(), strict=True)
        return self._by_agent(dict(zip(infos, row, strict=True)) for row in of_agents)

    def state(self) -> np.ndarray:
        """Return the global state, shape (robots · features,): the observations of all robots."""
        self._require_open()
        return self._boards.arrays.observations[0].flatten()

    def set_state(self, state: dict[str, Any]) -> None:
        """See `View.set_state`."""
        super().set_state(state)
        self.agents = self._remaining()

    def close(self, **_: Any) -> None:
        """See `View.close`."""
        super().close()
        self.agents = []

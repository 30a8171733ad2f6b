"""skrl's PPO on many boards, with one network for all robots.

Robots are rows of one single-agent learner, which is what sharing parameters means: skrl's
multi-agent classes keep a network per agent. The critic of `ippo` sees what the robot sees, that of
`mappo` the cells of all robots too. skrl's own trainer is not used: it does not support robots that
wait for others.
"""

from typing import Any

import jax.numpy as jnp
import numpy as np
import skrl
from gymnasium import spaces
from skrl.agents.jax.ppo import PPO
from skrl.memories.jax import RandomMemory
from skrl.utils import set_seed

from agent.deep.inputs import GROUPS, NOTHING
from agent.deep.learning_grid import SHAPING, WIDTH, World
from agent.deep.models import Actor, Critic, network_of
from agent.deep.policy import Network
from cosim.model.scenario import Scenario
from cosim.onboard.features import DIRECTION_COUNT

_STEPS = 32  # steps between two updates
_CONFIG = {
    "experiment": {"write_interval": 0, "checkpoint_interval": 0},
    "rollouts": _STEPS,
    "learning_epochs": 4,
    "mini_batches": 4,
    "discount_factor": SHAPING["ippo"].gamma,
    "gae_lambda": 0.9,
    "learning_rate": 1e-3,
    "value_clip": 0.0,
    "value_loss_scale": 1.0,
    "entropy_loss_scale": 0.01,
    "time_limit_bootstrap": True,
}


class Moves(RandomMemory):
    """Samples of robots that took part in a step; skrl normalises advantages over all rows.

    Args:
        rows: of a step.
        seed: of the samples' order.
    """

    def __init__(self, rows: int, seed: int) -> None:
        super().__init__(memory_size=_STEPS, num_envs=rows)
        self._random = np.random.default_rng(seed)

    def sample(
        self, names: list[str], *, batch_size: int, mini_batches: int = 1, **_: Any
    ) -> list[list[Any]]:
        """Rows in random order, some more than once: compiled code depends on their number."""
        seen, advantages = map(self.get_tensor_by_name, ("observations", "advantages"))
        moved = np.flatnonzero(np.asarray(seen[..., 0]) != NOTHING)
        of_moves = np.asarray(advantages).ravel()[moved]
        self.set_tensor_by_name(
            "advantages", (advantages - of_moves.mean()) / (of_moves.std() + 1e-8)
        )
        drawn = np.resize(self._random.permutation(moved), batch_size)
        rows: Any = self._random.permutation(drawn)
        return self.sample_by_index(names, indexes=rows, mini_batches=mini_batches)


class Ppo:
    """The learner.

    Args:
        world: boards that it learns on.
        scenario: of the boards.
        seed: of networks and actions.
        central: whether the critic sees the cells of all robots.
    """

    def __init__(self, world: World, scenario: Scenario, seed: int, central: bool) -> None:
        skrl.logger.setLevel("ERROR")
        set_seed(seed)
        high = np.ones(WIDTH, dtype=np.float32)
        high[:GROUPS] = world.inputs.first[-1] - 1
        shape: dict[str, Any] = {
            "observation_space": spaces.Box(np.float32(NOTHING), high),
            "state_space": None,
            "action_space": spaces.Discrete(DIRECTION_COUNT),
        }
        if central:
            cells = np.array([scenario.columns - 1, scenario.rows - 1] * scenario.robots)
            shape["state_space"] = spaces.Box(np.float32(0), cells.astype(np.float32))
        self._central, self._step = central, 0
        inputs = {"observations": jnp.asarray(world.observations()), "states": self._states(world)}
        self.actor = Actor(**shape)
        models = {"policy": self.actor, "value": Critic(**shape)}
        for role, model in models.items():
            model.init_state_dict(dict(inputs), role=role)
        memory = Moves(len(inputs["observations"]), seed)
        self._agent = PPO(models=models, memory=memory, cfg=dict(_CONFIG), **shape)
        self._agent.init()
        self._agent.enable_training_mode(True)

    def _states(self, world: World) -> Any:
        return jnp.asarray(world.cells()) if self._central else None

    def advance(self, world: World) -> int:
        """One step of all boards and what is made of it; the moves of robots in it."""
        moves, observations = len(world.moving()), jnp.asarray(world.observations())
        states, when = self._states(world), {"timestep": self._step, "timesteps": 0}
        actions, _ = self._agent.act(observations, states, **when)
        now = world.step(np.asarray(actions)[:, 0])
        self._agent.record_transition(
            observations=observations,
            states=states,
            actions=actions,
            rewards=jnp.asarray(now.rewards[:, None]),
            next_observations=jnp.asarray(now.after),
            next_states=self._states(world),
            terminated=jnp.asarray(now.terminated[:, None]),
            truncated=jnp.asarray(now.truncated[:, None]),
            infos={},
            **when,
        )
        self._agent.post_interaction(**when)
        self._step += 1
        return moves

    def network(self) -> Network:
        """Return what it has learnt so far."""
        return network_of(self.actor.state_dict.params)

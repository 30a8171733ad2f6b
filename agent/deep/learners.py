"""skrl's learners on many boards, with one network for all robots.

Robots are rows of one single-agent learner, which is what sharing parameters means: skrl's
multi-agent classes keep a network per agent. `ippo` is PPO whose critic sees what the robot sees,
`mappo` PPO whose critic sees the cells of all robots too, `ddqn` double Q-learning. skrl's own
trainer is left out: it knows no robots that wait for others.
"""

import time
from collections.abc import Callable
from typing import Any, Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import skrl
from gymnasium import spaces
from skrl.agents.jax import Agent
from skrl.agents.jax.ddqn import DDQN
from skrl.agents.jax.ppo import PPO
from skrl.memories.jax import RandomMemory
from skrl.models.jax import Model
from skrl.utils import set_seed

from agent.deep.inputs import GROUPS, NOTHING
from agent.deep.models import ActionValues, Actor, Critic, network_of
from agent.deep.policy import NetworkConfig, NetworkPolicy
from agent.deep.world import WIDTH, LearningGrid
from agent.process.config import ProcessConfig
from agent.process.exact import joint_starts
from agent.process.readings import build_process
from agent.training.policy import Seed
from cosim.base.outcome import Outcome
from cosim.base.progress import Progress
from cosim.navigation.features import DIRECTION_COUNT
from cosim.scenarios.scenario import Scenario

Algorithm = Literal["ddqn", "ippo", "mappo"]

GAMMA = 0.98
ROUND = 80_000  # rows stepped between two evaluations, at least
WATCHED = 1000  # starts of an evaluation, at most: all of a pair, a sample of a group's
# DDQN learns by the number of its updates, of which there are four a step; PPO by that of moves.
BOARDS: dict[Algorithm, int] = {"ddqn": 64, "ippo": 256, "mappo": 256}
_PPO_STEPS = 32  # steps between two updates of PPO
_REPLAY = 1000  # steps of all boards that DDQN draws from
_EXPLORING = (1.0, 0.05)  # DDQN's share of random moves, from the first to half of the steps

_QUIET = {"experiment": {"write_interval": 0, "checkpoint_interval": 0}}
_PPO = _QUIET | {
    "rollouts": _PPO_STEPS,
    "learning_epochs": 4,
    "mini_batches": 4,
    "discount_factor": GAMMA,
    "gae_lambda": 0.9,
    "learning_rate": 1e-3,
    "value_clip": 0.0,
    "value_loss_scale": 1.0,
    "entropy_loss_scale": 0.01,
    "time_limit_bootstrap": True,
}
_DDQN = _QUIET | {
    "batch_size": 512,
    "gradient_steps": 4,
    "discount_factor": GAMMA,
    "learning_rate": 1e-3,
    "learning_starts": 20,
    "polyak": 0.05,
    "target_update_interval": 1,
}


class Milestone(NamedTuple):
    """What greedy robots achieve on the grid after so much training.

    Attributes:
        agent_steps: moves of all robots so far.
        seconds: since training began.
        success: share of all starts.
    """

    agent_steps: int
    seconds: float
    success: float


def _agent(algorithm: Algorithm, world: LearningGrid, scenario: Scenario) -> tuple[Agent, Model]:
    """A learner, and its model of moves."""
    high = np.ones(WIDTH, dtype=np.float32)
    high[:GROUPS] = world.inputs.first[-1] - 1
    shape = {
        "observation_space": spaces.Box(np.float32(NOTHING), high),
        "state_space": None,
        "action_space": spaces.Discrete(DIRECTION_COUNT),
    }
    if algorithm == "mappo":
        cells = np.array([scenario.columns - 1, scenario.rows - 1] * scenario.robots)
        shape["state_space"] = spaces.Box(np.float32(0), cells.astype(np.float32))
    inputs = {"observations": jnp.asarray(world.observations()), "states": _states(world, shape)}
    rows = len(inputs["observations"])
    learner: Any
    models: dict[str, Model]
    if algorithm == "ddqn":
        models = {name: ActionValues(**shape) for name in ("q_network", "target_q_network")}
        learner, config, kept = DDQN, _DDQN, _REPLAY
    else:
        models = {"policy": Actor(**shape), "value": Critic(**shape)}
        learner, config, kept = PPO, _PPO, _PPO_STEPS
    for role, model in models.items():
        model.init_state_dict(dict(inputs), role=role)
    memory = RandomMemory(memory_size=kept, num_envs=rows, replacement=algorithm == "ddqn")
    agent = learner(models=models, memory=memory, cfg=dict(config), **shape)
    agent.init()
    agent.enable_training_mode(True)
    return agent, next(iter(models.values()))


def _states(world: LearningGrid, shape: dict[str, Any]) -> jax.Array | None:
    return None if shape["state_space"] is None else jnp.asarray(world.cells())


def train(
    scenario: Scenario,
    algorithm: Algorithm,
    steps: int,
    seed: int,
    progress: Progress,
    watch: Callable[[Milestone], None],
) -> NetworkPolicy:
    """Train a network on the grid; the best of the evaluated ones is kept.

    Args:
        scenario: board, targets and start cells.
        algorithm: of learning.
        steps: moves of all robots together, at least.
        seed: of networks, start cells and exploration.
        progress: is told the moves made.
        watch: is told every evaluation, from all starts, or from `WATCHED` drawn ones of a group.
    """
    skrl.logger.setLevel("ERROR")
    set_seed(seed)
    config = NetworkConfig(scenario, ProcessConfig(), algorithm, steps, Seed(seed))
    world = LearningGrid(scenario, BOARDS[algorithm], seed, GAMMA, config.process)
    agent, model = _agent(algorithm, world, scenario)
    random = np.random.default_rng(seed)
    starts = joint_starts(build_process(scenario, config.process))[:WATCHED]
    began = time.perf_counter()
    best: NetworkPolicy | None = None
    most, done, step = -1.0, 0, 0
    while done < steps:
        for _ in range(-(-ROUND // (BOARDS[algorithm] * scenario.robots))):
            explore = 0.0
            if algorithm == "ddqn":
                first, last = _EXPLORING
                explore = max(last, first - 2.0 * (first - last) * done / steps)
            done += _advance(agent, world, random, step, explore)
            step += 1
        policy = NetworkPolicy(config, network_of(model), world.episodes)
        success = policy.evaluate(starts).rate(Outcome.SUCCESS)
        watch(Milestone(done, time.perf_counter() - began, success))
        progress("training", min(done, steps), steps, f"success {100.0 * success:.1f} %")
        if success > most:
            best, most = policy, success
    assert best is not None
    return best


def _advance(
    agent: Agent, world: LearningGrid, random: np.random.Generator, step: int, explore: float
) -> int:
    """One step of all boards and what the learner makes of it; the moves of robots in it."""
    moves, observations = world.active(), world.observations()
    central = agent.state_space is not None
    states: Any = jnp.asarray(world.cells()) if central else None
    when = {"timestep": step, "timesteps": 0}
    actions, _ = agent.act(jnp.asarray(observations), states, **when)
    actions = np.array(actions)
    if explore > 0.0:
        # not skrl's exploration: it compiles the network anew for every number of greedy rows
        possible = observations[:, GROUPS:]
        drawn = (possible * random.random(possible.shape)).argmax(axis=1)
        chosen = random.random(len(actions)) < explore
        actions[chosen, 0] = drawn[chosen]
    now = world.step(actions[:, 0])
    after: Any = jnp.asarray(world.cells()) if central else None
    agent.record_transition(
        observations=jnp.asarray(observations),
        states=states,
        actions=jnp.asarray(actions),
        rewards=jnp.asarray(now.rewards[:, None]),
        next_observations=jnp.asarray(now.after),
        next_states=after,
        terminated=jnp.asarray(now.terminated[:, None]),
        truncated=jnp.asarray(now.truncated[:, None]),
        infos={},
        **when,
    )
    agent.post_interaction(**when)
    return moves

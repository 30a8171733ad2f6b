"""Double Q-learning with a network: moves are kept and learnt from again, many times.

skrl's DDQN is left out: between two updates it leaves compiled code dozens of times.
"""

from functools import partial
from typing import Any

import flax.linen as nn
import jax
import jax.numpy as jnp
import numpy as np
import optax

from agent.deep.inputs import GROUPS
from agent.deep.learning_grid import SHAPING, WIDTH, Gained, World
from agent.deep.models import network_of, values_of_moves
from agent.deep.policy import Network

_CAPACITY = 1 << 18  # moves that are kept
_BATCH, _UPDATES = 512, 8  # moves of an update, and updates after a step of all boards
_RATE = 1e-3
_TRACKING = 0.01  # of the target network, per update
_EXPLORING = (0.5, 0.05)  # share of random moves, from the first to a third of the steps


class _Values(nn.Module):
    """Values of moves, by observations (R, WIDTH)."""

    width: int

    @nn.compact
    def __call__(self, observations: jax.Array) -> jax.Array:
        return values_of_moves(observations, self.width)


def _values(width: int, params: Any, observations: jax.Array) -> jax.Array:
    values = _Values(width).apply(params, observations)
    assert isinstance(values, jax.Array)
    return values


@partial(jax.jit, static_argnames=("width",))
def _greedy(width: int, params: Any, observations: jax.Array) -> jax.Array:
    return _values(width, params, observations).argmax(axis=-1)


@partial(jax.jit, static_argnames=("width",), donate_argnums=(1,))
def _updated(width: int, state: Any, batches: Any, rate: jax.Array) -> Any:
    """Parameters, those of the target and the optimiser's state after an update per batch."""
    values = partial(_values, width)

    def update(state: Any, batch: Any) -> tuple[Any, None]:
        params, target, moments = state
        before, actions, rewards, after, goes_on = batch
        best = values(params, after).argmax(axis=-1)
        worth = jnp.take_along_axis(values(target, after), best[:, None], axis=1)[:, 0]
        aims = rewards + SHAPING["ddqn"].gamma * goes_on * worth

        def loss(params: Any) -> jax.Array:
            chosen = jnp.take_along_axis(values(params, before), actions[:, None], axis=1)
            return optax.huber_loss(chosen[:, 0], aims).mean()

        changes, moments = optax.scale_by_adam().update(jax.grad(loss)(params), moments)
        params = jax.tree.map(lambda p, c: p - rate * c, params, changes)
        target = jax.tree.map(lambda t, p: t + _TRACKING * (p - t), target, params)
        return (params, target, moments), None

    return jax.lax.scan(update, state, batches)[0]


class DoubleQ:
    """The learner, and the moves that it keeps."""

    def __init__(self, world: World, seed: int, steps: int) -> None:
        self._width = int(world.inputs.first[-1])
        self._steps, self._random = steps, np.random.default_rng(seed)
        params = _Values(self._width).init(jax.random.key(seed), world.observations()[:1])
        target = jax.tree.map(jnp.copy, params)
        self._state = params, target, optax.scale_by_adam().init(params)
        self._before = np.zeros((_CAPACITY, WIDTH), dtype=np.float32)
        self._after = np.zeros_like(self._before)
        self._actions = np.zeros(_CAPACITY, dtype=np.int32)
        self._rewards, self._goes_on = np.zeros((2, _CAPACITY), dtype=np.float32)
        self._kept = self._done = 0

    def advance(self, world: World) -> int:
        """One step of all boards and what is learnt after it; the moves of robots in it."""
        moving, observations = world.moving(), world.observations()
        actions = np.array(_greedy(self._width, self._state[0], observations))
        first, last = _EXPLORING
        explore = max(last, first - 3.0 * (first - last) * self._done / self._steps)
        possible = observations[:, GROUPS:]
        drawn = (possible * self._random.random(possible.shape)).argmax(axis=1)
        actions = np.where(self._random.random(len(actions)) < explore, drawn, actions)
        gained = world.step(actions)
        self._keep(moving, observations, actions, gained)
        self._done += len(moving)
        rate = np.float32(_RATE * max(0.05, 1.0 - self._done / self._steps))
        chosen = self._random.integers(min(self._kept, _CAPACITY), size=(_UPDATES, _BATCH))
        parts = self._before, self._actions, self._rewards, self._after, self._goes_on
        self._state = _updated(self._width, self._state, tuple(p[chosen] for p in parts), rate)
        return len(moving)

    def _keep(
        self, moving: np.ndarray, before: np.ndarray, actions: np.ndarray, gained: Gained
    ) -> None:
        places = (self._kept + np.arange(len(moving))) % _CAPACITY
        self._before[places], self._after[places] = before[moving], gained.after[moving]
        self._actions[places], self._rewards[places] = actions[moving], gained.rewards[moving]
        self._goes_on[places] = ~gained.terminated[moving]
        self._kept += len(moving)

    def network(self) -> Network:
        """Return what it has learnt so far."""
        return network_of(self._state[0])

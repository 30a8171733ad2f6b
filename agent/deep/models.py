"""Networks of the learners, as models of skrl: two hidden layers over rows that are added up.

Only `agent.deep.learners` imports this module, which needs the extra `deep`.
"""

from typing import Any

import flax.linen as nn
import jax
import jax.numpy as jnp
import numpy as np
from skrl.models.jax import CategoricalMixin, DeterministicMixin, Model

from agent.deep.inputs import GROUPS
from agent.deep.policy import Network
from cosim.onboard.features import DIRECTION_COUNT

HIDDEN = 128
_IMPOSSIBLE = -1e9  # value and logit of a move that cannot be chosen

Outputs = tuple[jax.Array, dict[str, Any]]


def _layers(rows: jax.Array, width: int, outputs: int) -> jax.Array:
    added = jax.nn.one_hot(rows.astype(jnp.int32), width).sum(axis=-2)
    hidden = nn.relu(nn.Dense(HIDDEN)(added))
    hidden = nn.relu(nn.Dense(HIDDEN)(hidden))
    return nn.Dense(outputs)(hidden)


def _sizes(space: Any) -> np.ndarray:
    return space.high.astype(int) + 1


def _width(model: Model) -> int:
    return int(_sizes(model.observation_space)[0])


def values_of_moves(observations: jax.Array, width: int) -> jax.Array:
    """(R, 8) float32, values or logits by (R, GROUPS + 8) observations.

    Args:
        observations: rows of the first layer, and which moves are possible.
        width: of the first layer.
    """
    rows, possible = jnp.split(observations, [GROUPS], axis=-1)
    return jnp.where(possible > 0, _layers(rows, width, DIRECTION_COUNT), _IMPOSSIBLE)


class Actor(CategoricalMixin, Model):
    """Logits of moves."""

    def __init__(self, **options: Any) -> None:
        Model.__init__(self, **options)
        CategoricalMixin.__init__(self)

    @nn.compact
    def __call__(self, inputs: dict[str, Any], role: str) -> Outputs:
        """(R, 8) float32."""
        return values_of_moves(inputs["observations"], _width(self)), {}

    def act(self, inputs: dict[str, Any], **options: Any) -> Outputs:
        """Draw moves; their logits go where skrl looks for what it takes the entropy of."""
        actions, outputs = super().act(inputs, **options)
        return actions, outputs | {"stddev": outputs["net_output"]}


class Critic(DeterministicMixin, Model):
    """Value of what a robot observes, and of the cells of all robots where they are given."""

    def __init__(self, **options: Any) -> None:
        Model.__init__(self, **options)
        DeterministicMixin.__init__(self)

    @nn.compact
    def __call__(self, inputs: dict[str, Any], role: str) -> Outputs:
        """(R, 1) float32."""
        rows, width = inputs["observations"][..., :GROUPS], _width(self)
        if self.state_space is not None:
            first = width + np.cumsum([0, *_sizes(self.state_space)])
            rows = jnp.concatenate([rows, inputs["states"] + first[:-1]], axis=-1)
            width = int(first[-1])
        return _layers(rows, width, 1), {}


def network_of(params: Any) -> Network:
    """Weights and biases of a model's three layers, by its parameters."""
    layers = params["params"]
    parts = (layers[f"Dense_{k}"][part] for k in range(3) for part in ("kernel", "bias"))
    return Network(*(np.array(part, dtype=np.float32) for part in parts))

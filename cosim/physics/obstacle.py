"""Whether a robot touches an obstacle, for kernels; the definition is `cosim.base.scenario`'s."""

from cosim.base.jit import inlined
from cosim.base.scenario import touches_obstacle as definition

touches_obstacle = inlined(definition)

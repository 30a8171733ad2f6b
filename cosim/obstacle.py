"""Whether a robot touches an obstacle, for kernels; the definition is `cosim.scenario`'s."""

from cosim.jit import inlined
from cosim.scenario import touches_obstacle as definition

touches_obstacle = inlined(definition)

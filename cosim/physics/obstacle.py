"""Whether a robot touches an obstacle, for kernels; defined in `cosim.scenarios.scenario`."""

from cosim.base.jit import inlined
from cosim.scenarios.scenario import touches_obstacle as definition

touches_obstacle = inlined(definition)

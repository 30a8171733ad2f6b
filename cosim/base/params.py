"""Names of `cosim.model.params` for `fmus.variables`.

The bytes of the sources of `fmus` are part of an FMU's identity, and of every result with it: this
module lets them stay as they are.
"""

from cosim.model.params import *  # noqa: F403
from cosim.model.params import describe  # noqa: F401 - as `params.describe`

"""`python -m agent.train`: the command of `agent.experiments.training`."""

import sys
from types import ModuleType
from typing import Any

from agent import train as _train  # noqa: PLW0406 - the function
from agent.experiments.training import main
from cosim.base.errors import run_command


class _Callable(ModuleType):
    """The module that `import agent.train` puts in the place of the function `agent.train`."""

    def __call__(self, *arguments: Any, **options: Any) -> Any:
        return _train(*arguments, **options)


sys.modules[__name__].__class__ = _Callable

if __name__ == "__main__":
    run_command(main)

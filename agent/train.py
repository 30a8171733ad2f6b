"""`python -m agent.train`: the command `minirobots train`."""

import sys
from types import ModuleType
from typing import Any

from agent import train as _train  # noqa: PLW0406 - the function
from minirobots.runner import run_named


class _Callable(ModuleType):
    """The module that `import agent.train` puts in the place of the function `agent.train`."""

    def __call__(self, *arguments: Any, **options: Any) -> Any:
        return _train(*arguments, **options)


sys.modules[__name__].__class__ = _Callable

if __name__ == "__main__":
    run_named("train", "agent.train")

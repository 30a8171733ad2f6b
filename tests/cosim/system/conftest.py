"""Small FMUs of both standards, read once."""

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from cosim.fmi.fmu import Fmu
from cosim.system.env import SystemEnv
from tests.references.small import small_fmu


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items):
    """Mark all tests of systems as long: their kernels take a minute to compile."""
    for item in items:
        if Path(__file__).parent in item.path.parents:
            item.add_marker(pytest.mark.long)


@pytest.fixture(scope="session")
def small(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Fmu]:
    """An FMU by model, standard, and what differs from the usual one."""
    folder = tmp_path_factory.mktemp("small")
    made: dict[str, Fmu] = {}

    def make(model: str, fmi: int = 3, **differences) -> Fmu:
        key = repr((model, fmi, differences))
        if key not in made:
            path: Path = folder / f"{len(made)}.fmu"
            made[key] = Fmu(small_fmu(path, model, fmi, **differences), exchange=None)
        return made[key]

    return make


@pytest.fixture
def replayed() -> Callable[[SystemEnv], np.ndarray]:
    """Function that returns what ten steps of an environment observe, the same after a reset."""

    def replay(env: SystemEnv) -> np.ndarray:
        def episode() -> np.ndarray:
            env.reset()
            return np.array([env.step(np.array([math.sin(k)]))[0] for k in range(10)])

        first = episode()
        assert (episode() == first).all()
        env.close()
        return first

    return replay

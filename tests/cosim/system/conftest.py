"""Small FMUs of both standards, read once."""

from collections.abc import Callable
from pathlib import Path

import pytest

from cosim.fmi.fmu import Fmu
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

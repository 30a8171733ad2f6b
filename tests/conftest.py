"""One cache for the whole test session, apart from the user's own."""

import os
from typing import Any

import pytest
from hypothesis import settings

from cosim.storage import cache_dir

# First calls compile kernels: no deadline. The same examples every time: no surprises in CI.
settings.register_profile("minirobots", deadline=None, derandomize=True)
settings.load_profile("minirobots")


@pytest.fixture(scope="session", autouse=True)
def session_cache(tmp_path_factory):
    """Policies and FMUs of the tests; kernels and calibrations are shared with the user's cache."""
    if "MINIROBOTS_CACHE" in os.environ:
        yield
        return
    folder = tmp_path_factory.mktemp("cache")
    for kind in ("kernels", "calibrations"):
        (folder / kind).symlink_to(cache_dir(kind), target_is_directory=True)
    os.environ["MINIROBOTS_CACHE"] = str(folder)
    yield
    del os.environ["MINIROBOTS_CACHE"]


def _shown(part: Any, found: set[str]) -> None:
    if hasattr(part, "contents") and hasattr(part, "origin"):
        contents = part.contents if isinstance(part.contents, list) else [part.origin]
        found.update(p.strip("+ ").removesuffix("/**") for p in contents if p[0] != "-")
    else:
        for child in part.contents:
            _shown(child, found)


@pytest.fixture(scope="session")
def shown_paths():
    """Entity paths that the views of a blueprint show."""

    def paths(blueprint) -> set[str]:
        found: set[str] = set()
        _shown(blueprint.root_container, found)
        return found

    return paths

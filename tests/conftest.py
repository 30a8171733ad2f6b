"""One cache for the whole test session, apart from the user's own."""

import os

import pytest
from hypothesis import settings

# First calls compile kernels: no deadline. The same examples every time: no surprises in CI.
settings.register_profile("minirobots", deadline=None, derandomize=True)
settings.load_profile("minirobots")


@pytest.fixture(scope="session", autouse=True)
def session_cache(tmp_path_factory):
    """Policies and FMUs of the tests; kernels keep the cache chosen at import."""
    if "MINIROBOTS_CACHE" in os.environ:
        yield
        return
    os.environ["MINIROBOTS_CACHE"] = str(tmp_path_factory.mktemp("cache"))
    yield
    del os.environ["MINIROBOTS_CACHE"]

from pathlib import Path

import pytest
from numba.core import config


@pytest.fixture
def fresh_cache(tmp_path, monkeypatch):
    """A cache of policies and bounds of this test's own."""
    monkeypatch.setenv("MINIROBOTS_CACHE", str(tmp_path / "cache"))


@pytest.fixture
def cache_of_workers(monkeypatch):
    """Other processes find the kernels that this one has compiled, instead of compiling again."""
    folder = Path(config.CACHE_DIR)  # pyright: ignore[reportAttributeAccessIssue]
    monkeypatch.setenv("MINIROBOTS_CACHE", str(folder.parents[1]))
